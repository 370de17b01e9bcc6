"""Configuration of a training: model, recipes by preset, split and seed."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from lf_flame._common.config import build, strict
from lf_flame._common.input_files import read_toml
from lf_flame.errors import InputError

MOST_EPOCHS = 999_999
"""Maximum number of epochs."""


def check_seed(seed: int) -> None:
    """Refuse a seed too large for the layers, whose 32-bit seeds are 1000 times it and more."""
    if not 0 <= seed <= 1_000_000:
        raise InputError(f"seed must be 0 to 1000000, got {seed}.")


@strict
@dataclass(frozen=True)
class ModelConfig:
    """Arguments of `lf_flame.learning.decoder.build_refocus_resnet50`; see there."""

    backbone_weights: str = "imagenet"
    backbone_depth: Literal["conv3", "conv4", "conv5", "none"] = "conv5"
    dropout: float = 0.3
    dropout_place: Literal["image", "vector", "none"] = "image"


@strict
@dataclass(frozen=True)
class Recipe:
    """Options of a training; the defaults are the paper's.

    Parameters
    ----------
    epochs, batch_size : int
        Number of epochs, and of samples in a batch.
    learning_rate : float
        Learning rate of Adam.
    checkpoint_s : float
        Time between checkpoints in seconds; 0 writes one after every epoch.
    without_imagenet : {"random", "stop"}
        Behaviour if the ImageNet weights are not available.
    """

    epochs: int
    batch_size: int = 2
    learning_rate: float = 1e-4
    checkpoint_s: float = 0.0
    without_imagenet: Literal["random", "stop"] = "stop"

    def __post_init__(self):
        for name in ("epochs", "batch_size"):
            if not 1 <= (value := getattr(self, name)) <= MOST_EPOCHS:
                raise InputError(f"{name} must be from 1 to {MOST_EPOCHS}, got {value}.")
        if not self.learning_rate > 0:
            raise InputError(f"learning_rate must be above 0, got {self.learning_rate}.")


@strict
@dataclass(frozen=True)
class TrainingConfig:
    """A training experiment; `read_training_config` reads it from a TOML file.

    Parameters
    ----------
    title : str
        Title of the experiment.
    seed : int
        Seed of the split, the initial weights, the order of the samples and the dropout.
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
            raise InputError(f"split must be positive fractions with sum 1, got {self.split}.")
        check_seed(self.seed)

    def recipe(self, preset: str) -> Recipe:
        """Training options of a preset."""
        if preset not in self.presets:
            raise InputError(f"preset must be one of {', '.join(self.presets)}, got {preset!r}.")
        return self.presets[preset]

    def with_epochs(self, preset: str, epochs: int) -> "TrainingConfig":
        """Copy the configuration with another number of epochs for a preset."""
        recipe = replace(self.recipe(preset), epochs=epochs)
        return replace(self, presets={**self.presets, preset: recipe})


def read_training_config(path: str | Path, **model_options: Any) -> TrainingConfig:
    """Read a training configuration from a TOML file.

    Options of the model that are given and not None replace those of the file.

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
    return replace(config, model=replace(config.model, **options))
