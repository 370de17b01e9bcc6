"""Results folders side by side, the seeds of one recipe pooled."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from experiments.beside_reference import is_reference
from experiments.histories import epochs_in_words, extrapolate, read_history, trend
from experiments.paper.figures import learning_figure
from experiments.paper.paper_values import read_paper_values
from experiments.paper.result_files import read_result_record
from experiments.paper.tables import TABLES, read_tables
from lf_flame._common import figures
from lf_flame._common.atomic_files import write_text
from lf_flame.errors import InputError
from lf_flame.learning.scores import standard_deviation

SCORES = ["ssim", "psnr_db"]
COLUMNS = [
    "run", "n_seeds", "depth_mm", "object", "ssim", "ssim_seed_sd", "psnr_db", "psnr_seed_sd",
    "paper_ssim", "paper_psnr_db",
]  # fmt: skip
REQUEST = (
    "seed", "preset", "split", "model", "recipe", "epochs", "backbone_weights", "scenes_sha256",
    "data_sha256",
)  # fmt: skip
"""What was asked of a run: runs that agree in all but the seed are pooled. The same scenes may
differ in their last bits from machine to machine, and so in the hash of their data."""


METHODS = {
    "paper": "The paper's method: its network, trained with Adam",
    "closed form": "Closed form: another decoder, solved, no epochs; `bands` knows the scene",
    "other": "Other recipes",
}
"""Titles of the blocks of a table, in their order."""

ASKED = "epochs asked"
"""Key of the number of epochs that was asked of a run, in the attributes of its history."""

REFERENCE_NOTE = " (reference)"
"""Behind the names of committed results."""


@dataclass(frozen=True)
class Result:
    """A table of a results folder, after which the run is called.

    Scores have the index ``depth_mm`` and the columns `SCORES`: means over the test split; NaN
    where it is missing. The request is the `REQUEST` of its record; empty where it is missing.
    """

    run: str
    scores: pd.DataFrame
    request: dict

    @property
    def seed(self) -> int | None:
        """Seed of the run."""
        return self.request.get("seed")

    @property
    def weights(self) -> str:
        """Backbone weights; random ones without their seed, which is the run's."""
        return re.sub(r" \(seed \d+\)", "", self.request.get("backbone_weights", ""))

    @property
    def method(self) -> str:
        """Key of `METHODS`: what was run, however its preset is called."""
        recipe = self.request["recipe"]
        if recipe.get("neck", "pooled") == "pooled" and not recipe.get("warm_start"):
            return "paper"
        return "other" if self.request["epochs"] else "closed form"

    @property
    def committed(self) -> bool:
        """Whether it came with the checkout; a user's own runs stay apart."""
        return self.run.endswith(REFERENCE_NOTE)

    @property
    def recipe(self) -> dict:
        """What was asked for, but for the seed and the data set's last bits."""
        return {
            **self.request,
            "seed": None,
            "backbone_weights": self.weights,
            "data_sha256": None,
            "reference": self.committed,
        }


def read_result(folder: Path, name: str, run: str, depths_mm: Sequence[float]) -> Result:
    """Read a table of a results folder, as `experiments.paper.tables.write_table` writes it."""
    record = read_result_record(folder, name)
    index = pd.Index(depths_mm, name="depth_mm")
    if record is None:
        return Result(run, pd.DataFrame(math.nan, index, SCORES), {})
    rows = {row.depth_mm: row for row in record.table}
    if not set(depths_mm) <= rows.keys():
        raise InputError(f"{folder / name}.json is damaged: its table lacks a depth of the paper.")
    scores = [(rows[z].ssim, math.inf if rows[z].psnr_db is None else rows[z].psnr_db)
              for z in depths_mm]  # fmt: skip
    request = {name: getattr(record, name) for name in REQUEST}
    return Result(run, pd.DataFrame(scores, index, SCORES), request)


def pool_seeds(results: Sequence[Result]) -> list[list[Result]]:
    """Put the results of one recipe together, none of them with a seed that is there already.

    Missing results all have the same seed, none, and so stay apart.
    """
    pools = []
    for result in results:
        for pool in pools:
            if pool[0].recipe == result.recipe and result.seed not in [r.seed for r in pool]:
                pool.append(result)
                break
        else:
            pools.append([result])
    return pools


def compare_table(pools: Sequence[list[Result]], paper: dict) -> pd.DataFrame:
    """Put pools of results beside the paper's values.

    One row a pool and plane, columns as in `COLUMNS`: the pool's first run, how many seeds it holds
    (0 where it is missing), mean and standard deviation (n - 1) over the seeds, the paper's values.
    """
    blocks = []
    for pool in pools:
        seeds = pd.concat([result.scores for result in pool]).groupby("depth_mm", sort=False)
        spreads = seeds.agg(standard_deviation).set_axis(["ssim_seed_sd", "psnr_seed_sd"], axis=1)
        block = seeds.mean().join(spreads).reset_index()
        blocks.append(
            block.assign(
                run=pool[0].run,
                n_seeds=sum(bool(result.request) for result in pool),
                object=paper["object"],
                paper_ssim=paper["ssim"],
                paper_psnr_db=paper["psnr_db"],
            )
        )
    return pd.concat(blocks)[COLUMNS]


def comparison_markdown(table: pd.DataFrame, pools: Sequence[list[Result]], paper: dict) -> str:
    """Write a comparison as Markdown: a block a method, a column a pool, and what each pool is."""
    parts = [
        f"### {paper['title']}",
        "SSIM / PSNR (dB), means over the test split; printed: the paper's values.",
    ]
    run = [pool for pool in pools if pool[0].request]
    blocks = {name: [p for p in run if p[0].method == name] for name in METHODS}
    blocks["paper"] = blocks["paper"] or [[]]  # what is printed, if nothing else
    for name, some in blocks.items():
        if some:
            parts += [f"**{METHODS[name]}**", _block(table, [p for p in some if p], paper)]
    missing = [pool[0].run for pool in pools if not pool[0].request]
    if missing:
        parts.append(f"No finished run of this table: {', '.join(missing)}.")
    return "\n\n".join(parts) + "\n"


def _block(table: pd.DataFrame, pools: Sequence[list[Result]], paper: dict) -> str:
    """As printed, as committed, as run here; below it what each column is."""
    printed = [f"{s:g} / {p:g}" for s, p in zip(paper["ssim"], paper["psnr_db"], strict=True)]
    shown = {"depth (mm)": paper["depth_mm"], "object": paper["object"], "printed": printed}
    pools = sorted(pools, key=lambda pool: not pool[0].committed)
    for pool in pools:
        rows = table[table["run"] == pool[0].run]
        shown[_title(pool)] = [_cell(*row) for row in rows.loc[:, "ssim":"psnr_seed_sd"].to_numpy()]
    lines = pd.DataFrame(shown).to_markdown(index=False, disable_numparse=True, stralign="right")
    notes = "\n".join(f"- {_title(pool)}: {_describe(pool)}" for pool in pools)
    return f"{lines}\n\n{notes}".rstrip()


def _title(pool: list[Result]) -> str:
    seeds = f", {len(pool)} seeds" if len(pool) > 1 else ""
    epochs = pool[0].request["epochs"]
    return f"{pool[0].run}{seeds}" + (f", {epochs:,} epochs" if epochs else "")


def _cell(ssim: float, ssim_sd: float, psnr: float, psnr_sd: float) -> str:
    if math.isnan(ssim_sd):
        return f"{ssim:.3f} / {psnr:.2f}"
    return f"{ssim:.3f} ± {ssim_sd:.3f} / {psnr:.2f} ± {psnr_sd:.2f}"


def _describe(pool: list[Result]) -> str:
    request = pool[0].request
    seeds = f"seed {pool[0].seed}"
    if len(pool) > 1:
        listed = ", ".join(f"{r.seed} ({r.run})" for r in sorted(pool, key=lambda r: r.seed))
        seeds = f"mean ± standard deviation over the seeds {listed}"
    hashes = (r.request["data_sha256"] or r.request["scenes_sha256"] for r in pool)
    data = ", ".join(dict.fromkeys(name[:8] for name in hashes))
    return (
        f"{seeds}; preset {request['preset']}, {epochs_in_words(request)}; data set {data}; "
        f"backbone weights: {pool[0].weights}"
    )


def report_tables(folders: Sequence[Path], paper_values: Path, out: Path | None = None) -> str:
    """Both tables of one results folder, or of several side by side, as Markdown.

    Beside the text in `out`, NAME.md, go the numbers, NAME.csv and NAME_learning.csv, and a picture
    of validation PSNR against seconds, NAME.png. An InputError says that a folder is not there, or
    holds something else than results.
    """
    if out is not None and out.suffix != ".md":
        raise InputError(f"The file for the tables must end in .md, got {out}.")
    folders = list(dict.fromkeys(folders))
    for folder in folders:
        if not folder.is_dir():
            raise InputError(f"There is no results folder {folder}; `make tables` makes one.")
    texts, tables, learning = [], [], []
    for name in TABLES:
        paper = read_paper_values(paper_values, name)
        runs = zip(folders, _short_names(folders), strict=True)
        pools = pool_seeds([read_result(f, name, run, paper["depth_mm"]) for f, run in runs])
        table = compare_table(pools, paper)
        texts.append(comparison_markdown(table, pools, paper))
        histories = read_histories(folders, name)
        if histories:
            learnt = tabulate_learning(histories)
            texts.append(learning_markdown(learnt))
            learning.append(learnt.assign(table=name))
        tables.append(table.assign(table=name))
    text = "\n".join(texts) if len(folders) > 1 else read_tables(folders[0], paper_values)
    if out is not None:
        numbers = pd.concat(tables).set_index("table").round(6)
        picture = _picture_learning(folders, paper_values)
        write_text(out.with_suffix(".csv"), numbers.to_csv())
        if learning:
            times = pd.concat(learning).set_index("table").round(6)
            write_text(out.with_name(f"{out.stem}_learning.csv"), times.to_csv())
        figures.save(picture, out.with_suffix(".png"))
        write_text(out, text)
    return text


def _picture_learning(folders: Sequence[Path], paper_values: Path):
    panels, printed, names = {}, {}, {}
    own = not all(map(is_reference, folders))
    for name in TABLES:
        paper = read_paper_values(paper_values, name)
        panels[paper["title"]] = read_histories(folders, name)
        printed[paper["title"]] = paper["psnr_db"]
        for folder, run in zip(folders, _short_names(folders), strict=True):
            result = read_result(folder, name, run, paper["depth_mm"])
            if result.request:
                names[run] = _name(result) + " (committed)" * (own and result.committed)
    return learning_figure(panels, printed, names)


def _name(result: Result) -> str:
    """Name of a curve: seeds of one recipe have the same."""
    preset = result.request["preset"]
    name = {"paper": "the paper's method"}.get(result.method, result.method)
    return name if preset in ("paper", "closed-form") else f"{name}, preset {preset}"


def read_histories(folders: Sequence[Path], name: str) -> dict[str, pd.DataFrame]:
    """Read how the runs behind a table learnt, those that are there, by run.

    Columns as in a run's ``history.csv``, ``seconds`` counted since its start.
    """
    histories = {}
    for folder, run in zip(folders, _short_names(folders), strict=True):
        path, record = folder / f"{name}_history.csv", read_result_record(folder, name)
        if record is not None and path.exists():
            histories[run] = read_history(path, record.epochs)
            histories[run].attrs[ASKED] = record.recipe.get("epochs", record.epochs)
            histories[run].attrs["devices"] = ", ".join(record.devices)
    return histories


def tabulate_learning(histories: dict[str, pd.DataFrame]) -> pd.DataFrame:
    """Say when each run was best, when it was where the weakest run ended, and where it was going.

    One row a run; columns ``run``, ``devices`` (accelerators), ``best_psnr_db``, ``best_s``,
    ``best_epoch``, ``weakest`` (the run that was best at the lowest level), ``there_s``,
    ``there_epoch``, ``rise_db`` and ``rise_2se_db``, see `experiments.histories.trend`, and
    ``at_most_db``, see `experiments.histories.extrapolate`: of runs that ended before their last
    epoch.
    """
    best = {run: rows.loc[rows.val_psnr_db.idxmax()] for run, rows in histories.items()}
    weakest = min(best, key=lambda run: best[run].val_psnr_db)
    table = []
    for run, rows in histories.items():
        there = rows[rows.val_psnr_db >= best[weakest].val_psnr_db].iloc[0]
        rise, error = trend(rows)
        asked = rows.attrs.get(ASKED, 0)
        goes_on = asked > rows.epoch.iloc[-1]
        table.append({
            "run": run, "devices": rows.attrs.get("devices", ""),
            "best_psnr_db": best[run].val_psnr_db,
            "best_s": best[run].seconds, "best_epoch": int(best[run].epoch), "weakest": weakest,
            "there_s": there.seconds, "there_epoch": int(there.epoch),
            "rise_db": rise, "rise_2se_db": error,
            "at_most_db": extrapolate(rows, asked) if goes_on else math.nan,
        })  # fmt: skip
    return pd.DataFrame(table)


def learning_markdown(learning: pd.DataFrame) -> str:
    """Write how long each run took to its best epoch, and whether it still rose at its end."""
    weakest = learning.weakest[0]
    level = learning.best_psnr_db[learning.run == weakest].item()
    shown = pd.DataFrame(
        {
            "run": [
                run + f", on {devices}" * bool(devices)
                for run, devices in zip(learning.run, learning.devices, strict=True)
            ],
            "best validation PSNR (dB)": learning.best_psnr_db.map("{:.2f}".format),
            "seconds (epoch)": [_when(row.best_s, row.best_epoch) for row in learning.itertuples()],
            f"to {level:.2f} dB, the best of {weakest}": [
                _when(row.there_s, row.there_epoch) for row in learning.itertuples()
            ],
            "rise in ten epochs (dB)": [
                "-" if math.isnan(row.rise_db) else f"{row.rise_db:+.3f} ± {row.rise_2se_db:.3f}"
                for row in learning.itertuples()
            ],
            "at the last epoch, at most (dB)": [
                "-" if math.isnan(x) else f"{x:.2f}" for x in learning.at_most_db
            ],
        }
    )
    lines = shown.to_markdown(index=False, disable_numparse=True, stralign="right")
    return (
        "Learning, in seconds since a run was started, the data set on disk; rise: of a line "
        "through the second half of its epochs, ± two standard errors; at most: the mean around "
        "the last epoch if the PSNR went on rising with the logarithm of the epoch as over that "
        f"half.\n\n{lines}\n"
    )


def _when(seconds: float, epoch: int) -> str:
    return f"{seconds:.0f} ({epoch})"


def _short_names(folders: Sequence[Path]) -> list[str]:
    names = [
        folder.resolve().name + (REFERENCE_NOTE if is_reference(folder) else "")
        for folder in folders
    ]
    return names if len(set(names)) == len(names) else [str(folder) for folder in folders]
