"""Training refocusing networks: all of them from the same training samples, with one program.

Batches are patches cut out at random positions, preferably with contrast; the run folder is that of
`lf_flame.learning.training_run`.
"""

import time
from dataclasses import asdict
from pathlib import Path

import keras
import numpy as np

from lf_flame._common.config import to_json
from lf_flame.datasets.config import config_to_json
from lf_flame.errors import InputError
from lf_flame.learning.keras_loading import load_model
from lf_flame.learning.run_folders import load_run
from lf_flame.learning.trainers import all_variables
from lf_flame.learning.training_run import Job, assign, carry_out
from lf_flame.systems.base import NetworkSystem
from lf_flame.systems.refocusnet import RefocusNet
from lf_flame.systems.registry import NETWORKS
from lf_flame.systems.training_config import SystemRecipe, SystemsConfig
from lf_flame.systems.training_scenes import draw_arrays

FIRST_HELD_OUT = 1_000_000
"""Index of the first validation sample."""

EVALUATION_BATCH = 16


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
    counts = config.presets[preset]
    request = {
        "system": name,
        "preset": preset,
        "seed": config.seed,
        "training_samples": {
            name: value
            for name, value in to_json(config.training_samples).items()
            if name != "data"
        },
        "sample_configs": [config_to_json(one) for one in config.training_samples.configs],
        "counts": {"training_samples": counts.training_samples, "held_out": counts.held_out},
        "recipe": asdict(recipe),
    }
    network = NETWORKS[name]
    system = network.build(config.seed)

    def start(new: bool) -> PatchTrainer:
        return PatchTrainer(
            system, network.loss, recipe, _draw_arrays(config, name, preset, system)
        )

    def finish(best: list[np.ndarray]) -> keras.Model:
        model = network.model(config.seed)  # a new one, without the optimiser
        assign(all_variables(model), best)
        return model

    metadata = {"title": system.name, "parameters": system.parameters}
    job = Job(request, recipe.epochs, config.seed, config.checkpoint_s, start, finish, metadata)
    return carry_out(job, Path(out), started)


def _draw_arrays(config: SystemsConfig, name: str, preset: str, system) -> dict:
    counts, recipe = config.presets[preset], config.recipe(name, preset)
    indices = {
        "train": range(counts.training_samples),
        "validation": range(FIRST_HELD_OUT, FIRST_HELD_OUT + counts.held_out),
    }
    truth, arrays = NETWORKS[name].truth, {}
    for part, some in indices.items():
        arrays[part] = draw_arrays(
            config.training_samples,
            system,
            config.seed,
            some,
            truth,
            recipe.low_light,
            f"training samples, {part}",
        )
    return arrays


def _values(variables: list[keras.Variable]) -> list[np.ndarray]:
    return [np.array(keras.ops.convert_to_numpy(x)) for x in variables]


class PatchTrainer:
    """Trains a network on patches of images, with Keras's own `train_on_batch`.

    Parameters
    ----------
    system : NetworkSystem
        System whose network is trained, starting from its weights.
    loss : str or callable
        Keras's name of a loss, or a function of truth and image that gives one number per sample.
    recipe : SystemRecipe
        Training options.
    arrays : dict
        Pairs ``name: (shown, truth)`` for "train" and "validation"; float32, shape (n, h, w,
        channels).
    """

    def __init__(self, system: NetworkSystem, loss, recipe: SystemRecipe, arrays: dict):
        self.system, self.model = system, system.model
        self.recipe, self.arrays = recipe, arrays
        size = arrays["train"][0].shape[1:3]
        self.side = [min(recipe.patch, n) // system.multiple * system.multiple for n in size]
        rate = recipe.learning_rate
        if recipe.schedule == "cosine":
            steps = recipe.epochs * recipe.steps_per_epoch
            rate = keras.optimizers.schedules.CosineDecay(rate, steps)
        kinds = {"adam": keras.optimizers.Adam, "rmsprop": keras.optimizers.RMSprop}
        self.optimizer = kinds[recipe.optimizer](rate)
        self.optimizer.build(self.model.trainable_variables)
        self.model.compile(self.optimizer, loss)

    def train_epoch(self, rng: np.random.Generator) -> float:
        """Take the steps of an epoch; returns the mean loss meanwhile."""
        losses = []
        for _ in range(self.recipe.steps_per_epoch):
            losses.append(self.model.train_on_batch(*self._cut(rng, self.recipe.batch_size)))
            self.model.reset_metrics()
        return float(np.mean(losses))

    def _cut(self, rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Cut patches out of random images, never rotated or mirrored: views have directions.

        The one with more contrast of two positions is used: a network learns nothing from uniform
        patches.
        """
        shown, truth = self.arrays["train"]
        cuts = []
        for _ in range(count):
            k = rng.integers(len(shown))
            places = [
                tuple(slice(at, at + n) for at, n in zip(corner, self.side, strict=True))
                for corner in rng.integers(0, np.array(shown.shape[1:3]) - self.side + 1, (2, 2))
            ]
            cuts.append((k, *max(places, key=lambda place: truth[k][place].std())))
        return np.stack([shown[cut] for cut in cuts]), np.stack([truth[cut] for cut in cuts])

    def evaluate(self, part: str) -> float:
        """Mean squared error over whole images, for any loss."""
        shown, truth = self.arrays[part]
        if part == "train":  # some of them suffice
            shown, truth = shown[: 2 * EVALUATION_BATCH], truth[: 2 * EVALUATION_BATCH]
        total = 0.0
        for k in range(0, len(shown), EVALUATION_BATCH):
            images = np.clip(self.system.predict(shown[k : k + EVALUATION_BATCH]), 0, 1)
            total += np.square(images - truth[k : k + EVALUATION_BATCH]).mean((1, 2, 3)).sum()
        return float(total / len(shown))

    @property
    def weights(self) -> list[np.ndarray]:
        """Copies of all values of the network."""
        return _values(all_variables(self.model))

    @property
    def state(self) -> list[np.ndarray]:
        """Everything that the next epoch depends on; set it to continue from there."""
        return _values([*all_variables(self.model), *self.optimizer.variables])

    @state.setter
    def state(self, values) -> None:
        assign([*all_variables(self.model), *self.optimizer.variables], values)


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
    model = load_model(folder / "model.keras", shapes)
    return network.system(model, network.title)
