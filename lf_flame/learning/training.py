"""Training the decoder on cached backbone features; resumable, with a record of its origin.

The run folder is that of `lf_flame.learning.training_run`. Epoch 0 of the history is the start; its
seconds include everything before training: reading, the backbone's features, the warm start.
"""

import math
import time
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import keras
import numpy as np
from tqdm import tqdm

from lf_flame._common.config import build, strict
from lf_flame._common.input_files import read_toml
from lf_flame._common.recorded_paths import recorded_path
from lf_flame.datasets.split import split_indices
from lf_flame.datasets.store import Dataset
from lf_flame.errors import InputError
from lf_flame.learning.backbone import NO_BACKBONE, build_backbone, describe_weights
from lf_flame.learning.decoder import build_refocus_resnet50
from lf_flame.learning.feature_stream import FeatureStream, compute_features
from lf_flame.learning.imagenet_weights import ImagenetUnavailable, imagenet_file
from lf_flame.learning.run_folders import describe_dataset
from lf_flame.learning.trainers import decoder_variables, make_trainer
from lf_flame.learning.training_run import MOST_EPOCHS, Job, assign, carry_out, check_seed
from lf_flame.learning.warm_start import Blocks, freeze_normalisations, solve_decoder


@strict
@dataclass(frozen=True)
class ModelConfig:
    """Arguments of `lf_flame.learning.decoder.build_refocus_resnet50`; see there."""

    backbone_weights: str = "imagenet"
    backbone_depth: Literal["conv3", "conv4", "conv5", "none"] = "conv5"
    dropout: float = 0.3


@strict
@dataclass(frozen=True)
class Recipe:
    """Options of a training.

    Parameters
    ----------
    epochs, batch_size : int
        Number of epochs, and of samples in a batch. With 0 epochs the decoder stays as the warm
        start set it: solved in closed form, not trained.
    learning_rate : float
        Learning rate of Adam; with "cosine" its initial value.
    schedule : {"constant", "cosine"}
        Course of the learning rate; "cosine" falls to zero over all epochs.
    checkpoint_s : float
        Time between checkpoints in seconds; 0 writes one after every epoch.
    without_imagenet : {"random", "stop"}
        Behaviour if the ImageNet weights are not available.
    warm_start : bool
        Whether the decoder starts from the training images, with frozen normalisations, see
        `lf_flame.learning.warm_start`.
    bands : int
        Number of vertical bands of the image in a warm start with neck "positions"; each band is
        computed only from features in the same band.
    refinements : int
        Number of refinement steps in a warm start with neck "positions", see
        `lf_flame.learning.sigmoid_regression`.
    dropout_place, neck
        See `lf_flame.learning.decoder.build_refocus_resnet50`; the defaults are the paper's.
    fresh_scenes : int
        Number of training scenes beside those of the data set (`lf_flame.datasets.fresh_scenes`);
        validation and test do not change. Without epochs they are released after one use.
    backbone_depth : {"conv3", "conv4", "conv5", "none"}, optional
        Depth at which the backbone is cut. Default: that of the model's configuration.
    trainer : {"fast", "keras"}
        Kind of trainer: "keras" uses Keras's own `compile` and `fit`; "fast" gives the same losses
        in a fraction of the time, see `lf_flame.learning.trainers`.
    """

    epochs: int = 0
    batch_size: int = 2
    learning_rate: float = 1e-4
    schedule: Literal["constant", "cosine"] = "constant"
    checkpoint_s: float = 0.0
    without_imagenet: Literal["random", "stop"] = "stop"
    warm_start: bool = False
    bands: int = 1
    refinements: int = 0
    dropout_place: Literal["image", "vector", "none"] = "image"
    neck: Literal["pooled", "positions"] = "pooled"
    fresh_scenes: int = 0
    backbone_depth: Literal["conv3", "conv4", "conv5", "none"] | None = None
    trainer: Literal["fast", "keras"] = "fast"

    def __post_init__(self):
        if self.epochs == 0 and self.schedule == "cosine":
            raise InputError("A cosine schedule needs epochs over which it falls, got 0 epochs.")
        least = {
            "epochs": not self.warm_start, "batch_size": 1, "bands": 1, "refinements": 0,
            "fresh_scenes": 0,
        }  # fmt: skip
        for name, bound in least.items():
            if not bound <= getattr(self, name) <= MOST_EPOCHS:
                raise InputError(
                    f"{name} must be from {bound:d} to {MOST_EPOCHS}, got {getattr(self, name)}."
                )
        if not self.learning_rate > 0:
            raise InputError(f"learning_rate must be above 0, got {self.learning_rate}.")

    @property
    def needs_all_features(self) -> bool:
        """Whether the features of all samples are needed more than once."""
        return self.epochs > 0 or self.neck == "pooled"


@strict
@dataclass(frozen=True)
class TrainingConfig:
    """A training experiment; `read_training_config` reads it from a TOML file.

    Parameters
    ----------
    title : str
        Title of the experiment.
    seed : int
        Seed of the split, the initial weights, the order of the batches and the dropout.
    split : (float, float, float)
        Fractions of training, validation and test.
    model : ModelConfig
        Options of the model.
    presets : dict of Recipe
        Named sets of training options.
    """

    title: str
    seed: int
    presets: dict[str, Recipe]
    model: ModelConfig = field(default_factory=ModelConfig)
    split: tuple[float, float, float] = (0.8, 0.1, 0.1)

    def __post_init__(self):
        if min(self.split) <= 0 or abs(sum(self.split) - 1) > 1e-9:
            raise InputError(f"split must be three positive shares of 1, got {self.split}.")
        check_seed(self.seed)

    def recipe(self, preset: str) -> Recipe:
        """Training options of a preset."""
        if preset not in self.presets:
            raise InputError(f"preset must be one of {', '.join(self.presets)}, got {preset!r}.")
        return self.presets[preset]

    def with_epochs(self, preset: str, epochs: int) -> "TrainingConfig":
        """Give the configuration with another number of epochs for a preset."""
        recipe = replace(self.recipe(preset), epochs=epochs)
        return replace(self, presets={**self.presets, preset: recipe})

    def with_recipe(self, preset: str) -> "TrainingConfig":
        """Give the configuration with the backbone depth that a preset states, if any."""
        depth = self.recipe(preset).backbone_depth or self.model.backbone_depth
        return replace(self, model=replace(self.model, backbone_depth=depth))


def read_training_config(path: str | Path, **model_options: Any) -> TrainingConfig:
    """Read a training configuration from a TOML file.

    Options of the model that are given and not None replace those of the file and of its presets.

    Raises
    ------
    InputError
        If the file cannot be read, or a value cannot be used.

    Examples
    --------
    >>> from lf_flame.learning import read_training_config
    >>> config = read_training_config("training.toml", backbone_weights="random")
    >>> config.model.backbone_weights
    'random'
    """
    config = build(TrainingConfig, read_toml(path), path)
    options = {name: value for name, value in model_options.items() if value is not None}
    presets = config.presets
    if "backbone_depth" in options:
        presets = {name: replace(x, backbone_depth=None) for name, x in presets.items()}
    return replace(config, model=replace(config.model, **options), presets=presets)


def build_model(
    config: TrainingConfig, recipe: Recipe, dataset: Dataset
) -> tuple[keras.Model, str]:
    """Build the network for a data set, with a random backbone if ImageNet's is not available.

    Returns
    -------
    keras.Model
        Network.
    str
        Backbone weights that were used, for tables and records.
    """
    planes, *image = dataset.targets.shape[1:]
    options = {**asdict(config.model), "seed": config.seed, "shown": dataset.inputs.shape[1:]}
    options |= {"dropout_place": recipe.dropout_place, "neck": recipe.neck}
    options["backbone_weights"] = available_weights(config.model, recipe)
    model = build_refocus_resnet50(tuple(image), planes, **options)
    weights = describe_weights(
        options["backbone_weights"], options["backbone_depth"], options["seed"]
    )
    return model, weights


def available_weights(model: ModelConfig, recipe: Recipe) -> str:
    """Find the backbone's weights: the configured ones, or "random" if the recipe allows it.

    Raises
    ------
    ImagenetUnavailable
        If ImageNet's are not available, and the recipe does not continue without them.
    """
    if model.backbone_weights != "imagenet" or model.backbone_depth == NO_BACKBONE:
        return model.backbone_weights
    try:
        imagenet_file()
    except ImagenetUnavailable as error:
        choice = (
            "--backbone-weights FILE takes them from a file, --backbone-weights random does "
            "without (as a variable of make: BACKBONE_WEIGHTS)"
        )
        if recipe.without_imagenet == "stop":
            raise ImagenetUnavailable(f"{error} {choice}.") from None
        tqdm.write(f"NOTE: {error} Going on with RANDOM backbone weights; {choice}.")
        return "random"
    return "imagenet"


def find_backbone(config: TrainingConfig, preset: str) -> str:
    """Find the backbone's weights and load them, before other work depends on them.

    Returns
    -------
    str
        Name of the weights that a training with this preset would use, as in its record.

    Raises
    ------
    InputError
        If they are not available, or a file does not contain them.
    """
    model = config.with_recipe(preset).model
    weights = available_weights(model, config.recipe(preset))
    if weights not in ("imagenet", "random"):
        build_backbone(weights=weights, depth=model.backbone_depth)
    return describe_weights(weights, model.backbone_depth, config.seed)


def train(
    config: TrainingConfig,
    preset: str,
    data: str | Path,
    out: str | Path,
    show: bool = True,
    *,
    minutes: float = 0.0,
) -> Path:
    """Train a model, or continue a run that was interrupted.

    Parameters
    ----------
    config : TrainingConfig
        Configuration.
    preset : str
        Name of the preset in the configuration.
    data : str or Path
        Data set made by `lf_flame.datasets.making.make_dataset`.
    out : str or Path
        Run folder.
    show : bool, optional
        Whether to show progress.
    minutes : float, optional
        Time in minutes after which the call ends, after the current epoch, with the best network
        so far; the next call continues. 0 trains to the end.

    Returns
    -------
    Path
        Network ``model.keras`` in the run folder.

    Raises
    ------
    InputError
        If the run folder contains a run with another configuration, or the loss becomes NaN or
        infinite.
    """
    started = time.perf_counter()
    if not 0 <= minutes < math.inf:
        raise InputError(f"minutes must be 0 (to the end) or more, got {minutes}.")
    training = _Training(config.with_recipe(preset), preset, Dataset(data))
    recipe = training.recipe
    job = Job(
        training.request(),
        recipe.epochs,
        config.seed,
        recipe.checkpoint_s,
        training.start,
        training.finish,
        {**training.metadata(), "data": recorded_path(data, out)},
        minutes,
    )
    return carry_out(job, Path(out), started, show)


class _Training:
    """Network, recipe and data of a training.

    Attributes
    ----------
    recipe : Recipe
    parts : dict of ndarray of int
        Indices of the samples of each part: train, validation, test.

    Raises
    ------
    InputError
        If the recipe does not fit the data set, or the backbone's weights are not available.
    """

    def __init__(self, config: TrainingConfig, preset: str, dataset: Dataset):
        self.recipe = recipe = config.recipe(preset)
        self._config, self._preset, self._dataset = config, preset, dataset
        self.parts = split_indices(len(dataset), config.split, config.seed)
        if recipe.warm_start and recipe.bands > 1 and dataset.config.input.kind == "grid":
            raise InputError(
                f"The warm start draws each of {recipe.bands} bands from the same band of what the "
                f"network is shown, and views side by side have none: bands must be 1 with a grid."
            )
        self._model, self._weights = build_model(config, recipe, dataset)
        self._decoder = self._model.get_layer("decoder")

    def request(self) -> dict:
        """Everything that determines the result, as `Job.request`."""
        config = self._config
        return {
            "title": config.title,
            "preset": self._preset,
            "seed": config.seed,
            "split": list(config.split),
            "model": _without_folder(asdict(config.model)),
            "recipe": asdict(self.recipe),
            "backbone_weights": self._weights,
            "data_sha256": self._dataset.attrs["sha256"],
        }

    def metadata(self) -> dict:
        """Further content of the record, as `Job.metadata`."""
        sizes = {name: len(indices) for name, indices in self.parts.items()}
        sizes["train"] += self.recipe.fresh_scenes
        return {
            "backbone_depth": self._config.model.backbone_depth,
            "parts": sizes,
            "test_indices": self.parts["test"].tolist(),
            "dataset": describe_dataset(self._dataset),
        }

    def start(self, new: bool):
        """Make the trainer; a new run may start from the training images."""
        recipe, dataset, decoder = self.recipe, self._dataset, self._decoder
        stream = FeatureStream(
            self._model,
            dataset,
            self.parts["train"],
            recipe.fresh_scenes,
            recipe.needs_all_features,
        )
        shown, targets = (x[self.parts["validation"]] for x in (dataset.inputs, dataset.targets))
        held_out = compute_features(self._model, shown), targets[..., None]
        if recipe.warm_start:
            freeze_normalisations(decoder)
            if new:
                pairs = [stream.kept()] if recipe.needs_all_features else stream
                blocks = Blocks(len(stream), pairs)
                solve_decoder(decoder, blocks, held_out, recipe.bands, recipe.refinements)
        arrays = {"train": stream.kept(), "validation": held_out}
        steps = -(-len(arrays["train"][0]) // recipe.batch_size)
        rate = _learning_rate(recipe, steps)
        return make_trainer(decoder, rate, recipe.batch_size, arrays, recipe.trainer)

    def finish(self, best: list[np.ndarray]) -> keras.Model:
        """Give the network with the best weights."""
        assign(decoder_variables(self._decoder), best)
        return self._model


def _without_folder(model: dict) -> dict:
    """Model options with the weights file's name only: its hash in the record identifies it."""
    return {**model, "backbone_weights": Path(model["backbone_weights"]).name}


def _learning_rate(recipe: Recipe, steps_per_epoch: int):
    if recipe.schedule == "constant":
        return recipe.learning_rate
    return keras.optimizers.schedules.CosineDecay(
        recipe.learning_rate, recipe.epochs * steps_per_epoch
    )
