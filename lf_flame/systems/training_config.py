"""Configuration of the training of systems, from TOML."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from lf_flame._common.config import build, strict
from lf_flame._common.input_files import read_toml
from lf_flame.errors import InputError
from lf_flame.learning.training_run import MOST_EPOCHS, check_seed
from lf_flame.systems.registry import NETWORKS
from lf_flame.systems.training_scenes import TrainingSamples

SMALLEST_PATCH = 12
"""Smallest side of a patch: it contains a window of the structural similarity, and halves twice."""


@strict
@dataclass(frozen=True)
class SystemRecipe:
    """Options for training a system.

    Parameters
    ----------
    epochs : int
        Number of epochs.
    steps_per_epoch : int
        Number of the optimiser's steps in an epoch. It does not depend on a system's input, so that
        equal numbers of epochs are equal numbers of steps for all systems.
    batch_size : int
        Number of patches in a step.
    patch : int
        Side of a patch in pixels.
    learning_rate : float
        Learning rate of the optimiser; with "cosine" its initial value, falling to zero.
    schedule : {"constant", "cosine"}
        Course of the learning rate.
    optimizer : {"adam", "rmsprop"}
        Optimiser.
    low_light : float
        Fraction of the training samples in low light, with shot noise.
    """

    epochs: int
    steps_per_epoch: int = 100
    batch_size: int = 16
    patch: int = 48
    learning_rate: float = 1e-3
    schedule: Literal["constant", "cosine"] = "cosine"
    optimizer: Literal["adam", "rmsprop"] = "adam"
    low_light: float = 0.0

    def __post_init__(self):
        counts = self.epochs, self.steps_per_epoch, self.batch_size
        if min(counts) < 1 or max(counts) > MOST_EPOCHS or not self.learning_rate > 0:
            raise InputError(
                f"epochs, steps_per_epoch and batch_size must be from 1 to {MOST_EPOCHS} and "
                f"learning_rate above 0, got {', '.join(map(str, counts))}, {self.learning_rate}."
            )
        if self.patch < SMALLEST_PATCH:
            raise InputError(f"patch must be {SMALLEST_PATCH} or more, got {self.patch}.")
        if not 0 <= self.low_light <= 1:
            raise InputError(f"low_light must be a share from 0 to 1, got {self.low_light}.")


@strict
@dataclass(frozen=True)
class SystemsPreset:
    """Number of training samples, and duration of the training of every system.

    Parameters
    ----------
    training_samples, held_out : int
        Number of light fields for training, and for validation.
    epochs, steps_per_epoch : int, optional
        Numbers that replace those of each system.
    """

    training_samples: int
    held_out: int
    epochs: int | None = None
    steps_per_epoch: int | None = None

    def __post_init__(self):
        instead = (x for x in (self.epochs, self.steps_per_epoch) if x is not None)
        counts = self.training_samples, self.held_out, *instead
        if min(counts) < 1 or max(counts) > MOST_EPOCHS:
            raise InputError(
                "training_samples, held_out, epochs and steps_per_epoch must be from 1 to "
                f"{MOST_EPOCHS}, got {', '.join(map(str, counts))}."
            )


@strict
@dataclass(frozen=True)
class SystemsConfig:
    """Refocusing systems with a common training; `read_systems_config` reads it from a TOML file.

    Parameters
    ----------
    seed : int
        Seed of training samples, initial weights and patches.
    training_samples : TrainingSamples
        Source of the training samples.
    presets : dict of SystemsPreset
        Named sizes of the training.
    systems : dict of SystemRecipe
        Training options of each system.
    checkpoint_s : float, optional
        Time between checkpoints in seconds; 0 writes one after every epoch.
    """

    seed: int
    training_samples: TrainingSamples
    presets: dict[str, SystemsPreset]
    systems: dict[str, SystemRecipe]
    checkpoint_s: float = 30.0

    def __post_init__(self):
        check_seed(self.seed)
        unknown = set(self.systems) - set(NETWORKS)
        if unknown:
            raise InputError(
                f"systems must be of {', '.join(NETWORKS)}, got {', '.join(sorted(unknown))}."
            )

    def recipe(self, name: str, preset: str) -> SystemRecipe:
        """Training options of a system in a preset."""
        for kind, key, known in (
            ("system", name, self.systems),
            ("preset", preset, self.presets),
        ):
            if key not in known:
                raise InputError(f"{kind} must be one of {', '.join(known)}, got {key!r}.")
        asked, own = self.presets[preset], self.systems[name]
        return replace(
            own,
            epochs=asked.epochs or own.epochs,
            steps_per_epoch=asked.steps_per_epoch or own.steps_per_epoch,
        )


def read_systems_config(path: str | Path) -> SystemsConfig:
    """Read a configuration of systems from a TOML file; paths in it are relative to its folder."""
    config = build(SystemsConfig, read_toml(path), path)
    samples = config.training_samples
    beside = [str(Path(path).parent / file) for file in samples.data]
    return replace(config, training_samples=replace(samples, data=beside))
