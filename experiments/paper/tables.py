"""Tables I and II: one run with the printed values, and several runs side by side.

A results folder contains ``table1.json`` and ``table2.json``, the records that
`experiments.paper.evaluation` writes, ``table1_history.csv`` and ``table2_history.csv``, the
validation scores of each epoch, and ``table1_baselines.json`` and ``table2_baselines.json``, the
scores of images that need no network.
"""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from experiments.inputs import read_history
from experiments.paper.figures import learning_figure
from experiments.report import backbone_name, markdown, write_report
from lf_flame._common.input_files import read_record, read_toml
from lf_flame.datasets.config import config_from_json
from lf_flame.errors import InputError
from lf_flame.learning.scores import standard_deviation

TABLES = {"shapes": "table1", "flames": "table2"}
"""The paper's tables by kind of data set."""

COMMITTED = Path(__file__).parents[1] / "results"
"""Folder of the results that come with the checkout."""

COLUMNS = [
    "depth_mm", "object", "ssim", "ssim_sd", "psnr_db", "psnr_sd", "paper_ssim", "paper_psnr_db",
    "n_test", "psnr_foreground_db", "psnr_foreground_sd",
]  # fmt: skip

COMPARED = [
    "source", "run", "n_seeds", "epochs", "depth_mm", "object", "ssim", "ssim_seed_sd", "psnr_db",
    "psnr_seed_sd", "paper_ssim", "paper_psnr_db",
]  # fmt: skip

DROPOUT = {"image": "", "vector": ", dropout on the vector", "none": ", no dropout"}


def read_paper_values(table: str) -> dict:
    """Read the values of one of the paper's tables, or its slopes of sharpest focus."""
    return read_toml(Path(__file__).parents[1] / "paper_values.toml")[table]


def compare_with_paper(scores: pd.DataFrame, paper: dict) -> pd.DataFrame:
    """Join the printed values to the scores of the planes; columns as in `COLUMNS`."""
    table = scores.assign(depth_mm=paper["depth_mm"], object=paper["object"])
    return table.assign(paper_ssim=paper["ssim"], paper_psnr_db=paper["psnr_db"])[COLUMNS]


RECIPE = ("preset", "split", "parts", "model", "recipe", "epochs")
"""Entries of a record that are equal in runs whose scores may be pooled."""


@dataclass(frozen=True)
class Result:
    """A table of a results folder, known by the folder's name, and how its network learnt."""

    run: str
    folder: Path
    record: dict[str, Any]
    history: pd.DataFrame | None

    @property
    def weights(self) -> str:
        """Backbone weights; random ones without their seed, which is the run's."""
        return re.sub(r" \(seed \d+\)", "", self.record["backbone_weights"])

    @property
    def recipe(self) -> tuple:
        """Everything that two runs share whose scores may be pooled."""
        # Earlier records lack options that had their defaults, and have two that change nothing.
        data = self.record.get("dataset", {}).get("config")
        data = data and config_from_json(data, self.folder)
        others = dict.fromkeys(("checkpoint_s", "without_imagenet"))
        shared = {**self.record, "recipe": self.record["recipe"] | others}
        return self.folder.resolve().parent, self.weights, *map(shared.get, RECIPE), data

    @property
    def committed(self) -> bool:
        """Whether the folder came with the checkout."""
        return self.folder.resolve().parent == COMMITTED


def read_result(folder: Path, name: str, run: str) -> Result | None:
    """Read a table of a results folder; None if there is none."""
    path = folder / f"{name}.json"
    if not path.exists():
        return None
    record, history = read_record(path), folder / f"{name}_history.csv"
    needed = (*RECIPE, "seed", "backbone_weights", "machine", "table")
    missing = [key for key in needed if key not in record]
    if missing:
        raise InputError(f"{path} is damaged: it must hold {', '.join(missing)}.")
    scored = all(isinstance(row.get("ssim"), float | int) for row in record["table"])
    depths = [row.get("depth_mm") for row in record["table"]]
    if depths != read_paper_values(name)["depth_mm"] or not scored:
        raise InputError(
            f"{path} is damaged: its table must have the depths of the paper, with SSIM."
        )
    learning = read_history(history, record["epochs"]) if history.exists() else None
    return Result(run, folder, record, learning)


def read_baselines(folders: Sequence[Path], name: str) -> dict[str, list[dict]]:
    """Read the scores without a network, rows by baseline, of the first folder that has them."""
    for folder in folders:
        path = folder / f"{name}_baselines.json"
        if path.exists():
            found = read_record(path).get("baselines", {})
            for rows in found.values():
                if [row.get("depth_mm") for row in rows] != read_paper_values(name)["depth_mm"]:
                    raise InputError(f"{path} is not of a data set with the paper's depths.")
            return found
    return {}


def pool_seeds(results: Sequence[Result]) -> list[list[Result]]:
    """Group the results of one recipe, each seed once."""
    pools: list[list[Result]] = []
    for result in results:
        for pool in pools:
            seeds = [one.record["seed"] for one in pool]
            if pool[0].recipe == result.recipe and result.record["seed"] not in seeds:
                pool.append(result)
                break
        else:
            pools.append([result])
    return pools


def title_of(pool: Sequence[Result]) -> str:
    """Name a row by what was run: backbone, dropout, input, preset and seeds, from the record."""
    first, record = pool[0], pool[0].record
    place = record["model"].get("dropout_place") or record["recipe"].get("dropout_place", "image")
    kind = record.get("dataset", {}).get("config", {}).get("input", {}).get("kind", "raw")
    return "".join([
        "reference: " if first.committed else f"this run, {first.folder}: ",
        backbone_name(first.weights), DROPOUT[place], "" if kind == "raw" else f", input {kind}",
        "" if record["preset"] == "paper" else f", preset {record['preset']}",
        f", {len(pool)} seeds" if len(pool) > 1 else "",
    ])  # fmt: skip


def compare_table(
    pools: Sequence[list[Result]], paper: dict, baselines: dict[str, list[dict]] | None = None
) -> pd.DataFrame:
    """Tabulate each baseline, pool and plane with the printed values; columns as in `COMPARED`.

    Scores are means over the seeds, spreads their standard deviations (n - 1).
    """
    entries = [(name, name, 0, math.nan, [rows]) for name, rows in (baselines or {}).items()]
    entries += [
        (title_of(pool), pool[0].run, len(pool), pool[0].record["epochs"],
         [result.record["table"] for result in pool])
        for pool in pools
    ]  # fmt: skip
    blocks = [pd.DataFrame(columns=COMPARED)]
    for source, run, count, epochs, tables in entries:
        rows = [
            (row["depth_mm"], row["ssim"], math.inf if row["psnr_db"] is None else row["psnr_db"])
            for table in tables
            for row in table
        ]
        scores = pd.DataFrame(rows, columns=["depth_mm", "ssim", "psnr_db"])
        seeds = scores.groupby("depth_mm", sort=False)
        spreads = seeds.agg(standard_deviation).set_axis(["ssim_seed_sd", "psnr_seed_sd"], axis=1)
        block = seeds.mean().join(spreads).reset_index()
        block = block.assign(
            source=source, run=run, n_seeds=count, epochs=epochs, object=paper["object"],
            paper_ssim=paper["ssim"], paper_psnr_db=paper["psnr_db"],
        )  # fmt: skip
        blocks.append(block[COMPARED])
    return pd.concat(blocks[1:] or blocks)


def comparison_markdown(
    table: pd.DataFrame, pools: Sequence[list[Result]], paper: dict, missing: Sequence[str]
) -> list[str]:
    """Write a comparison as paragraphs of Markdown: a row for each source, and its origin."""
    planned = f"{paper['epochs']:,}"
    depths = [
        f"{z:g} mm, {name}" for z, name in zip(paper["depth_mm"], paper["object"], strict=True)
    ]
    printed = [f"{p:g}, {s:g}" for s, p in zip(paper["ssim"], paper["psnr_db"], strict=True)]
    rows = [["printed in the paper", planned, *printed]]
    for (source, _), block in table.groupby(["source", "run"], sort=False):
        epochs = block.epochs.iloc[0]
        cells = [_cell(*row) for row in block.loc[:, "ssim":"psnr_seed_sd"].to_numpy()]
        length = "none" if math.isnan(epochs) else f"{epochs:,.0f} of {planned}"
        rows.append([source, length, *cells])
    parts = [
        f"## {paper['title']}",
        "PSNR (dB), SSIM: means over the test split; ±: standard deviation over the seeds. A run "
        "below the mean training image has learnt nothing yet.",
        markdown(pd.DataFrame(rows, columns=["source", "epochs", *depths])),
    ]
    if pools:
        parts += ["\n".join(f"- {title_of(pool)}: {_describe(pool, paper)}" for pool in pools)]
    if missing:
        parts.append(f"No result of this table: {', '.join(missing)}.")
    return parts


def _duration(seconds: float) -> str:
    for size, unit in ((86400, "days"), (3600, "hours"), (60, "minutes")):
        if seconds >= 2 * size:
            return f"{seconds / size:.1f} {unit}"
    return f"{seconds:.0f} seconds"


def _cell(ssim: float, ssim_sd: float, psnr: float, psnr_sd: float) -> str:
    digits = 4 if ssim >= 0.999 else 3
    if math.isnan(ssim_sd):
        return f"{psnr:.2f}, {ssim:.{digits}f}"
    return f"{psnr:.2f} ± {psnr_sd:.2f}, {ssim:.{digits}f} ± {ssim_sd:.3f}"


def _describe(pool: list[Result], paper: dict) -> str:
    """Describe a row: its basis, how far it was trained, and how long all epochs would take."""
    record, planned = pool[0].record, paper["epochs"]
    epochs, seconds = record["epochs"], record["train_s"]
    machine = ", ".join([*record.get("devices", ()), record["machine"]])
    listed = sorted(pool, key=lambda result: result.record["seed"])
    seeds = "; ".join(
        f"seed {one.record['seed']} ({one.run}), best epoch {one.record['best_epoch']:,}, "
        f"{_duration(one.record['train_s'])}"
        for one in listed
    )
    text = (
        f"{seeds}; weights {pool[0].weights}. Trained for {epochs:,} of the paper's {planned:,} "
        f"epochs on {machine}."
    )
    if epochs >= planned or record["preset"] != "paper":
        return text
    text += f" All {planned:,} take {_duration(seconds / epochs * planned)} there."
    more = " The same command resumes the training; MINUTES=0 trains to the last epoch."
    if record.get("finished"):
        more = f" EPOCHS={planned} resumes the training."
    return text if pool[0].committed else text + more


LINEAR = (
    "Linear: a ridge regression from the network's own picture to the images, no network. On these "
    "scenes the images are nearly linear in the picture, which the network approaches slowly "
    "(at 0 mm the picture is the image). What a network adds would show only where that is not so, "
    "as where objects change places: the depth permutation test."
)


def report_tables(folders: Sequence[Path], out: Path | None = None) -> str:
    """Compare both tables of results folders; returns the Markdown, and writes it to `out`.

    Beside `out`, NAME.md, are NAME.csv, NAME.png (validation PSNR against epochs) and NAME.json. An
    InputError refuses a missing folder or a damaged record.
    """
    if out is not None and out.suffix != ".md":
        raise InputError(f"The file for the tables must end in .md, got {out}.")
    folders = list(dict.fromkeys(folders))
    for folder in folders:
        if not folder.is_dir():
            raise InputError(f"There is no results folder {folder}; `make tables` makes one.")
    names = [folder.resolve().name for folder in folders]
    runs = names if len(set(names)) == len(names) else [str(folder) for folder in folders]
    parts, tables, panels = [LINEAR], [], {}
    for name in TABLES.values():
        paper = read_paper_values(name)
        found = [read_result(f, name, run) for f, run in zip(folders, runs, strict=True)]
        missing = [run for run, result in zip(runs, found, strict=True) if result is None]
        results = [result for result in found if result is not None]
        pools = pool_seeds(results)
        table = compare_table(pools, paper, read_baselines(folders, name))
        parts += comparison_markdown(table, pools, paper, missing)
        tables.append(table.assign(table=name))
        curves = {
            title_of(pool): [one.history for one in pool if one.history is not None]
            for pool in pools
        }
        panels[paper["title"]] = curves, paper["psnr_db"]
    if out is None:
        return "\n\n".join(parts)
    rows = pd.concat(tables)
    rows = rows[["table", *rows.columns.drop("table")]].round(6)
    path = write_report(
        out.parent, out.stem, "Tables I and II", {"results": [str(folder) for folder in folders]},
        parts, tables={out.stem: rows}, pictures={out.stem: learning_figure(panels)},
    )  # fmt: skip
    return path.read_text(encoding="utf-8")
