"""Training refocusing networks: all of them from the same training samples, with one program.

A TOML file (`SystemsConfig`) has the training samples, the recipe of each network and presets of
their sizes. Batches are patches at random places, preferably with contrast; all else is that of
`lf_flame.learning.fitting`.
"""

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Literal

import keras
import numpy as np

from lf_flame._common.config import build, strict, to_json
from lf_flame._common.input_files import read_toml
from lf_flame.datasets.config import config_to_json
from lf_flame.errors import InputError
from lf_flame.learning.fitting import Batches, Fit, Run, assign_weights, train_in_folder
from lf_flame.learning.keras_loading import load_model
from lf_flame.learning.run_folders import load_run
from lf_flame.learning.training_config import MOST_EPOCHS, check_seed
from lf_flame.systems.aperturenet import ApertureNet, build_aperturenet
from lf_flame.systems.base import NetworkSystem
from lf_flame.systems.refnet import RefNet, build_refnet, refnet_loss
from lf_flame.systems.refocusnet import RefocusNet, build_refocusnet
from lf_flame.systems.sparse_unet import NineViewUNet, SparseUNet, build_unet, unet_loss
from lf_flame.systems.training_scenes import TrainingSamples, draw_arrays

FIRST_HELD_OUT = 1_000_000
"""Index of the first validation sample."""


@dataclass(frozen=True)
class Network:
    """A network that can be trained: its system, the function of a seed that builds it, its loss.

    The truth is a key of `lf_flame.systems.formulas.REFERENCES`; a title distinguishes the network
    from others of the same system.
    """

    system: type[NetworkSystem]
    model: Callable[[int], keras.Model]
    loss: str | Callable
    truth: str = "shift-and-sum"
    title: str = ""

    @property
    def name(self) -> str:
        """Name in tables."""
        return self.title or self.system.name


NETWORKS = {
    "aperturenet": Network(ApertureNet, build_aperturenet, "mean_squared_error"),
    "refocusnet": Network(RefocusNet, build_refocusnet, "mean_squared_error"),
    "refnet": Network(RefNet, build_refnet, refnet_loss),
    "refnet-fourier": Network(
        RefNet, build_refnet, refnet_loss, "Fourier slice",
        f"{RefNet.name}, trained on the Fourier slice",
    ),
    "volumetric": Network(SparseUNet, build_unet, unet_loss),
    "unet-nine-views": Network(NineViewUNet, build_unet, unet_loss),
}  # fmt: skip


@strict
@dataclass(frozen=True)
class SystemRecipe:
    """Options for training a system."""

    epochs: int
    steps_per_epoch: int = 100  # however many images a system receives from a light field
    batch_size: int = 16  # number of patches in a step
    patch: int = 48  # side in pixels; it contains a window of the structural similarity
    learning_rate: float = 1e-3  # with "cosine" its initial value, falling to zero
    schedule: Literal["constant", "cosine"] = "cosine"
    optimizer: Literal["adam", "rmsprop"] = "adam"

    def __post_init__(self):
        counts = self.epochs, self.steps_per_epoch, self.batch_size
        if min(counts) < 1 or max(counts) > MOST_EPOCHS or not self.learning_rate > 0:
            raise InputError(
                f"epochs, steps_per_epoch and batch_size must be from 1 to {MOST_EPOCHS} and "
                f"learning_rate above 0, got {', '.join(map(str, counts))}, {self.learning_rate}."
            )
        if self.patch < 12:
            raise InputError(f"patch must be 12 or more, got {self.patch}.")


@strict
@dataclass(frozen=True)
class SystemsPreset:
    """Numbers of light fields for training and for validation, the same for every system.

    Numbers of epochs and steps, where given, replace those of each system's recipe.
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
    """Training of the systems, as `read_systems_config` reads it from a TOML file."""

    seed: int  # of training samples, initial weights and patches
    training_samples: TrainingSamples
    presets: dict[str, SystemsPreset]
    systems: dict[str, SystemRecipe]
    checkpoint_s: float = 30.0  # time between checkpoints; 0 writes one after every epoch

    def __post_init__(self):
        check_seed(self.seed)
        unknown = set(self.systems) - set(NETWORKS)
        if unknown:
            raise InputError(
                f"systems must be of {', '.join(NETWORKS)}, got {', '.join(sorted(unknown))}."
            )

    def recipe(self, name: str, preset: str) -> SystemRecipe:
        """Training options of a system in a preset."""
        options = ("system", name, self.systems), ("preset", preset, self.presets)
        for kind, key, known in options:
            if key not in known:
                raise InputError(f"{kind} must be one of {', '.join(known)}, got {key!r}.")
        asked, own = self.presets[preset], self.systems[name]
        steps = asked.steps_per_epoch or own.steps_per_epoch
        return replace(own, epochs=asked.epochs or own.epochs, steps_per_epoch=steps)


def read_systems_config(path: str | Path) -> SystemsConfig:
    """Read a configuration of systems from a TOML file; paths in it are relative to its folder."""
    config = build(SystemsConfig, read_toml(path), path)
    samples = config.training_samples
    beside = [str(Path(path).parent / file) for file in samples.data]
    return replace(config, training_samples=replace(samples, data=beside))


def train_system(config: SystemsConfig, name: str, preset: str, out: str | Path) -> Path:
    """Train a system, or continue a run that was interrupted.

    Parameters
    ----------
    config : SystemsConfig
        Configuration.
    name : str
        Key of its `systems`.
    preset : str
        Key of its `presets`.
    out : str or Path
        Run folder.

    Returns
    -------
    Path
        Network ``model.keras`` in the run folder.

    Raises
    ------
    InputError
        If there is no such system or preset, the run folder contains another run, or the loss
        becomes NaN or infinite.
    """
    started, recipe = time.perf_counter(), config.recipe(name, preset)
    counts, network = config.presets[preset], NETWORKS[name]
    model = network.model(config.seed)
    system = network.system(model, network.name)

    def prepare() -> Fit:
        samples = {}
        held_out = range(FIRST_HELD_OUT, FIRST_HELD_OUT + counts.held_out)
        for part, some in (("train", range(counts.training_samples)), ("validation", held_out)):
            samples[part] = draw_arrays(
                config.training_samples, system, config.seed, some, network.truth,
                f"training samples, {part}",
            )  # fmt: skip
        patches = Patches(*samples["train"], recipe, system.multiple, config.seed)
        optimizer = make_optimizer(recipe)
        optimizer.build(model.trainable_variables)
        model.compile(optimizer, network.loss, metrics=[keras.metrics.MeanSquaredError("mse")])
        # Whole images, as far as the network's sides allow.
        height, width = (n // system.multiple * system.multiple for n in patches.size)
        validation = tuple(x[:, :height, :width] for x in samples["validation"])
        return Fit(model, patches, validation, "val_mse")

    def finish(best: list[np.ndarray]) -> keras.Model:
        saved = network.model(config.seed)  # a new one, without the optimiser
        assign_weights(saved, best)
        return saved

    training_samples = to_json(config.training_samples)
    del training_samples["data"]
    request = {
        "system": name,
        "preset": preset,
        "seed": config.seed,
        "training_samples": training_samples,
        "sample_configs": [config_to_json(one) for one in config.training_samples.configs],
        "counts": {"training_samples": counts.training_samples, "held_out": counts.held_out},
        "recipe": asdict(recipe),
    }
    metadata = {"title": system.name, "parameters": system.parameters}
    run = Run(request, recipe.epochs, prepare, finish, metadata, config.checkpoint_s)
    return train_in_folder(run, Path(out), started)


def make_optimizer(recipe: SystemRecipe) -> keras.optimizers.Optimizer:
    """Make the optimiser of a recipe."""
    rate = recipe.learning_rate
    if recipe.schedule == "cosine":
        steps = recipe.epochs * recipe.steps_per_epoch
        rate = keras.optimizers.schedules.CosineDecay(rate, steps)
    kinds = {"adam": keras.optimizers.Adam, "rmsprop": keras.optimizers.RMSprop}
    return kinds[recipe.optimizer](rate)


class Patches(Batches):
    """Patches at random places of random images, never rotated or mirrored: views have directions.

    The one with more contrast of two places is used: a network learns nothing from uniform patches.
    Images (n, h, w, channels) and their truth are float32.
    """

    def __init__(self, shown, truth, recipe: SystemRecipe, multiple: int, seed: int):
        super().__init__(seed)
        self.samples, self.recipe, self.size = (shown, truth), recipe, shown.shape[1:3]
        self.side = [min(recipe.patch, n) // multiple * multiple for n in self.size]
        self.cuts: list[list[tuple]] = []

    def draw(self, rng: np.random.Generator) -> None:
        """Draw the places of an epoch's patches."""
        recipe = self.recipe
        self.cuts = [
            [self._place(rng) for _ in range(recipe.batch_size)]
            for _ in range(recipe.steps_per_epoch)
        ]

    def _place(self, rng: np.random.Generator) -> tuple:
        truth = self.samples[1]
        k = rng.integers(len(truth))
        places = [
            (k, *(slice(at, at + n) for at, n in zip(corner, self.side, strict=True)))
            for corner in rng.integers(0, np.array(self.size) - self.side + 1, (2, 2))
        ]
        return max(places, key=lambda place: truth[place].std())

    def __len__(self) -> int:
        return self.recipe.steps_per_epoch

    def __getitem__(self, index: int) -> tuple[np.ndarray, ...]:
        if not self.cuts:  # Keras looks at a batch before the first epoch
            self.draw(np.random.default_rng(self.seed))
        return tuple(np.stack([x[cut] for cut in self.cuts[index]]) for x in self.samples)


def load_system(path: str | Path) -> NetworkSystem:
    """Load a trained system from its run folder, or RefocusNet from its authors' weights (.npz).

    Raises
    ------
    InputError
        If there is no finished run of a system, it is damaged, or the file does not contain the
        weights.
    """
    folder = Path(path)
    if folder.suffix == ".npz":
        return RefocusNet.of_weights(folder)
    if folder.is_file():
        raise InputError(
            f"A network is a run folder, or RefocusNet's weights (.npz), got the file {folder}."
        )
    record = load_run(folder)
    name = str(record.get("system"))
    if name not in NETWORKS:
        raise InputError(f"{folder} holds no run of a refocusing system.")
    network = NETWORKS[name]
    own = network.model(0)
    shapes = own.input_shape[1:], own.output_shape[1:]
    return network.system(load_model(folder / "model.keras", shapes), network.name)
