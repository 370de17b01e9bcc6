"""Training the decoder on cached backbone features, resumable, with a record of where it came from.

A run folder holds ``config.json`` (what was asked for), ``checkpoint-*/`` (the newest whole
state), ``history.csv``, and at the end ``model.keras`` (the best weights by validation loss, the
whole network) and ``run.json`` (the record).
"""

import shutil
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Literal
from zipfile import BadZipFile

import keras
import numpy as np
import pandas as pd
from tqdm import tqdm

from lf_flame import provenance
from lf_flame.backbone import ImagenetUnavailable, describe_weights
from lf_flame.config import build, read_toml
from lf_flame.datasets import Dataset, split_indices
from lf_flame.errors import InputError
from lf_flame.files import read_json, write_json, write_text, written_aside
from lf_flame.models import build_refocus_resnet50, training_view
from lf_flame.optimizers import FusedAdam
from lf_flame.warmstart import freeze_normalisations, warm_start


@dataclass(frozen=True)
class ModelConfig:
    """Arguments of `lf_flame.models.build_refocus_resnet50`; see there."""

    backbone_weights: str = "imagenet"
    backbone_depth: Literal["conv4", "conv5"] = "conv5"
    dropout: float = 0.3

    __pydantic_config__ = {"extra": "forbid"}


@dataclass(frozen=True)
class Recipe:
    """How to train.

    Parameters
    ----------
    epochs, batch_size : int
    learning_rate : float
        Of Adam; with "cosine" its first value.
    schedule : {"constant", "cosine"}
        "cosine" falls to zero over all epochs.
    checkpoint_s : float
        Seconds between checkpoints; 0 writes one after every epoch.
    without_imagenet : {"random", "stop"}
        What to do where the ImageNet weights cannot be had.
    warm_start : bool
        Start the decoder from the training images and freeze its normalisations, see
        `lf_flame.warmstart`.
    dropout_place
        See `lf_flame.models.build_refocus_resnet50`; the default is the paper's.
    """

    epochs: int
    batch_size: int = 2
    learning_rate: float = 1e-4
    schedule: Literal["constant", "cosine"] = "constant"
    checkpoint_s: float = 0.0
    without_imagenet: Literal["random", "stop"] = "stop"
    warm_start: bool = False
    dropout_place: Literal["image", "vector", "none"] = "image"

    __pydantic_config__ = {"extra": "forbid"}

    def __post_init__(self):
        if min(self.epochs, self.batch_size) < 1 or not self.learning_rate > 0:
            raise InputError(
                f"epochs and batch_size must be at least 1 and learning_rate above 0, got "
                f"{self.epochs}, {self.batch_size}, {self.learning_rate}."
            )


@dataclass(frozen=True)
class TrainingConfig:
    """A training experiment; read from experiments/*.toml.

    Parameters
    ----------
    title : str
    seed : int
        Of the split, the initial weights, the order of the batches and the dropout.
    split : (float, float, float)
        Shares of training, validation and test.
    model : ModelConfig
    presets : dict of Recipe
    """

    title: str
    seed: int
    presets: dict[str, Recipe]
    model: ModelConfig = field(default_factory=ModelConfig)
    split: tuple[float, float, float] = (0.8, 0.1, 0.1)

    __pydantic_config__ = {"extra": "forbid"}

    def __post_init__(self):
        if min(self.split) <= 0 or abs(sum(self.split) - 1) > 1e-9:
            raise InputError(f"split must be three positive shares of 1, got {self.split}.")

    def recipe(self, preset: str) -> Recipe:
        """Recipe of a preset."""
        if preset not in self.presets:
            raise InputError(f"preset must be one of {', '.join(self.presets)}, got {preset!r}.")
        return self.presets[preset]


def read_training_config(path: str | Path, **model_options) -> TrainingConfig:
    """Read a training configuration, with those options of the model that are not None changed."""
    config = build(TrainingConfig, read_toml(path), path)
    options = {name: value for name, value in model_options.items() if value is not None}
    return replace(config, model=replace(config.model, **options))


def build_model(config: TrainingConfig, recipe: Recipe, dataset: Dataset):
    """Build the network for a data set, falling back to a random backbone where that is allowed.

    Returns
    -------
    keras.Model
    str
        The backbone weights that were used, for tables and records.
    """
    planes, *image = dataset.targets.shape[1:]
    options = {**asdict(config.model), "seed": config.seed}
    options["dropout_place"] = recipe.dropout_place
    try:
        model = build_refocus_resnet50(tuple(image), planes, **options)
    except ImagenetUnavailable as error:
        if recipe.without_imagenet == "stop":
            raise InputError(
                f"{error} This preset does not choose for you: "
                f"say BACKBONE_WEIGHTS=random or BACKBONE_WEIGHTS=FILE "
                f"(--backbone-weights without make)."
            ) from None
        tqdm.write(f"NOTE: {error} Going on with RANDOM backbone weights.")
        options["backbone_weights"] = "random"
        model = build_refocus_resnet50(tuple(image), planes, **options)
    weights = describe_weights(
        options["backbone_weights"], options["backbone_depth"], options["seed"]
    )
    return model, weights


def compute_features(model: keras.Model, inputs: np.ndarray, batch_size: int = 16) -> np.ndarray:
    """Run the frozen backbone over all inputs once.

    Parameters
    ----------
    model : keras.Model
        From `build_refocus_resnet50`.
    inputs : ndarray, shape (n, h, w)

    Returns
    -------
    ndarray of float32, shape (n, h', w', channels)
    """
    backbone = model.get_layer("backbone")
    starts = tqdm(range(0, len(inputs), batch_size), "backbone features", unit="batch")
    batches = [backbone.predict_on_batch(inputs[k : k + batch_size, ..., None]) for k in starts]
    return np.concatenate(batches)


def train(
    config: TrainingConfig, preset: str, data: str | Path, out: str | Path, show: bool = True
) -> Path:
    """Train a model, or go on with a run that was cut off.

    Parameters
    ----------
    config : TrainingConfig
    preset : str
    data : str or Path
        Data set made by `lf_flame.datasets.make_dataset`.
    out : str or Path
        Run folder.
    show : bool, optional
        Show progress.

    Returns
    -------
    Path
        ``model.keras`` in the run folder.

    Raises
    ------
    InputError
        If the run folder holds a run with another configuration, or the loss stops being a number.
    """
    started, out, recipe = time.perf_counter(), Path(out), config.recipe(preset)
    dataset = Dataset(data)
    parts = split_indices(len(dataset), config.split, config.seed)
    model, weights = build_model(config, recipe, dataset)
    asked = {
        "title": config.title,
        "preset": preset,
        "seed": config.seed,
        "split": list(config.split),
        "model": asdict(config.model),
        "recipe": asdict(recipe),
        "backbone_weights": weights,
        "data_sha256": dataset.attrs["sha256"],
    }
    out.mkdir(parents=True, exist_ok=True)
    _claim_folder(out, asked)
    state = TrainingState(model.get_layer("decoder"), recipe, len(parts["train"]), out)
    if state.history:
        tqdm.write(f"Going on behind epoch {state.epochs_done} of {recipe.epochs}.")
    if state.next_epoch <= recipe.epochs:
        features = compute_features(model, dataset.inputs)
        arrays = {
            name: (features[indices], dataset.targets[indices][..., None])
            for name, indices in parts.items()
        }
        if recipe.warm_start and not state.history:
            warm_start(state.decoder, *arrays["train"])
        _fit(state, arrays, config.seed, show)
    state.restore_best()
    record = {
        **asked,
        "epochs": recipe.epochs,
        "backbone_depth": config.model.backbone_depth,
        "best_epoch": state.best_row["epoch"],
        "best_validation_loss": state.best_row["val_loss"],
        "parts": {name: len(indices) for name, indices in parts.items()},
        "test_indices": parts["test"].tolist(),
        "data": str(data),
        "keras_backend": keras.backend.backend(),
        "train_s": round(sum(row["seconds"] for row in state.history), 2),
        "wall_s": round(time.perf_counter() - started, 2),
        **provenance.environment(),
    }
    write_json(out / "run.json", record)
    with written_aside(out / "model.keras") as aside:  # last: make looks at this file
        model.save(aside)
    return out / "model.keras"


def _claim_folder(out: Path, asked: dict) -> None:
    """Write what is asked for into a new run folder; refuse one that holds something else."""
    path = out / "config.json"
    if not path.exists():
        write_json(path, asked)
        return
    found = read_json(path)
    changed = [key for key in asked if found.get(key) != asked[key]]
    if changed:
        key = changed[0]
        raise InputError(
            f"{out} holds a run with another {key} ({found.get(key)}, now {asked[key]}); "
            f"remove the folder or choose another (RUN=name)."
        )


class TrainingState:
    """Decoder, optimiser and history, and their checkpoints.

    Parameters
    ----------
    decoder : keras.Model
    recipe : Recipe
    samples : int
        Number of training samples, for the schedule.
    folder : Path
        Run folder; its newest checkpoint is loaded.
    """

    def __init__(self, decoder: keras.Model, recipe: Recipe, samples: int, folder: Path):
        self.recipe, self.folder = recipe, folder
        if recipe.warm_start:
            freeze_normalisations(decoder)
        self.decoder, self.model = decoder, training_view(decoder)
        steps = -(-samples // recipe.batch_size)
        self.optimizer = FusedAdam(_learning_rate(recipe, steps))
        # Without XLA: on a CPU it draws the dropout so slowly that it loses more than it fuses.
        compiled = "auto" if keras.backend.backend() == "jax" else False
        self.model.compile(optimizer=self.optimizer, loss="mse", jit_compile=compiled)
        self.optimizer.build(self.model.trainable_variables)
        self.history: list[dict] = []
        self.best: list[np.ndarray] = []
        self._load()

    @property
    def next_epoch(self) -> int:
        """Epoch to run next: 1 to the recipe's last, or 0 to measure the start."""
        return len(self.history)

    @property
    def epochs_done(self) -> int:
        """Epochs of training behind us."""
        return max(len(self.history) - 1, 0)

    @property
    def best_row(self) -> dict:
        """Row of the history with the lowest validation loss."""
        return min(self.history, key=lambda row: row["val_loss"])

    def record_epoch(self, row: dict) -> None:
        """Add an epoch to the history and keep its weights if they are the best."""
        self.history.append(row)
        if self.best_row is row:
            self.best = self.decoder.get_weights()

    def restore_best(self) -> None:
        """Put the best weights back into the decoder."""
        self.decoder.set_weights(self.best)

    def save(self) -> None:
        """Write a checkpoint beside the last one, then remove that."""
        name = f"checkpoint-{self.epochs_done:06d}"
        aside = self.folder / f"{name}.part"
        shutil.rmtree(aside, ignore_errors=True)
        aside.mkdir()
        try:
            np.savez(aside / "state.npz", *map(keras.ops.convert_to_numpy, self._variables()))
            np.savez(aside / "best.npz", *self.best)
            write_json(aside / "history.json", {"epochs": self.history})
        except BaseException:  # a full disk, Ctrl-C: the last checkpoint stays
            shutil.rmtree(aside, ignore_errors=True)
            raise
        older = self._checkpoints()
        aside.rename(self.folder / name)
        write_text(self.folder / "history.csv", pd.DataFrame(self.history).to_csv(index=False))
        for folder in older:
            shutil.rmtree(folder, ignore_errors=True)

    def _variables(self) -> list:
        """Everything that the next epoch depends on, the state of the dropout included."""
        dropouts = [x for x in self.decoder.layers if isinstance(x, keras.layers.Dropout)]
        seeds = [layer.seed_generator.state for layer in dropouts]
        return [*self.decoder.weights, *seeds, *self.optimizer.variables]

    def _checkpoints(self) -> list[Path]:
        return sorted(self.folder.glob("checkpoint-??????"))

    def _load(self) -> None:
        if not self._checkpoints():
            return
        folder = self._checkpoints()[-1]
        try:
            state = _load_arrays(folder / "state.npz")
            for variable, value in zip(self._variables(), state, strict=True):
                variable.assign(value)
            self.best = list(_load_arrays(folder / "best.npz"))
            self.history = read_json(folder / "history.json")["epochs"]
        except (OSError, ValueError, KeyError, BadZipFile) as error:
            raise InputError(
                f"The checkpoint {folder} is damaged ({error}); remove it to start again."
            ) from None


def _load_arrays(path: Path) -> Iterator[np.ndarray]:
    with path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
        yield from (arrays[name] for name in arrays.files)


def _learning_rate(recipe: Recipe, steps_per_epoch: int):
    if recipe.schedule == "constant":
        return recipe.learning_rate
    return keras.optimizers.schedules.CosineDecay(
        recipe.learning_rate, recipe.epochs * steps_per_epoch
    )


def _fit(state: TrainingState, arrays: dict, seed: int, show: bool) -> None:
    """Train until the recipe's last epoch, with a progress bar and checkpoints."""
    recipe, saved_at = state.recipe, time.perf_counter()
    bar = tqdm(total=recipe.epochs, desc="training", unit="epoch", disable=not show)
    with bar:
        bar.update(state.epochs_done)
        for epoch in range(state.next_epoch, recipe.epochs + 1):
            state.record_epoch(_run_epoch(state.model, arrays, recipe.batch_size, seed, epoch))
            best_psnr = state.best_row["val_psnr_db"]
            bar.set_postfix_str(f"best validation PSNR {best_psnr:.2f} dB")
            bar.update(epoch > 0)
            now = time.perf_counter()
            if epoch == recipe.epochs or now - saved_at >= recipe.checkpoint_s:
                state.save()
                saved_at = now


def _run_epoch(model: keras.Model, arrays: dict, batch_size: int, seed: int, epoch: int) -> dict:
    """One pass over the training samples, in an order that depends on seed and epoch alone.

    Epoch 0 only measures where training starts.
    """
    started = time.perf_counter()
    if epoch == 0:
        loss = float(model.evaluate(*arrays["train"], batch_size=batch_size, verbose=0))
    else:
        loss = _train_on_all(model, *arrays["train"], batch_size, [seed, epoch])
    validation = float(model.evaluate(*arrays["validation"], batch_size=batch_size, verbose=0))
    if not np.isfinite([loss, validation]).all():
        raise InputError(
            f"The loss is no longer a number in epoch {epoch} (training {loss}, validation "
            f"{validation}); the last checkpoint is kept."
        )
    return {
        "epoch": epoch,
        "loss": loss,
        "val_loss": validation,
        "val_psnr_db": -10 * np.log10(validation),
        "seconds": round(time.perf_counter() - started, 4),
    }


def _train_on_all(model: keras.Model, features, targets, batch_size: int, seed) -> float:
    """Train on every sample once; mean loss of the batches."""
    order = np.random.default_rng(seed).permutation(len(features))
    model.reset_metrics()  # train_on_batch returns the mean since then
    for first in range(0, len(order), batch_size):
        chosen = order[first : first + batch_size]
        loss = float(model.train_on_batch(features[chosen], targets[chosen]))
    return loss
