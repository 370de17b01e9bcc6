"""Learning studies: variants of a data set, a model and a recipe, trained alike, set side by side.

A study file (experiments/studies/*.toml) names a data set, a training configuration and a preset,
and what each variant changes of them. All variants are scored on the same light fields, those of
the configuration's own test split. A work folder holds ``data/`` (data sets, by the hash of what
they are made of, so that variants share them) and, for each variant, ``STUDY/VARIANT/``: a run of
`lf_flame.learning.training.train` and, last, ``score.json``.
"""

import hashlib
import json
import re
import shutil
from collections.abc import Collection
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import keras
import numpy as np
from tqdm import tqdm

from experiments.studies.pca_bound import principal_component_bound
from experiments.studies.report import write
from lf_flame._common.atomic_files import write_json
from lf_flame._common.config import build, build_record, strict, to_json
from lf_flame._common.input_files import read_record, read_toml
from lf_flame._common.progress import progress_bar
from lf_flame.datasets.config import MOST_SAMPLES, DatasetConfig, config_from_json
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

TIMES = ("epochs", "best_epoch", "start_s", "train_s")
PROVENANCE = ("backbone_weights", "data_sha256", "machine", "git_revision", "versions", "date")
"""What `score.json` takes over from the record of the run."""


@strict
@dataclass(frozen=True)
class Changes:
    """What to change in the TOML values of a data set, and of a model and recipe.

    Tables merge key by key, lists of tables of the same length one by one; all else is replaced.
    """

    data: dict[str, Any] = field(default_factory=dict)
    model: dict[str, Any] = field(default_factory=dict)
    recipe: dict[str, Any] = field(default_factory=dict)


@strict
@dataclass(frozen=True, kw_only=True)
class Variant(Changes):
    """A variant of a study: a curve of the figure that it belongs to, and what it changes.

    It has a place x on the study's axis, if there is one; light fields to train on, instead of the
    training split's number; and a recipe to start from, instead of the study's.
    """

    name: str
    series: str = ""
    x: float | None = None
    training_samples: int | None = None
    preset: str | None = None

    def __post_init__(self):
        if not self.folder:
            raise InputError(f"A variant needs a name with a letter or a digit, got {self.name!r}.")

    @property
    def folder(self) -> str:
        """Name of its folder: words and numbers of its name."""
        return "-".join(re.findall(r"[\w.]*\w", self.name))


@strict
@dataclass(frozen=True)
class Axis:
    """The number in which variants differ: its name, its unit and how a figure scales it."""

    label: str
    unit: str = ""
    scale: Literal["linear", "log"] = "linear"


@strict
@dataclass(frozen=True)
class Study:
    """A study; read from experiments/studies/*.toml.

    Files of a data set and of a training experiment are named from the working directory; the
    preset is the recipe of the latter to start from. Its split makes three parts of the samples.
    `common` holds the changes of all variants; their own come behind it. With an axis x every
    variant has a place on it. A timed study is about seconds, and has to be run on an idle machine;
    else none are shown.
    """

    title: str
    data: str
    training: str
    preset: str
    samples: int
    variants: list[Variant]
    common: Changes = field(default_factory=Changes)
    x: Axis | None = None
    timed: bool = False

    def __post_init__(self):
        if not self.variants or not 1 <= self.samples <= MOST_SAMPLES:
            raise InputError(
                f"A study needs variants, and samples up to {MOST_SAMPLES}, got "
                f"{len(self.variants)} and {self.samples}."
            )
        folders = [variant.folder for variant in self.variants]
        for variant in self.variants:
            if folders.count(variant.folder) > 1:
                raise InputError(f"Two variants are called {variant.name!r}, or nearly so.")
            if (variant.x is None) != (self.x is None):
                raise InputError(
                    f"x belongs to the study and to every variant, or to none; "
                    f"variant {variant.name!r} differs."
                )


@dataclass(frozen=True)
class Plane:
    """What a score says of a plane; a noise ratio or a bound that is infinite is none in JSON."""

    depth_mm: float
    object: str
    ssim: float | None
    psnr_db: float | None
    psnr_foreground_db: float | None
    bound_db: float | None


@dataclass(frozen=True)
class Score:
    """What ``score.json`` of a trial says; there is more in it."""

    planes: list[Plane]
    test_samples: int
    training_samples: int
    epochs: int
    best_epoch: int
    backbone_weights: str
    machine: str
    train_s: float
    start_s: float | None = None


@dataclass(frozen=True)
class Trial:
    """A variant with all that it is made of: its data set and its training, with one preset each.

    The test light fields are those to score, the same for all variants.
    """

    variant: Variant
    data: DatasetConfig
    training: TrainingConfig
    test: np.ndarray

    @property
    def preset(self) -> str:
        """Name of the recipe."""
        (name,) = self.training.presets
        return name

    @property
    def request(self) -> dict:
        """What is asked for, as JSON values."""
        return {"data": to_json(self.data), "training": to_json(self.training)}

    @property
    def dataset_name(self) -> str:
        """Name of the data set's folder: a hash of what it is made of."""
        text = json.dumps(to_json(self.data), sort_keys=True)
        return f"{hashlib.sha256(text.encode()).hexdigest()[:12]}.zarr"

    def read_score(self, runs: Path) -> dict | None:
        """Read the scores from the study's work folder; None where there are none of this trial."""
        path = runs / self.variant.folder / "score.json"
        if not path.exists():
            return None
        found = read_record(path)
        build_record(Score, found, path)
        return found if found.get("request", found.get("asked")) == self.request else None


def read_study(path: str | Path) -> tuple[Study, list[Trial]]:
    """Read a study file and build the configurations of all its variants.

    An InputError says which file cannot be read or holds an unknown, missing or impossible value.
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
    recipe = training["presets"].get(preset)
    if recipe is None:
        known = ", ".join(training["presets"])
        raise InputError(f"{source}: preset must be one of {known}, got {preset!r}.")
    values = {"data": data, "model": training.get("model", {}), "recipe": recipe}
    for changes in (study.common, variant):
        values = _merge(values, {name: getattr(changes, name) for name in values})
    recipe = {**values["recipe"], "without_imagenet": "stop"}
    parts = {"model": values["model"], "presets": {preset: recipe}}
    config = build(TrainingConfig, {**training, **parts}, source)
    config, test = _with_training_samples(config, study.samples, variant, source)
    samples = {"study": study.samples}
    dataset = config_from_json({**values["data"], "samples": samples}, source)
    return Trial(variant, dataset, config, test)


def _merge(values, changes):
    """Put changes over parsed TOML values; see `Changes`."""
    both = (values, changes)
    if all(isinstance(x, dict) for x in both):
        return values | {key: _merge(values.get(key), change) for key, change in changes.items()}
    tables = all(isinstance(x, list) and all(isinstance(y, dict) for y in x) for x in both)
    if tables and len(values) == len(changes):
        return [_merge(*pair) for pair in zip(*both, strict=True)]
    return changes


def _with_training_samples(
    config: TrainingConfig, samples: int, variant: Variant, source: str
) -> tuple[TrainingConfig, np.ndarray]:
    """Let the split train on fewer samples, the rest going to the test part; and the common test.

    The split cuts one random order of the samples into three parts, so the last ones stay.
    """
    parts = split_indices(samples, config.split, config.seed)
    count, most = variant.training_samples, len(parts["train"])
    if count is None:
        return config, parts["test"]
    if not 1 <= count <= most:
        raise InputError(f"{source}: training_samples must be 1 to {most}, got {count}.")
    shares = count / samples, len(parts["validation"]) / samples
    return replace(config, split=(*shares, 1 - sum(shares))), parts["test"]


def run_study(
    path: str | Path,
    out: Path,
    work: Path,
    paper_values: Path,
    *,
    only: Collection[str] = (),
    workers: int = 1,
    imagenet: Path | None = None,
) -> Path:
    """Train and score the variants of a study that are not yet done; report after each.

    Variants whose ImageNet weights cannot be had are left out, and show as missing. The file's name
    is the study's; `work` holds data sets and runs; of the names in `only` others are reported if
    they are done; `imagenet` is a file of weights for the variants that ask for ImageNet's, by
    default Keras gets them. An InputError says that a file cannot be used, that there is no variant
    of that name, or that its folder holds a run of another configuration.
    """
    study, trials = read_study(path)
    names = [trial.variant.name for trial in trials]
    for name in only:
        if name not in names:
            raise InputError(f"{path} has no variant {name!r}; it has {', '.join(names)}.")
    runs = Path(work) / Path(path).stem

    def report() -> Path:
        return write(Path(path), study, trials, runs, paper_values, out)

    for number, trial in enumerate(trials, 1):
        if trial.variant.name in (only or names) and trial.read_score(runs) is None:
            tqdm.write(f"{number} of {len(trials)}: {trial.variant.name}")
            try:
                run_trial(trial, runs, Path(work) / "data", workers=workers, imagenet=imagenet)
            except ImagenetUnavailable:
                tqdm.write("Left out: Keras cannot get its ImageNet weights; see --imagenet.")
            report()
    return report()


def run_trial(
    trial: Trial,
    runs: Path,
    data: Path,
    *,
    workers: int = 1,
    imagenet: Path | None = None,
) -> None:
    """Make the data set, train and score, going on where an earlier call was cut off."""
    dataset, folder = data / trial.dataset_name, runs / trial.variant.folder
    if not dataset.exists():
        make_dataset(trial.data, *trial.data.samples.values(), dataset, workers, progress_bar)
    keras.utils.clear_session()  # frees the networks of the variants before
    training = trial.training
    if imagenet is not None and training.model.backbone_weights == "imagenet":
        model = replace(training.model, backbone_weights=str(imagenet))
        training = replace(training, model=model)
    train(training, trial.preset, dataset, folder)
    run = open_run(folder).record
    write_json(
        folder / "score.json",
        {
            "request": trial.request,
            "planes": _score_planes(trial, folder, run),
            "test_samples": len(trial.test),
            "training_samples": run["parts"]["train"],
            **{name: run[name] for name in TIMES if name in run},
            **{name: run[name] for name in PROVENANCE},
        },
    )
    for checkpoint in find_checkpoints(folder):  # hundreds of megabytes, needed no more
        shutil.rmtree(checkpoint)


def _score_planes(trial: Trial, folder: Path, run: dict) -> list[dict]:
    """Score the test samples plane by plane, beside the bound."""
    dataset, indices, predictions = predict_test_split(folder, trial.test)
    targets, train_targets = (
        dataset.targets[chosen] for chosen in (indices, training_indices(len(dataset), run))
    )
    scores = score(targets, predictions)
    objects = trial.data.template.objects
    table = scores[["ssim", "psnr_db", "psnr_foreground_db"]].assign(
        # The objects stand side by side and vary independently: a band for each.
        bound_db=principal_component_bound(train_targets, targets, AVERAGES, bands=len(objects)),
        depth_mm=trial.data.depths_mm,
        object=[item.name for item in objects],
    )
    return table.to_dict("records")
