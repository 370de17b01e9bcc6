"""Configuration of a training: model, recipes by preset, split and seed."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from lf_flame._common.config import build, strict
from lf_flame._common.input_files import read_toml
from lf_flame.errors import InputError
from lf_flame.learning.training_run import MOST_EPOCHS, check_seed


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
