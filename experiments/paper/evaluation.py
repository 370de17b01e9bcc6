"""Scores on the test split, with and without a network, and the slopes of sharpest focus."""

import math
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
from skimage.metrics import structural_similarity
from tqdm import tqdm

from experiments.linear import RIDGE, Ridge
from experiments.paper.figures import result_figure, setup_figure
from experiments.paper.tables import TABLES, compare_with_paper, read_paper_values
from experiments.report import markdown, write_report
from lf_flame._common import figures, provenance
from lf_flame._common.atomic_files import write_json, write_text
from lf_flame._common.config import to_json
from lf_flame._common.input_files import printable, read_text
from lf_flame.datasets.config import DatasetConfig
from lf_flame.datasets.sampling import render_sample, search_slopes
from lf_flame.datasets.store import Dataset, split_indices
from lf_flame.errors import InputError
from lf_flame.learning.run_folders import open_run
from lf_flame.learning.scores import score, ssim
from lf_flame.learning.training_config import TrainingConfig

WINDOWS = {
    "Gaussian, 1.5 pixels (the table's)": ssim,
    "7 x 7, scikit-image's default": partial(structural_similarity, data_range=1.0, win_size=7),
    "11 x 11": partial(structural_similarity, data_range=1.0, win_size=11),
}
"""Windows of the structural similarity by name."""


def score_windows(targets: np.ndarray, predictions: np.ndarray) -> dict[str, list[float]]:
    """Score SSIM of each plane with several windows, because the paper does not state its own."""
    pairs = list(zip(targets, predictions, strict=True))
    return {
        window: np.mean(
            [[measure(a, b) for a, b in zip(*pair, strict=True)] for pair in pairs], axis=0
        ).tolist()
        for window, measure in WINDOWS.items()
    }


def score_baselines(
    dataset: Dataset, split: tuple[float, float, float], seed: int
) -> dict[str, list[dict]]:
    """Score images that need no network on the test split, rows of each plane by baseline.

    The mean training image, and the ridge regression of `experiments.linear`.
    """
    parts = split_indices(len(dataset), split, seed)
    targets = dataset.targets[parts["test"]]
    mean = dataset.targets[parts["train"]].mean(axis=0)
    images = {
        "mean training image": np.broadcast_to(mean, targets.shape),
        RIDGE: Ridge(dataset, parts).predict(dataset.inputs[parts["test"]]),
    }
    return {
        name: score(targets, found).assign(depth_mm=dataset.config.depths_mm).to_dict("records")
        for name, found in images.items()
    }


def baseline_report(data: Path, config: TrainingConfig, out: Path) -> str:
    """Score a data set without a network; writes ``TABLE_baselines.csv``, ``.md`` and ``.json``."""
    dataset = Dataset(data)
    table, found = TABLES[dataset.config.kind], score_baselines(dataset, config.split, config.seed)
    rows = pd.concat([pd.DataFrame(rows).assign(baseline=name) for name, rows in found.items()])
    rows = rows[["baseline", "depth_mm", "ssim", "psnr_db", "psnr_foreground_db"]].round(4)
    record = {"data": str(data), "seed": config.seed, "split": config.split, "baselines": found}
    title = f"{read_paper_values(table)['title']}, without a network"
    name = f"{table}_baselines"
    path = write_report(out, name, title, record, [markdown(rows)], tables={name: rows})
    return path.read_text(encoding="utf-8")


def evaluate_run(folder: Path, out: Path) -> None:
    """Score a run's test split; write its table, and the figure of its first test sample.

    Writes ``figure7.png``, ``table1_history.csv``, ``table1.json`` and, last because make looks at
    it, ``table1.csv``; for flames ``figure8.png`` and the files of ``table2``.
    """
    run = open_run(folder)
    table = TABLES[run.config.kind]
    figure = {"table1": "figure7", "table2": "figure8"}[table]
    record, paper = dict(run.record), read_paper_values(table)
    planes = [paper["object"], paper["depth_mm"]]
    if [run.objects, run.config.depths_mm] != planes or run.config.shuffled_depths:
        raise InputError(f"{folder} must be a run of the paper's {planes[0]} at {planes[1]} mm.")
    tqdm.write(f"Scoring {record['parts']['test']} test samples of {printable(folder)}")
    dataset, indices, predictions = run.predict_test_split()
    targets = dataset.targets[indices]
    scores = compare_with_paper(score(targets, predictions), paper)
    del record["test_indices"]
    record |= {
        "table": scores.to_dict("records"),
        "ssim_by_window": score_windows(targets, predictions),
        "paper": paper["source"],
        "evaluation": provenance.environment(),
    }
    light_field, _ = render_sample(dataset.config, int(indices[0]), dataset.attrs.get("rays"))
    picture = result_figure(
        light_field,
        dataset.inputs[indices[0]].squeeze(),
        targets[0],
        predictions[0],
        dataset.config.depths_mm,
        f"{record['title']}: sample {indices[0]}, the first of the test split "
        f"({record['preset']} recipe)",
    )
    figures.save(picture, out / f"{figure}.png")
    write_text(out / f"{table}_history.csv", read_text(folder / "history.csv"))
    write_json(out / f"{table}.json", record)
    shown = scores[["depth_mm", "psnr_db", "paper_psnr_db", "ssim", "paper_ssim"]].round(3)
    tqdm.write(f"{markdown(shown)}\n")
    write_text(out / f"{table}.csv", scores.round(6).to_csv(index=False))


def slope_report(configs: list[DatasetConfig], out: Path | None) -> str:
    """Search the slopes of data-set templates; write the table, and Figures 5 and 6, into `out`."""
    if out is not None and len({config.kind for config in configs}) < len(configs):
        raise InputError("Two configurations of one kind have one figure: leave out --out.")
    paper = read_paper_values("slopes")
    printed = dict(zip(paper["depth_mm"], paper["slope"], strict=True))
    rows, records = [], []
    for config in configs:
        searches = search_slopes(config, whole_range=True)
        records.append({"config": to_json(config), "slopes": [s.slope for s in searches]})
        for item, search in zip(config.template.objects, searches, strict=True):
            geometry = config.camera.depth_to_slope(item.depth_mm)
            rows.append({
                "data_set": config.kind, "object": item.name, "depth_mm": item.depth_mm,
                "slope": search.slope, "geometry": geometry,
                "difference": search.slope - geometry,
                "paper": printed.get(item.depth_mm, math.nan),
            })  # fmt: skip
    table = pd.DataFrame(rows).round(4).replace(-0.0, 0.0)
    body = [
        "Slopes in lenslets per view step, found by gradient energy on the mean scene; geometry: "
        "from the camera's equation; paper: as printed.",
        markdown(table, {
            "data_set": ("data set", ""), "object": ("object", ""), "depth_mm": ("depth (mm)", "g"),
            "slope": ("found", ".4f"), "geometry": ("geometry", ".4f"),
            "difference": ("found - geometry", "+.4f"), "paper": ("paper", ".2f"),
        }),
    ]  # fmt: skip
    if out is None:
        return "\n\n".join(body)
    numbers = {"shapes": "figure5", "flames": "figure6"}
    setups = {numbers[config.kind]: setup_figure(config) for config in configs}
    path = write_report(
        out, "slopes", paper["title"], {"data_sets": records}, body, tables={"slopes": table},
        pictures=setups,
    )  # fmt: skip
    return path.read_text(encoding="utf-8")
