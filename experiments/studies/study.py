"""Learning studies: variants of a data set, a model and a recipe, trained alike and compared.

A study file (experiments/studies/*.toml) names a data set, a training configuration and a preset,
and what each variant changes of them. All variants are scored on the same light fields, those of
the configuration's own test split. A work folder holds ``data/`` (data sets by a hash of their
configuration, so that variants share them) and, for each variant, ``STUDY/VARIANT/``: a run of
`lf_flame.learning.training.train` and, last, ``score.json``. A study resumes where it was stopped.
"""

import hashlib
import json
import re
import shutil
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from textwrap import fill
from typing import Any

import keras
import numpy as np
import pandas as pd
from tqdm import tqdm

from experiments.paper.tables import read_paper_values
from experiments.report import markdown, write_report
from experiments.studies.pca_bound import project
from lf_flame._common.atomic_files import write_json
from lf_flame._common.config import build, strict, to_json
from lf_flame._common.figures import subplots
from lf_flame._common.input_files import read_record, read_toml
from lf_flame._common.progress import progress_bar
from lf_flame.datasets.config import DatasetConfig, config_from_json
from lf_flame.datasets.making import make_dataset
from lf_flame.datasets.split import split_indices
from lf_flame.errors import InputError
from lf_flame.learning.checkpoints import find_checkpoints
from lf_flame.learning.decoder import AVERAGES
from lf_flame.learning.imagenet_weights import ImagenetUnavailable
from lf_flame.learning.run_folders import open_run, predict_test_split, training_indices
from lf_flame.learning.scores import score
from lf_flame.learning.training import train
from lf_flame.learning.training_config import TrainingConfig

MEASURES = ["ssim", "psnr_db", "psnr_foreground_db", "bound_db"]
RUN = ["training_samples", "epochs", "best_epoch", "start_s", "train_s"]
COLUMNS = ["variant", "series", "x", "depth_mm", "object", *RUN, *MEASURES]
MEAN = "mean"
"""Entry of the column "object" in rows of the mean over the planes."""

SCORES = {"psnr_db": "PSNR (dB)", "ssim": "SSIM"}
"""Labels of the scores in the figures."""


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
    """A variant of a study: its changes, its place x on the study's axis, and its curve there.

    It may have fewer training samples than the split gives, and another preset than the study.
    """

    name: str
    series: str = ""
    x: float | None = None
    training_samples: int | None = None
    preset: str | None = None

    @property
    def folder(self) -> str:
        """Name of its folder: words and numbers of its name."""
        return "-".join(re.findall(r"[\w.]*\w", self.name))


@strict
@dataclass(frozen=True)
class Study:
    """A study; files of data set and training are named from the working directory.

    `common` changes apply to all variants, before their own. `x` names the axis, if every variant
    has a place on one. A timed study compares seconds, and has to be run on an idle machine.
    """

    title: str
    data: str
    training: str
    preset: str
    samples: int
    variants: list[Variant]
    common: Changes = field(default_factory=Changes)
    x: str | None = None
    timed: bool = False

    def __post_init__(self):
        folders = [variant.folder for variant in self.variants]
        for variant in self.variants:
            if not variant.folder or folders.count(variant.folder) > 1:
                raise InputError(
                    f"A variant needs a name of its own with a letter or a digit, got "
                    f"{variant.name!r}."
                )
            if (variant.x is None) != (self.x is None):
                raise InputError(
                    f"The study and every variant need an x, or none; variant {variant.name!r} "
                    f"differs."
                )


@dataclass(frozen=True)
class Trial:
    """A variant with its data set, its training with one preset, and the common test samples."""

    variant: Variant
    data: DatasetConfig
    training: TrainingConfig
    test: np.ndarray

    @property
    def request(self) -> dict:
        """Configuration of data set and training, as JSON values."""
        return {"data": to_json(self.data), "training": to_json(self.training)}

    def read_score(self, runs: Path) -> dict | None:
        """Read the scores from the study's work folder; None if there are none of this trial."""
        path = runs / self.variant.folder / "score.json"
        found = read_record(path) if path.exists() else {}
        return found if found.get("request") == self.request else None


def read_study(path: str | Path) -> tuple[Study, list[Trial]]:
    """Read a study file and build the configurations of all its variants.

    An InputError names the file that cannot be read, or the value that cannot be used.
    """
    study = build(Study, read_toml(path), path)
    data, training = read_toml(study.data), read_toml(study.training)
    build(TrainingConfig, training, study.training)
    return study, [
        _build_trial(study, variant, data, training, f"{path}: variant {variant.name!r}")
        for variant in study.variants
    ]


def _build_trial(study: Study, variant: Variant, data: dict, training: dict, source: str) -> Trial:
    preset = variant.preset or study.preset
    if preset not in training["presets"]:
        known = ", ".join(training["presets"])
        raise InputError(f"{source}: preset must be one of {known}, got {preset!r}.")
    recipe = training["presets"][preset]
    values = {"data": data, "model": training.get("model", {}), "recipe": recipe}
    for changes in (study.common, variant):
        values = _merge(values, {name: getattr(changes, name) for name in values})
    recipe = {**values["recipe"], "without_imagenet": "stop"}
    parts = {"model": values["model"], "presets": {preset: recipe}}
    config = build(TrainingConfig, {**training, **parts}, source)
    split = split_indices(study.samples, config.split, config.seed)
    count, most = variant.training_samples, len(split["train"])
    if count is not None:
        if not 1 <= count <= most:
            raise InputError(f"{source}: training_samples must be 1 to {most}, got {count}.")
        # The split cuts one random order of the samples into three parts: the last ones stay test
        # samples, and those that are left out join them, unscored.
        shares = count / study.samples, len(split["validation"]) / study.samples
        config = replace(config, split=(*shares, 1 - sum(shares)))
    dataset = config_from_json({**values["data"], "samples": {"study": study.samples}}, source)
    return Trial(variant, dataset, config, split["test"])


def _merge(values, changes):
    """Apply changes to parsed TOML values; see `Changes`."""
    both = (values, changes)
    if all(isinstance(x, dict) for x in both):
        return values | {key: _merge(values.get(key), change) for key, change in changes.items()}
    tables = all(isinstance(x, list) and all(isinstance(y, dict) for y in x) for x in both)
    if tables and len(values) == len(changes):
        return [_merge(*pair) for pair in zip(*both, strict=True)]
    return changes


def run_study(
    path: Path, out: Path, work: Path, workers: int = 1, imagenet: Path | None = None
) -> Path:
    """Train and score the variants of a study that are not yet done; report after each.

    `imagenet` is a file of weights for the variants that need ImageNet's (default: Keras downloads
    them). Without weights they are left out, and show as a dash.
    """
    study, trials = read_study(path)
    runs = work / path.stem
    for number, trial in enumerate(trials, 1):
        if trial.read_score(runs) is None:
            tqdm.write(f"{number} of {len(trials)}: {trial.variant.name}")
            try:
                run_trial(trial, runs, work / "data", workers, imagenet)
            except ImagenetUnavailable:
                tqdm.write("Left out: Keras cannot get its ImageNet weights; see --imagenet.")
            write(path.stem, study, trials, runs, out)
    return write(path.stem, study, trials, runs, out)


def run_trial(trial: Trial, runs: Path, data: Path, workers: int, imagenet: Path | None) -> None:
    """Make the data set, train and score, or resume where an earlier call was stopped."""
    text = json.dumps(to_json(trial.data), sort_keys=True)
    dataset = data / f"{hashlib.sha256(text.encode()).hexdigest()[:12]}.zarr"
    folder, training = runs / trial.variant.folder, trial.training
    if not dataset.exists():
        make_dataset(trial.data, *trial.data.samples.values(), dataset, workers, progress_bar)
    keras.utils.clear_session()  # frees the networks of the variants before
    if imagenet is not None and training.model.backbone_weights == "imagenet":
        model = replace(training.model, backbone_weights=str(imagenet))
        training = replace(training, model=model)
    train(training, *training.presets, dataset, folder)
    run = open_run(folder).record
    kept = (*RUN[1:], "backbone_weights", "machine", "git_revision", "versions", "date")
    found = {name: run[name] for name in kept if name in run} | {
        "request": trial.request, "planes": _score_planes(trial, folder, run),
        "test_samples": len(trial.test), "training_samples": run["parts"]["train"],
    }  # fmt: skip
    write_json(folder / "score.json", found)
    for checkpoint in find_checkpoints(folder):  # hundreds of megabytes, no longer needed
        shutil.rmtree(checkpoint)


def _score_planes(trial: Trial, folder: Path, run: dict) -> list[dict]:
    """Score the test samples plane by plane, beside the bound."""
    dataset, indices, predictions = predict_test_split(folder, trial.test)
    targets = dataset.targets[indices]
    train_targets = dataset.targets[training_indices(len(dataset), run)]
    objects = [item.name for item in trial.data.template.objects]
    # The objects stand side by side and vary independently: a band for each.
    bound = score(targets, project(train_targets, targets, AVERAGES, bands=len(objects)))
    scores = score(targets, predictions).assign(
        bound_db=bound.psnr_db, depth_mm=trial.data.depths_mm, object=objects
    )
    return scores[["depth_mm", "object", *MEASURES]].to_dict("records")


def write(name: str, study: Study, trials: Sequence[Trial], runs: Path, out: Path) -> Path:
    """Write ``NAME.csv``, ``.md``, ``.png`` and ``.json``."""
    paper = read_paper_values({"shapes": "table1", "flames": "table2"}[trials[0].data.kind])
    scores = [(trial.variant, trial.read_score(runs)) for trial in trials]
    done = {variant.name: found for variant, found in scores if found is not None}
    rows = tabulate(scores)
    record = {"study": to_json(study), "results": done, "paper": paper["source"]}
    body = report_body(study, rows, list(done.values()), paper)
    return write_report(
        out, name, study.title, record, body, tables={name: rows.round(4)},
        pictures={name: draw_scores(study, rows, paper)},
    )  # fmt: skip


def tabulate(scores: Sequence[tuple[Variant, dict | None]]) -> pd.DataFrame:
    """Tabulate scores, columns as in `COLUMNS`; a missing variant has a mean of NaN."""
    rows = []
    for variant, found in scores:
        found = found or {"planes": []}
        about = {"variant": variant.name, "series": variant.series, "x": variant.x}
        about |= {name: found.get(name) for name in RUN}
        rows += [{**about, **plane} for plane in found["planes"]]
        means = pd.DataFrame(found["planes"], columns=MEASURES, dtype=float).mean()
        rows.append({**about, "object": MEAN, **means})
    return pd.DataFrame(rows, columns=COLUMNS).astype(dict.fromkeys(RUN, float))


def report_body(study: Study, rows: pd.DataFrame, done: Sequence[dict], paper: dict) -> list[str]:
    """Write the table, and how it was made, as Markdown."""
    means = rows[rows["object"] == MEAN]
    means = means.assign(seconds=means["start_s"] + means["train_s"]).astype(object)
    printed = {
        "variant": "*printed in the paper*", "psnr_db": np.mean(paper["psnr_db"]),
        "ssim": np.mean(paper["ssim"]),
    }  # fmt: skip
    columns = {
        "variant": ("variant", ""), "x": (study.x, "g"),
        "training_samples": ("training samples", ".0f"), "epochs": ("epochs", ".0f"),
        "best_epoch": ("best epoch", ".0f"), "seconds": ("seconds", ".0f"),
        "psnr_db": ("PSNR (dB)", ".2f"),
        "psnr_foreground_db": ("foreground (dB)", ".2f"), "ssim": ("SSIM", ".3f"),
        "bound_db": ("bound (dB)", ".2f"),
    }  # fmt: skip
    hidden = ["x"] * (study.x is None) + ["seconds"] * (not study.timed)
    tests = " or ".join(sorted({str(found["test_samples"]) for found in done})) or "0"
    return [
        markdown(
            pd.concat([means, pd.DataFrame([printed])]),
            {name: form for name, form in columns.items() if name not in hidden},
            missing="-",
        ),
        f"Means over the {len(paper['depth_mm'])} planes and the same {tests} test samples of each "
        "data set. Foreground: the foreground pixels of the reference alone. A dash: not yet "
        "trained, or not printed.",
        "Bound: the test images projected on the first 256 principal components of the training "
        "images, the best that a decoder of 256 fixed pictures can do "
        "(`experiments.studies.pca_bound`).",
        "Backbone weights: " + "; ".join(dict.fromkeys(x["backbone_weights"] for x in done)) + ".",
    ]


def draw_scores(study: Study, rows: pd.DataFrame, paper: dict):
    """Draw PSNR and SSIM, mean and range of the planes: one curve a series, or one row a variant.

    Curves run along x; a timed study has a point for each variant at its seconds.
    """
    listed = study.x is None and not study.timed
    if study.timed:
        rows = rows.assign(x=rows["start_s"] + rows["train_s"], series=rows["variant"])
    elif listed:
        rows = rows.assign(x=pd.factorize(rows["variant"])[0], series="mean, range of the planes")
    planes = rows[rows["object"] != MEAN].groupby("variant")
    means = rows[(rows["object"] == MEAN) & rows["psnr_db"].notna()].sort_values("x")
    names = [variant.name for variant in study.variants]
    size = (12, 2 + 0.4 * len(names)) if listed else (8, 8)
    grid = (1, 2) if listed else (2, 1)
    figure, axes = subplots(
        *grid, figsize=size, sharex=not listed, sharey=listed, layout="constrained"
    )
    for axis, (name, label) in zip(axes, SCORES.items(), strict=True):
        low, high = planes[name].min(), planes[name].max()
        for series, curve in means.groupby("series", sort=False):
            mean, x = curve.set_index("variant")[name], curve["x"]
            reach = mean - low[mean.index], high[mean.index] - mean
            if listed:
                axis.errorbar(mean, x, xerr=reach, fmt="o", capsize=3, label=series)
            else:
                axis.errorbar(x, mean, yerr=reach, fmt="o-", capsize=3, label=series)
        span = axis.axvspan if listed else axis.axhspan
        span(min(paper[name]), max(paper[name]), color="0.85", label="printed, range of the planes")
        axis.set(**{"xlabel" if listed else "ylabel": label})
        axis.grid(alpha=0.3)
    if listed:
        axes[0].set_yticks(range(len(names)), [fill(name, 32) for name in names])
        axes[0].set_ylim(len(names) - 0.5, -0.5)
    elif study.timed:
        axes[1].set_xscale("log")
        axes[1].set_xlabel("seconds, from the data set on disk to the trained network")
    else:
        bound = means.groupby("x")["bound_db"].max()
        top = axes[0].get_ylim()[1] + 15  # the bound has no limit where nothing varies
        axes[0].plot(bound.index, bound, "k--", label="bound of 256 pictures")
        axes[0].set_ylim(top=min(top, axes[0].get_ylim()[1]))
        ticks = sorted({variant.x for variant in study.variants})
        least = min((x for x in ticks if x > 0), default=1.0)
        axes[1].set_xscale("symlog", linthresh=least, linscale=0.4)  # linear near 0
        axes[1].set_xticks(ticks, [f"{x:,g}" for x in ticks])
        axes[1].set_xlim(-least / 4 if ticks[0] == 0 else least / 1.3, 1.3 * ticks[-1])
        axes[1].set_xlabel(study.x)
    figure.suptitle(study.title, fontsize=11)
    handles = axes[0].get_legend_handles_labels()
    figure.legend(*handles, ncols=2, fontsize=9, loc="outside lower center")
    return figure
