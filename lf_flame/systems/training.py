"""Training refocusing networks: all of them from the same training samples, with one program.

A TOML file (`SystemsConfig`) has the training samples, the recipe of each network, and presets that
replace options of all recipes. A sample is a light field with several slopes, either of the paper's
scenes with every object at a random depth, so that nothing can be memorised, or of dead leaves,
which resemble photographs. The target is shift-and-sum of all views. Where the effect plan allows,
it is computed directly from the scene (`lf_flame.projection`), like the views that a system uses,
without a light field. Batches are patches at random positions, preferably with contrast.
"""

import time
from collections.abc import Callable, Collection
from dataclasses import asdict, dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Literal, NamedTuple

import keras
import numpy as np

from lf_flame._common import progress
from lf_flame._common.config import build, strict, to_json
from lf_flame._common.input_files import read_toml
from lf_flame.datasets.config import DatasetConfig, read_config
from lf_flame.errors import InputError
from lf_flame.learning.fitting import Batches, RunFolder, assign_weights
from lf_flame.learning.keras_loading import load_model
from lf_flame.learning.run_folders import load_run
from lf_flame.learning.training_config import MOST_EPOCHS, check_seed
from lf_flame.projection import Projector
from lf_flame.refocus import shift_and_sum
from lf_flame.refocus._arguments import refuse_excluded
from lf_flame.scenes.dead_leaves import DeadLeaves
from lf_flame.scenes.scene import Scene
from lf_flame.simulation.integration import blank_image
from lf_flame.simulation.rendering import render_plan
from lf_flame.systems.aperturenet import ApertureNet, build_aperturenet
from lf_flame.systems.base import NetworkSystem, ViewIndices
from lf_flame.systems.formulas import average
from lf_flame.systems.refnet import RefNet, build_refnet, refnet_loss
from lf_flame.systems.refocusnet import RefocusNet, build_refocusnet
from lf_flame.systems.sparse_unet import NineViewUNet, SparseUNet, build_unet, unet_loss

FIRST_HELD_OUT = 1_000_000
"""Index of the first validation sample."""

BEYOND_MM = 3.0
"""Largest distance in mm of an object beyond the depths of its template."""

LEAF_VIEWS = 9
"""Number of views of dead leaves along each axis."""

ViewSelection = Callable[[int, int], ViewIndices]
"""Function from the number of rows and columns of views to the indices of the views used."""


@dataclass(frozen=True, eq=False)
class TrainingSample:
    """A light field, or its scene, with slopes at which to refocus it."""

    views: np.ndarray  # float32 [v, u, t, s]; without a light field, 0 in those that are not used
    slopes: np.ndarray  # in lenslets per view step
    block: tuple[int, int]  # number of lenslets in a pixel of the images, along (t, s)
    projector: Projector | None = None  # of the scene, if there is no light field
    weights: np.ndarray | None = None  # of the views, (v, u); all equal by default

    def refocus(self, slopes: np.ndarray) -> np.ndarray:
        """Refocus with all views that have weight by shift-and-sum: float32, shape (n, h, w)."""
        if self.projector is None:
            stack = shift_and_sum(self.views, slopes, weights=self.weights)
            return np.clip(average(stack, self.block), 0, 1)
        return np.clip(self.projector.refocus(slopes, block=self.block), 0, 1)


@strict
@dataclass(frozen=True)
class TrainingSamples:
    """Source of training samples: scenes of data sets, and dead leaves."""

    data: list[str]  # files of data-set configurations, chosen at random
    leaves: float = 0.4  # fraction of the light fields that are dead leaves
    slopes: int = 6  # number for each light field; an object is in focus at half of them

    def __post_init__(self):
        if not self.data or not 0 <= self.leaves <= 1 or self.slopes < 1:
            raise InputError(
                f"Training samples need a data set, a fraction of leaves from 0 to 1 and one slope "
                f"or more, got {len(self.data)}, {self.leaves}, {self.slopes}."
            )

    @cached_property
    def configs(self) -> list[DatasetConfig]:
        """Configurations of the data sets; their images must have the same size."""
        configs = [read_config(Path(path)) for path in self.data]
        sizes = {config.image for config in configs}
        if len(sizes) > 1:
            raise InputError(
                f"Training samples need images of equal size, {self.data} have {sorted(sizes)}."
            )
        return configs

    def draw(self, seed: int, index: int, select_views: ViewSelection) -> TrainingSample:
        """Draw the sample of a seed and an index.

        Where the effect plan allows, only the selected views are computed, without a light field.
        """
        rng = np.random.default_rng([seed, index, 7])  # 7: data sets have (seed, index)
        if rng.uniform() < self.leaves:
            return self._draw_leaves(rng)
        config = self.configs[rng.integers(len(self.configs))]
        scene, slopes, noise = self._draw_scene(config, rng)
        camera, plan = config.camera, config.plan_of(scene)
        indices = select_views(camera.views, camera.views)
        if plan.not_separable:
            seen = render_plan(scene, camera, plan, seed=noise)
            refuse_excluded(seen, indices, "This system")
            return TrainingSample(seen.views, slopes, config.block, weights=seen.weights)
        projector, views = Projector(scene, camera, plan), blank_image(camera, "views")
        views[tuple(np.transpose(indices))] = projector.align_views(0.0, indices)[0]
        return TrainingSample(views, slopes, config.block, projector)

    def _draw_leaves(self, rng: np.random.Generator) -> TrainingSample:
        leaves = DeadLeaves()
        views = leaves.draw((LEAF_VIEWS, LEAF_VIEWS), self.configs[0].image, rng).views
        slopes = rng.uniform(*leaves.slopes, self.slopes)
        return TrainingSample(views, slopes, (1, 1))

    def _draw_scene(
        self, config: DatasetConfig, rng: np.random.Generator
    ) -> tuple[Scene, np.ndarray, int]:
        """Draw a scene, the slopes for it, and the seed of its sensor's noise."""
        scene, _ = config.template.draw(rng)
        own = np.array(config.depths_mm)
        depths = rng.permutation(own)
        if rng.uniform() < 0.5:
            depths = rng.uniform(own.min() - BEYOND_MM, own.max() + BEYOND_MM, len(own))
        placed = scene.at_depths(depths, config.camera)
        noise = int(rng.integers(2**31))
        sharp = np.array([config.camera.depth_to_slope(depth) for depth in depths])
        low, high = sharp.min() - 0.2, sharp.max() + 0.2
        chosen = np.resize(rng.permutation(sharp), self.slopes // 2)
        between = rng.uniform(low, high, self.slopes - len(chosen))
        return placed, np.concatenate([chosen, between]), noise


def draw_arrays(
    training_samples: TrainingSamples,
    system: NetworkSystem,
    seed: int,
    indices: Collection[int],
    what: str = "training samples",
) -> tuple[np.ndarray, np.ndarray]:
    """Make the inputs and targets of a network: float32, shape (n, h, w, channels).

    `what` names the progress bar.
    """
    arrays: list[np.ndarray] = []
    bar = progress.steps(indices, what, len(indices), "light field", stays=True)
    for k, index in enumerate(bar):
        sample = training_samples.draw(seed, index, system.view_indices)
        slopes = system.training_slopes(sample.slopes, sample.block)
        images = (
            system.prepare_input(sample.views, slopes, sample.block),
            system.prepare_target(sample.refocus(slopes)),
        )
        if not arrays:  # allocated once for all: these are gigabytes
            arrays = [np.empty((len(indices), *x.shape), np.float32) for x in images]
        for array, values in zip(arrays, images, strict=True):
            array[k] = values
    inputs, targets = (array.reshape(-1, *array.shape[2:]) for array in arrays)
    return inputs, targets


class Network(NamedTuple):
    """A network that can be trained: its system, the function that builds it, and its loss."""

    system: type[NetworkSystem]
    build: Callable[[int], keras.Model]  # from a seed
    loss: str | Callable


NETWORKS = {
    "aperturenet": Network(ApertureNet, build_aperturenet, "mean_squared_error"),
    "refocusnet": Network(RefocusNet, build_refocusnet, "mean_squared_error"),
    "refnet": Network(RefNet, build_refnet, refnet_loss),
    "volumetric": Network(SparseUNet, build_unet, unet_loss),
    "unet-nine-views": Network(NineViewUNet, build_unet, unet_loss),
}


@strict
@dataclass(frozen=True)
class SystemRecipe:
    """Options for training a system."""

    epochs: int
    training_samples: int = 400  # number of light fields
    held_out: int = 20  # number of light fields for validation
    steps_per_epoch: int = 100  # whatever the number of images from a light field
    batch_size: int = 16  # number of patches in a step
    patch: int = 48  # side in pixels; it contains a window of the structural similarity
    learning_rate: float = 1e-3  # with "cosine" its initial value, falling to zero
    schedule: Literal["constant", "cosine"] = "cosine"
    optimizer: Literal["adam", "rmsprop"] = "adam"

    def __post_init__(self):
        names = "epochs", "training_samples", "held_out", "steps_per_epoch", "batch_size"
        counts = [getattr(self, name) for name in names]
        if min(counts) < 1 or max(counts) > MOST_EPOCHS or not self.learning_rate > 0:
            raise InputError(
                f"{', '.join(names)} must be from 1 to {MOST_EPOCHS} and learning_rate above 0, "
                f"got {', '.join(map(str, counts))}, {self.learning_rate}."
            )
        if self.patch < 12:
            raise InputError(f"patch must be 12 or more, got {self.patch}.")


@strict
@dataclass(frozen=True)
class SystemsConfig:
    """Training of the systems, as `read_systems_config` reads it from a TOML file."""

    seed: int  # of training samples, initial weights and patches
    training_samples: TrainingSamples
    presets: dict[str, dict[str, int]]  # options that replace those of every system's recipe
    systems: dict[str, SystemRecipe]
    checkpoint_s: float = 30.0  # time between checkpoints; 0 writes one after every epoch

    def __post_init__(self):
        check_seed(self.seed)
        if unknown := set(self.systems) - set(NETWORKS):
            raise InputError(
                f"systems must be of {', '.join(NETWORKS)}, got {', '.join(sorted(unknown))}."
            )

    def recipe(self, name: str, preset: str) -> SystemRecipe:
        """Training options of a system in a preset."""
        options = ("system", name, self.systems), ("preset", preset, self.presets)
        for kind, key, known in options:
            if key not in known:
                raise InputError(f"{kind} must be one of {', '.join(known)}, got {key!r}.")
        values = asdict(self.systems[name]) | self.presets[preset]
        return build(SystemRecipe, values, f"Preset {preset}")


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
    network = NETWORKS[name]
    model = network.build(config.seed)
    system = network.system(model)

    samples = to_json(config.training_samples)
    request = {
        "system": name,
        "seed": config.seed,
        "training_samples": {key: samples[key] for key in samples if key != "data"},
        # All of a data set's configuration that decides how a sample is drawn.
        "sample_configs": [
            {key: one[key] for key in ("kind", "image", "camera", "template", "effects")}
            for one in map(to_json, config.training_samples.configs)
        ],
        "recipe": asdict(recipe),
    }
    run = RunFolder(Path(out), request, recipe.epochs, config.checkpoint_s, started)
    with run.opened():
        if run.finished:
            return run.network
        if run.epochs_missing:
            patches, validation = _draw(config, recipe, system)
            optimizer = make_optimizer(recipe)
            optimizer.build(model.trainable_variables)
            model.compile(optimizer, network.loss, metrics=[keras.metrics.MeanSquaredError("mse")])
            run.fit(model, patches, validation, "val_mse")
        saved = network.build(config.seed)  # a new one, without the optimiser
        assign_weights(saved, run.state.best)
        run.write(saved, {"title": system.name, "parameters": system.parameters})
        return run.network


def _draw(config: SystemsConfig, recipe: SystemRecipe, system: NetworkSystem) -> tuple:
    """Draw light fields: batches of patches for training, and whole images for validation."""
    draw = partial(draw_arrays, config.training_samples, system, config.seed)
    train = draw(range(recipe.training_samples), "training samples")
    held_out = draw(range(FIRST_HELD_OUT, FIRST_HELD_OUT + recipe.held_out), "held-out samples")
    # As far as the network's sides allow.
    height, width = (n // system.multiple * system.multiple for n in train[0].shape[1:3])
    patches = draw_patches(*train, recipe, system.multiple, config.seed)
    return patches, tuple(x[:, :height, :width] for x in held_out)


def make_optimizer(recipe: SystemRecipe) -> keras.optimizers.Optimizer:
    """Make the optimiser of a recipe."""
    rate = recipe.learning_rate
    if recipe.schedule == "cosine":
        steps = recipe.epochs * recipe.steps_per_epoch
        rate = keras.optimizers.schedules.CosineDecay(rate, steps)
    kinds = {"adam": keras.optimizers.Adam, "rmsprop": keras.optimizers.RMSprop}
    return kinds[recipe.optimizer](rate)


def draw_patches(
    inputs: np.ndarray, targets: np.ndarray, recipe: SystemRecipe, multiple: int, seed: int
) -> Batches:
    """Batches of patches at random positions, never rotated or mirrored: views have directions.

    Two positions are drawn for each patch, and the one with more contrast is used, because a
    network learns nothing from uniform patches. Inputs and targets are float32 images (n, h, w,
    channels), sides of a patch multiples of `multiple`.
    """
    size, both = np.array(inputs.shape[1:3]), (inputs, targets)
    sides = np.minimum(recipe.patch, size) // multiple * multiple

    def place(rng: np.random.Generator) -> tuple:
        k = rng.integers(len(targets))
        places = [
            (k, *(slice(at, at + n) for at, n in zip(corner, sides, strict=True)))
            for corner in rng.integers(0, size - sides + 1, (2, 2))
        ]
        return max(places, key=lambda place: targets[place].std())

    def draw(rng: np.random.Generator) -> Callable:
        places = [
            [place(rng) for _ in range(recipe.batch_size)] for _ in range(recipe.steps_per_epoch)
        ]
        return lambda step: tuple(np.stack([x[one] for one in places[step]]) for x in both)

    return Batches(recipe.steps_per_epoch, seed, draw)


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
        raise InputError(f"{folder} contains no run of a refocusing system.")
    network = NETWORKS[name]
    untrained = network.build(0)
    shapes = untrained.input_shape[1:], untrained.output_shape[1:]
    return network.system(load_model(folder / "model.keras", shapes))
