"""Studies: variants of a data set, a model and a recipe, compared on the same test samples.

A study file (experiments/studies/*.toml) names a data set, a training configuration, and what each
variant changes of them. With a preset, a network is trained for each variant. Beside it, and alone
without a preset, come two results that need no training: the ridge regression of
`experiments.linear`, and its bound.

The folder WORK/STUDY contains for each variant its data set (or that of the first with the same
one), its run, and last VARIANT.json, its scores. A study resumes where it was stopped.
"""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from textwrap import fill
from typing import Any

import keras
import numpy as np
import pandas as pd
from tqdm import tqdm

from experiments.linear import Ridge, project
from experiments.paper.tables import TABLES, read_paper_values
from experiments.report import markdown, panels, write_report
from lf_flame._common.atomic_files import write_json
from lf_flame._common.config import build, strict, to_json
from lf_flame._common.input_files import read_record, read_toml
from lf_flame.datasets.config import DatasetConfig, config_from_json
from lf_flame.datasets.making import make_dataset
from lf_flame.datasets.store import Dataset, split_indices
from lf_flame.errors import InputError
from lf_flame.learning.decoder import AVERAGES
from lf_flame.learning.run_folders import open_run
from lf_flame.learning.scores import score
from lf_flame.learning.training import train
from lf_flame.learning.training_config import TrainingConfig

MEASURES = ["ssim", "psnr_db", "psnr_foreground_db"]
COLUMNS = ["variant", "system", "epochs", "best_epoch", "depth_mm", "object", *MEASURES]


@strict
@dataclass(frozen=True)
class Changes:
    """Changes to the TOML values of a data set, and of a model and recipe.

    Tables merge key by key, lists of tables of the same length one by one; all else is replaced.
    """

    data: dict[str, Any] = field(default_factory=dict)
    model: dict[str, Any] = field(default_factory=dict)
    recipe: dict[str, Any] = field(default_factory=dict)


@strict
@dataclass(frozen=True, kw_only=True)
class Variant(Changes):
    """A variant of a study, by its changes."""

    name: str


@strict
@dataclass(frozen=True)
class Study:
    """A study; files of data set and training are named from the working directory.

    `common` changes apply to all variants, before their own. Without a preset nothing is trained.
    """

    title: str
    data: str
    training: str
    samples: int
    variants: list[Variant]
    preset: str | None = None
    common: Changes = field(default_factory=Changes)

    def __post_init__(self):
        names = [variant.name for variant in self.variants]
        for name in names:
            if names.count(name) > 1 or not re.fullmatch(r"[\w .,:%()-]*[\w%)]", name):
                raise InputError(f"A variant needs a unique name, in words, got {name!r}.")


@dataclass(frozen=True)
class Trial:
    """A variant with its data set, and its training with one preset, or with none."""

    variant: Variant
    data: DatasetConfig
    training: TrainingConfig
    preset: str | None

    @property
    def request(self) -> dict:
        """Configuration of data set and training, as JSON values."""
        return {"data": to_json(self.data), "training": to_json(self.training)}

    @property
    def parts(self) -> dict[str, np.ndarray]:
        """Samples for training, validation and test, the same in all variants."""
        (samples,) = self.data.samples.values()
        return split_indices(samples, self.training.split, self.training.seed)

    def read_score(self, work: Path) -> dict | None:
        """Read the scores from the study's work folder; None if there are none of this trial."""
        path = work / f"{self.variant.name}.json"
        found = read_record(path) if path.exists() else {}
        return found if found.get("request") == self.request else None


def read_study(path: str | Path) -> tuple[Study, list[Trial]]:
    """Read a study file and build the configurations of all its variants.

    An InputError names the file that cannot be read, or the value that cannot be used.
    """
    study = build(Study, read_toml(path), path)
    data, training = read_toml(study.data), read_toml(study.training)
    return study, [
        _build_trial(study, variant, data, training, f"{path}: variant {variant.name!r}")
        for variant in study.variants
    ]


def _build_trial(study: Study, variant: Variant, data: dict, training: dict, source: str) -> Trial:
    presets = training.get("presets", {})
    if study.preset is not None and study.preset not in presets:
        raise InputError(
            f"{source}: {study.training} has presets {', '.join(presets)}, got {study.preset!r}."
        )
    values = {
        "data": data, "model": training.get("model", {}), "recipe": presets.get(study.preset, {}),
    }  # fmt: skip
    for changes in (study.common, variant):
        values = _merge(values, {name: getattr(changes, name) for name in values})
    if study.preset is not None:
        presets = {study.preset: {**values["recipe"], "without_imagenet": "stop"}}
    config = {**training, "model": values["model"], "presets": presets}
    dataset = config_from_json({**values["data"], "samples": {"study": study.samples}}, source)
    trial = Trial(variant, dataset, build(TrainingConfig, config, source), study.preset)
    trial.parts  # noqa: B018 - refuses too few samples
    return trial


def _merge(values, changes):
    """Apply changes to parsed TOML values; see `Changes`."""
    both = (values, changes)
    if all(isinstance(x, dict) for x in both):
        return values | {key: _merge(values.get(key), change) for key, change in changes.items()}
    tables = all(isinstance(x, list) and all(isinstance(y, dict) for y in x) for x in both)
    if tables and len(values) == len(changes):
        return [_merge(*pair) for pair in zip(*both, strict=True)]
    return changes


def run_study(path: Path, out: Path, work: Path, workers: int = 1) -> Path:
    """Score the variants of a study that are not yet done; report after each.

    A variant whose network cannot be trained, as without its weights, shows as a dash.
    """
    study, trials = read_study(path)
    work = work / path.stem
    for number, trial in enumerate(trials, 1):
        if trial.read_score(work) is None:
            tqdm.write(f"{number} of {len(trials)}: {trial.variant.name}")
            first = next(one for one in trials if one.request["data"] == trial.request["data"])
            try:
                run_trial(trial, work, work / f"{first.variant.name}.zarr", workers)
            except InputError as error:
                tqdm.write(f"Left out: {error}")
            write(path.stem, study, trials, work, out)
    return write(path.stem, study, trials, work, out)


def run_trial(trial: Trial, work: Path, data: Path, workers: int) -> None:
    """Make the data set, train and score, or resume where an earlier call was stopped."""
    if not data.exists():
        make_dataset(trial.data, *trial.data.samples.values(), data, workers)
    found, dataset, parts = {"request": trial.request}, Dataset(data), trial.parts
    if dataset.config != trial.data:
        raise InputError(f"{data} is of another configuration than the study; remove it.")
    train_targets, targets = (dataset.targets[parts[part]] for part in ("train", "test"))
    objects = [item.name for item in trial.data.template.objects]
    images = {
        "linear": Ridge(dataset, parts).predict(dataset.inputs[parts["test"]]),
        # The objects are side by side and vary independently: a band for each.
        "bound": project(train_targets, targets, AVERAGES, bands=len(objects)),
    }
    if trial.preset is not None:
        # Another number of epochs begins anew.
        folder = work / f"{trial.variant.name}, {trial.training.recipe(trial.preset).epochs} epochs"
        keras.utils.clear_session()  # frees the networks of the variants before
        train(trial.training, trial.preset, data, folder)
        images = {"network": open_run(folder).predict_test_split()[2], **images}
        (folder / "checkpoint.npz").unlink(missing_ok=True)  # hundreds of megabytes
        kept = ("epochs", "best_epoch", "backbone_weights", "machine", "git_revision", "versions")
        run = open_run(folder).record
        found |= {name: run[name] for name in kept if name in run}
    found["planes"] = [
        row
        for system, drawn in images.items()
        for row in score(targets, drawn)[MEASURES]
        .assign(system=system, depth_mm=trial.data.depths_mm, object=objects)
        .to_dict("records")
    ]
    write_json(work / f"{trial.variant.name}.json", found)


def write(name: str, study: Study, trials: Sequence[Trial], work: Path, out: Path) -> Path:
    """Write ``NAME.csv``, ``.md``, ``.png`` and ``.json``."""
    paper = read_paper_values(TABLES[trials[0].data.kind])
    found = {trial.variant.name: trial.read_score(work) for trial in trials}
    rows = tabulate([(trial.variant, found[trial.variant.name]) for trial in trials])
    parts = {part: len(indices) for part, indices in trials[0].parts.items()}
    done = {name: scores for name, scores in found.items() if scores is not None}
    record = {"study": to_json(study), "parts": parts, "results": done, "paper": paper["source"]}
    return write_report(
        out, name, study.title, record, report_body(study, rows, record, paper),
        tables={name: rows.round(4)}, pictures={name: draw_scores(study, rows, paper)},
    )  # fmt: skip


def tabulate(scores: Sequence[tuple[Variant, dict | None]]) -> pd.DataFrame:
    """Tabulate scores, columns as in `COLUMNS`; a missing variant has no rows."""
    rows = [
        {"variant": variant.name, **(found if plane["system"] == "network" else {}), **plane}
        | {"psnr_db": math.inf if plane["psnr_db"] is None else plane["psnr_db"]}
        for variant, found in scores
        for plane in (found or {"planes": []})["planes"]
    ]
    return pd.DataFrame(rows, columns=COLUMNS).astype({"epochs": float, "best_epoch": float})


def report_body(study: Study, rows: pd.DataFrame, record: dict, paper: dict) -> list[str]:
    """Write the table, and how it was made, as Markdown."""
    lines = []
    for variant in study.variants:
        line = {"variant": variant.name}
        for system, planes in rows[rows.variant == variant.name].groupby("system", sort=False):
            line[system] = (
                f"{planes.psnr_db.mean():.2f}, {planes.psnr_db.min():.2f}, {planes.ssim.mean():.4f}"
            )
            if system == "network":
                line["best epoch"] = (
                    f"{planes.best_epoch.iloc[0]:.0f} of {planes.epochs.iloc[0]:.0f}"
                )
        lines.append(line)
    weights = [one.get("backbone_weights") for one in record["results"].values()]
    weights = "; ".join(dict.fromkeys(name for name in weights if name))
    return [
        f"PSNR (dB), that of the worst plane, SSIM: means of {rows.depth_mm.nunique()} planes and "
        f"the same {record['parts']['test']} test samples, learnt from {record['parts']['train']}. "
        f"Printed in the paper: {np.mean(paper['psnr_db']):.2f}, {min(paper['psnr_db']):.2f}, "
        f"{np.mean(paper['ssim']):.3f}. A dash: not yet done.",
        markdown(lines, missing="-"),
        "linear: ridge regression from the network's picture to the images, no network; a raw "
        "picture is the image at 0 mm. bound: the test images projected on the first "
        f"{AVERAGES} principal components of the training images, an estimate of the best that a "
        f"decoder of {AVERAGES} fixed pictures can do. Backbone weights: {weights or 'none'}.",
    ]


def draw_scores(study: Study, rows: pd.DataFrame, paper: dict):
    """Draw PSNR and SSIM of each variant, a row, and system: mean and range of the planes."""
    names = [variant.name for variant in study.variants]
    figure, axes = panels(("PSNR (dB)", "SSIM"), (12, 2 + 0.4 * len(names)), sharey=True)
    for axis, name in zip(axes, ("psnr_db", "ssim"), strict=True):
        for system, group in rows.groupby("system", sort=False):
            planes = group.groupby("variant", sort=False)[name].agg(["mean", "min", "max"])
            reach = [planes["mean"] - planes["min"], planes["max"] - planes["mean"]]
            places = [names.index(variant) for variant in planes.index]
            axis.errorbar(planes["mean"], places, xerr=reach, fmt="o", capsize=3, label=system)
        printed = min(paper[name]), max(paper[name])
        axis.axvspan(*printed, color="0.85", label="printed, range of the planes")
    axes[0].set_xlim(right=min(axes[0].get_xlim()[1], 100))  # rounding lies beyond
    axes[0].set_yticks(range(len(names)), [fill(name, 32) for name in names])
    axes[0].set_ylim(len(names) - 0.5, -0.5)
    figure.suptitle(study.title, fontsize=11)
    handles = axes[0].get_legend_handles_labels()
    figure.legend(*handles, ncols=4, fontsize=9, loc="outside lower center")
    return figure
