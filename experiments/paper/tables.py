"""SSIM and PSNR of a trained model on its test split, and the tables made of them."""

import hashlib
import json
from pathlib import Path

import numpy as np
import pandas as pd
from tqdm import tqdm

from experiments.histories import epochs_in_words, recipe_in_words
from experiments.paper.figures import result_figure
from experiments.paper.paper_values import read_paper_values
from experiments.paper.result_files import read_result_record
from lf_flame._common import figures, provenance
from lf_flame._common.atomic_files import write_json, write_text
from lf_flame._common.input_files import read_text
from lf_flame.datasets.config import config_to_json
from lf_flame.datasets.sampling import render_sample
from lf_flame.datasets.store import Dataset
from lf_flame.errors import InputError
from lf_flame.learning.run_folders import open_run, predict_test_split, training_indices
from lf_flame.learning.scores import FOREGROUND, WINDOWS, score

COLUMNS = [
    "depth_mm", "object", "ssim", "ssim_sd", "psnr_db", "psnr_sd", "paper_ssim", "paper_psnr_db",
    "n_test", "psnr_foreground_db", "psnr_foreground_sd",
]  # fmt: skip

TABLES = ("table1", "table2")


def compare_with_paper(scores: pd.DataFrame, paper: dict) -> pd.DataFrame:
    """Put the paper's values beside ours; columns as in `COLUMNS`."""
    if len(scores) != len(paper["depth_mm"]):
        raise InputError(
            f"The paper has {len(paper['depth_mm'])} planes, the model has {len(scores)}."
        )
    table = scores.assign(
        depth_mm=paper["depth_mm"],
        object=paper["object"],
        paper_ssim=paper["ssim"],
        paper_psnr_db=paper["psnr_db"],
    )
    return table[COLUMNS]


def score_windows(targets: np.ndarray, predictions: np.ndarray) -> pd.DataFrame:
    """Score SSIM by the table's window and by others: the paper does not state its own.

    For images [n, plane, h, w]: one row a window, one column a plane, the mean over the samples.
    """
    pairs = list(zip(targets, predictions, strict=True))
    rows = {
        window: np.mean(
            [[measure(a, b) for a, b in zip(*pair, strict=True)] for pair in pairs], axis=0
        )
        for window, measure in WINDOWS.items()
    }
    return pd.DataFrame.from_dict(rows, orient="index")


def windows_markdown(windows: pd.DataFrame, depths_mm: list[float]) -> str:
    """One row a window; the mean SSIM for each depth."""
    shown = windows.map("{:.4f}".format).set_axis([f"{z:g} mm" for z in depths_mm], axis=1)
    lines = shown.to_markdown(disable_numparse=True, stralign="right")
    return f"SSIM of the same images by other windows:\n\n{lines}\n"


def score_baselines(dataset: Dataset, train: np.ndarray, test: np.ndarray) -> pd.DataFrame:
    """Score what needs no network: the mean training image, and the input image as it is.

    The latter where the input is one image of the targets' size. One row a plane and baseline;
    columns ``baseline``, ``depth_mm``, ``ssim``, ``psnr_db``, ``psnr_foreground_db``.
    """
    targets = dataset.targets[test]
    mean = np.broadcast_to(dataset.targets[train].mean(axis=0), targets.shape)
    baselines = [("mean of the training images", mean)]
    if dataset.inputs.shape[1:] == (*targets.shape[2:], 1):
        copied = np.broadcast_to(np.moveaxis(dataset.inputs[test], 3, 1), targets.shape)
        baselines.append(("the input image", copied))
    tables = []
    for name, images in baselines:
        scores = score(targets, images)
        tables.append(scores.assign(baseline=name, depth_mm=dataset.config.depths_mm))
    return pd.concat(tables)[["baseline", "depth_mm", "ssim", "psnr_db", "psnr_foreground_db"]]


def baselines_markdown(baselines: pd.DataFrame) -> str:
    """One row a baseline; SSIM / PSNR / PSNR over the foreground pixels for each depth."""
    numbers = baselines[["ssim", "psnr_db", "psnr_foreground_db"]].itertuples(index=False)
    cells = baselines.assign(cell=["{:.3f} / {:.2f} / {:.2f}".format(*row) for row in numbers])
    shown = cells.pivot(index="baseline", columns="depth_mm", values="cell")
    shown = shown[baselines.depth_mm.unique()]
    shown.columns = [f"{depth:g} mm" for depth in shown.columns]
    lines = shown.to_markdown(disable_numparse=True, stralign="right")
    return (
        f"Without a network, SSIM / PSNR / PSNR over the foreground pixels (dB) on the same test "
        f"split:\n\n{lines}\n"
    )


def table_markdown(table: pd.DataFrame | None, paper: dict, run: dict | None) -> str:
    """Write a table as Markdown: ours, the paper's, the difference; a missing run as missing."""
    if table is None:
        shown = pd.DataFrame(
            {
                "depth (mm)": paper["depth_mm"],
                "object": paper["object"],
                "SSIM": "missing",
                "SSIM, paper": paper["ssim"],
                "PSNR (dB)": "missing",
                "PSNR, paper": paper["psnr_db"],
            }
        )
        note = "No finished run: `make tables` makes it."
    else:
        shown = pd.DataFrame(
            {
                "depth (mm)": table.depth_mm,
                "object": table.object,
                "SSIM": _with_spread(table.ssim, table.ssim_sd, 3),
                "SSIM, paper": table.paper_ssim,
                "difference": (table.ssim - table.paper_ssim).map("{:+.3f}".format),
                "PSNR (dB)": _with_spread(table.psnr_db, table.psnr_sd, 2),
                "PSNR, paper": table.paper_psnr_db,
                "difference ": (table.psnr_db - table.paper_psnr_db).map("{:+.2f}".format),
                "PSNR, foreground (dB)": _with_spread(
                    table.psnr_foreground_db, table.psnr_foreground_sd, 2
                ),
            }
        )
        machine = ", ".join([*run.get("devices", ()), run["machine"]])  # unknown to old records
        note = (
            f"Mean ± standard deviation over {table.n_test[0]} test samples; foreground: over the "
            f"pixels brighter than {FOREGROUND:.0%} of the peak in the truth. "
            f"Preset {run['preset']}: {epochs_in_words(run)}; backbone weights: "
            f"{run['backbone_weights']}; {_seconds_in_words(run)} on {machine}."
        )
    lines = shown.to_markdown(index=False, disable_numparse=True, stralign="right")
    return f"### {paper['title']}\n\n{lines}\n\n{note}\n"


def _seconds_in_words(run: dict) -> str:
    """Say how long features, start and epochs took; old records do not know of the start."""
    start = run.get("start_s")
    features = "" if start is None else f"features and start in {start:.0f} s, "
    return f"{features}epochs in {run['train_s']:.0f} s"


def _with_spread(mean: pd.Series, spread: pd.Series, digits: int) -> list[str]:
    return [f"{m:.{digits}f} ± {s:.{digits}f}" for m, s in zip(mean, spread, strict=True)]


def write_table(
    table: pd.DataFrame,
    baselines: pd.DataFrame,
    windows: pd.DataFrame,
    paper: dict,
    run: dict,
    name: str,
    out: Path,
) -> None:
    """Write ``NAME.md``, ``NAME.json`` and, last because make looks at it, ``NAME.csv``."""
    evaluation = provenance.environment()
    # What was asked for as weights may not be what was had; `backbone_weights` is what was used.
    model = {key: value for key, value in run["model"].items() if key != "backbone_weights"}
    parts = [
        table_markdown(table, paper, run),
        baselines_markdown(baselines),
        windows_markdown(windows, paper["depth_mm"]),
    ]
    write_text(out / f"{name}.md", "\n".join(parts))
    numbers = table.round(6).to_csv(index=False)
    record = {
        **{key: value for key, value in run.items() if key != "test_indices"},
        "model": model,
        "table": table.to_dict("records"),
        "baselines": baselines.to_dict("records"),
        "ssim_by_window": {window: list(row) for window, row in windows.T.items()},
        "paper": paper["source"],
        "evaluation": {key: evaluation[key] for key in ("command", "date", "git_revision")},
    }
    write_json(out / f"{name}.json", record)
    write_text(out / f"{name}.csv", numbers)


def read_tables(out: Path, paper_values: Path) -> str:
    """Both tables of a results folder as Markdown, missing ones shown as missing."""
    texts = []
    for name in TABLES:
        if read_result_record(out, name) is not None:
            texts.append(read_text(out / f"{name}.md"))
        else:
            texts.append(table_markdown(None, read_paper_values(paper_values, name), None))
    return "\n".join(texts)


def scenes_sha256(dataset: Dataset) -> str:
    """Hash of the configuration: the same on all machines, whose rounding may differ."""
    asked = {**config_to_json(dataset.config), "samples": len(dataset)}
    return hashlib.sha256(json.dumps(asked, sort_keys=True).encode()).hexdigest()


def evaluate_run(run: Path, table: str, figure: str, paper_values: Path, out: Path) -> None:
    """Score a run's test split; write its table and the figure of its first test sample."""
    record = dict(open_run(run).record)
    paper = read_paper_values(paper_values, table)
    tqdm.write(f"Scoring {record['parts']['test']} test samples of {run}")
    dataset, indices, predictions = predict_test_split(run)
    record["scenes_sha256"] = scenes_sha256(dataset)
    targets = dataset.targets[indices]
    scores = compare_with_paper(score(targets, predictions), paper)
    light_field, _ = render_sample(dataset.config, int(indices[0]), dataset.attrs.get("rays"))
    picture = result_figure(
        light_field,
        dataset.inputs[indices[0]].squeeze(),
        targets[0],
        predictions[0],
        dataset.config.depths_mm,
        f"{record['title']}: sample {indices[0]}, the first of the test split "
        f"({recipe_in_words(record['preset'])})",
    )
    train = training_indices(len(dataset), record)
    baselines = score_baselines(dataset, train, indices)
    windows = score_windows(targets, predictions)
    history = read_text(run / "history.csv")
    figures.save(picture, out / f"{figure}.png")
    write_text(out / f"{table}_history.csv", history)
    write_table(scores, baselines, windows, paper, record, table, out)
