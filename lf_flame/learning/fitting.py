"""Training of any network with Keras's `fit`, in a run folder from which it resumes.

The folder has ``config.json`` (everything that determines the result), ``checkpoint.npz`` (the
state after the newest whole epoch that was saved), ``history.csv`` (a row for each epoch) and,
after each call, ``model.keras`` (the network with the lowest validation loss so far) and
``run.json`` (the record). The order of the samples depends on seed and epoch alone, and the state
includes the generator of the dropout, so that a resumed run ends as an uninterrupted one. It is one
file, written as a whole; Keras's `BackupAndRestore` and `ModelCheckpoint` write several.
"""

import json
import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path

import keras
import numpy as np
import pandas as pd
from keras import ops

from lf_flame._common import progress, provenance
from lf_flame._common.arrays_in_files import ArrayFile
from lf_flame._common.atomic_files import (
    atomic_write,
    exclusive,
    remove_leftovers,
    write_json,
    write_text,
)
from lf_flame._common.config import build
from lf_flame._common.input_files import parse_json, printable, read_record
from lf_flame.errors import InputError
from lf_flame.learning.keras_loading import accelerators
from lf_flame.learning.run_folders import load_run


@dataclass(frozen=True)
class Epoch:
    """Row of the history; the loss of validation is a mean squared error."""

    epoch: int
    loss: float
    val_loss: float
    val_psnr_db: float
    seconds: float


class Batches(keras.utils.PyDataset):
    """Endless batches: `draw` makes those of epoch k from ``numpy.random.default_rng([seed, k])``.

    It returns a function from a step to its inputs and targets. Keras counts `index` on over all
    epochs, and asks ahead. Endless: TensorFlow waits at the end of a finite series, up to an epoch.
    """

    num_batches = None

    def __init__(self, steps: int, seed: int, draw: Callable[[np.random.Generator], Callable]):
        super().__init__()
        self.steps, self.epochs_done = steps, 0
        self._seed, self._draw, self._epoch = seed, draw, 0

    def __getitem__(self, index: int) -> tuple[np.ndarray, ...]:
        epoch = self.epochs_done + index // self.steps + 1
        if epoch != self._epoch:
            self._batch = self._draw(np.random.default_rng([self._seed, epoch]))
            self._epoch = epoch
        return self._batch(index % self.steps)


def shuffled_batches(inputs: np.ndarray, targets: np.ndarray, size: int, seed: int) -> Batches:
    """All samples in a random order, in batches of a size; an epoch's last one may be smaller."""

    def draw(rng: np.random.Generator) -> Callable:
        batches = np.split(rng.permutation(len(inputs)), range(size, len(inputs), size))
        return lambda step: (inputs[batches[step]], targets[batches[step]])

    return Batches(-(-len(inputs) // size), seed, draw)


@dataclass(frozen=True)
class RunFolder:
    """A training run and its folder."""

    path: Path
    request: dict  # what determines the result of an epoch, as JSON values
    epochs: int
    checkpoint_s: float  # time between checkpoints; 0 writes one after every epoch
    started: float  # `time.perf_counter` at the call
    minutes: float = 0.0  # a call ends at the end of an epoch nearest to it; 0: no limit

    def __post_init__(self):
        if not 0 <= self.minutes < math.inf:
            raise InputError(f"minutes must be 0 (to the end) or more, got {self.minutes}.")

    @property
    def network(self) -> Path:
        """File of the network with the lowest validation loss."""
        return self.path / "model.keras"

    @property
    def finished(self) -> bool:
        """Whether the network is there, after all epochs."""
        return self._epochs_of_network() == self.epochs

    @property
    def epochs_missing(self) -> bool:
        """Whether epochs are missing; else the network may be written again from the state."""
        return self.state.epochs_done < self.epochs

    @cached_property
    def state(self) -> "TrainingState":
        """State after the epochs so far."""
        return TrainingState(self.path / "checkpoint.npz")

    @contextmanager
    def opened(self) -> Iterator[None]:
        """Open the folder, new or begun, for one process alone; refuse that of another run."""
        with exclusive(self.path):
            _refuse_other_run(self.request, self.path)
            if self.finished:
                progress.report(f"{self.path} contains this run, finished.")
                self.network.touch()  # make compares it with the configuration file
            else:
                self._begin()
            yield

    def _begin(self) -> None:
        """Write the request, and load the state of earlier calls."""
        write_json(self.path / "config.json", self.request)
        for name in ("checkpoint.npz", "model.keras"):  # hundreds of megabytes each
            remove_leftovers(self.path / name)
        done, in_network = self.state.epochs_done, self._epochs_of_network()
        if not in_network <= done <= self.epochs:
            raise InputError(
                f"{self.path} contains {max(done, in_network)} epochs of this run, and the state "
                f"of epoch {done}, from which {self.epochs} epochs cannot be reached without "
                f"losing some; choose another folder."
            )

    def fit(
        self,
        network: keras.Model,
        batches: Batches,
        validation: tuple[np.ndarray, ...],
        watched: str = "val_loss",
    ) -> None:
        """Call Keras's `fit` from the first epoch that is missing.

        The network is compiled, and its optimiser built. validation: inputs and targets. watched:
        name of their mean squared error in Keras's logs.
        """
        state, done = self.state, self.state.epochs_done
        state.restore(network)
        batches.epochs_done = done
        if done:
            progress.report(f"Resuming after epoch {done} of {self.epochs}.")
        what = f"training until minute {self.minutes:g}" if self.minutes else "training"
        with progress.bar(what, self.epochs, "epoch", stays=True, initial=done) as bar:
            network.fit(
                batches,
                steps_per_epoch=batches.steps,
                epochs=self.epochs,
                initial_epoch=done,
                validation_data=validation,
                validation_batch_size=16,
                shuffle=False,  # the batches shuffle
                verbose=0,
                callbacks=[EpochEnd(self, watched, bar)],
            )
        if self.epochs_missing:
            progress.report(
                f"Saved after epoch {state.epochs_done} of {self.epochs}, best so far: epoch "
                f"{state.best_row.epoch}; the same command resumes."
            )

    def write(self, network: keras.Model, metadata: dict) -> None:
        """Write the network, which has the best weights, and the record."""
        best = self.state.best_row
        record = {
            **self.request,
            "epochs": self.state.epochs_done,
            "epochs_wanted": self.epochs,
            "finished": not self.epochs_missing,
            "best_epoch": best.epoch,
            "best_validation_loss": best.val_loss,
            **metadata,
            "keras_backend": keras.backend.backend(),
            "devices": accelerators(),
            "train_s": round(sum(row.seconds for row in self.state.history), 2),
            "wall_s": round(time.perf_counter() - self.started, 2),
            **provenance.environment(),
        }
        with atomic_write(self.network) as aside:  # renamed last: make looks at this file
            network.save(aside)
            self.network.unlink(missing_ok=True)  # a kill leaves no older one beside the new record
            write_json(self.path / "run.json", record)

    def _epochs_of_network(self) -> int:
        """Count the epochs of the network in the folder, 0 without one."""
        there = (self.path / "run.json").exists() and self.network.exists()
        return load_run(self.path)["epochs"] if there else 0


class EpochEnd(keras.callbacks.Callback):
    """Record each epoch, save the state from time to time, and stop at the time limit."""

    def __init__(self, folder: RunFolder, watched: str, bar):
        super().__init__()
        self.folder, self.watched, self.bar = folder, watched, bar
        self.saved = self.begun = time.perf_counter()

    def on_epoch_begin(self, epoch, logs=None):
        """Start the clock of the epoch."""
        self.begun = time.perf_counter()

    def on_epoch_end(self, epoch, logs=None):
        """Take the epoch's losses, in Keras's logs."""
        folder, state = self.folder, self.folder.state
        now = time.perf_counter()
        state.add(epoch + 1, logs["loss"], logs[self.watched], now - self.begun, self.model)
        self.bar.set_postfix_str(f"best validation PSNR {state.best_row.val_psnr_db:.2f} dB")
        self.bar.update()
        # Whichever end of an epoch is nearest to the limit: half of them are early, half late.
        middle_of_next = now - folder.started + (now - self.begun) / 2
        if 0 < 60 * folder.minutes <= middle_of_next:
            self.model.stop_training = True
        last = self.model.stop_training or epoch + 1 == folder.epochs
        if last or now - self.saved >= folder.checkpoint_s:
            state.save(self.model)
            self.saved = now


class TrainingState:
    """History, weights and optimiser of a run between epochs, and the best weights so far."""

    def __init__(self, path: Path):
        self.path = path
        self.history: list[Epoch] = []
        self.best: list[np.ndarray] = []
        self._arrays: list[np.ndarray] = []
        if path.exists():
            self._load()

    @property
    def epochs_done(self) -> int:
        """Number of completed epochs."""
        return len(self.history)

    @property
    def best_row(self) -> Epoch:
        """Row of the lowest validation loss."""
        return min(self.history, key=lambda row: row.val_loss)

    def add(self, epoch: int, loss: float, val_loss: float, seconds: float, network) -> None:
        """Add an epoch, and keep its weights if they are the best."""
        if not np.isfinite([loss, val_loss]).all():
            raise InputError(f"Epoch {epoch} has no finite loss: {loss}, validation {val_loss}.")
        psnr = float(-10 * np.log10(max(val_loss, 1e-30)))  # finite for images without an error
        self.history.append(Epoch(epoch, float(loss), float(val_loss), psnr, round(seconds, 4)))
        if self.best_row is self.history[-1]:
            self.best = _values(_weights(network))

    def restore(self, network: keras.Model) -> None:
        """Set weights and optimiser to the loaded state, if there is one."""
        variables = [*_weights(network), *network.optimizer.variables]
        if not self._arrays:
            return
        shapes = [tuple(x.shape) for x in self._arrays]
        if shapes != [tuple(x.shape) for x in variables]:
            raise InputError(
                f"{self.path} contains the state of another network, or of another optimiser; "
                f"remove it to begin again."
            )
        for variable, value in zip(variables, self._arrays, strict=True):
            variable.assign(value)
        self._arrays = []

    def save(self, network: keras.Model) -> None:
        """Write the state, and the history for reading."""
        rows = [asdict(row) for row in self.history]
        about = json.dumps({"epochs": rows})
        state = _values([*_weights(network), *network.optimizer.variables])
        arrays = {f"state_{k:03d}": x for k, x in enumerate(state)}
        arrays |= {f"best_{k:03d}": x for k, x in enumerate(self.best)}
        arrays["about"] = np.frombuffer(about.encode(), np.uint8)
        # First, so that no epoch of a checkpoint is missing there.
        write_text(self.path.with_name("history.csv"), pd.DataFrame(rows).to_csv(index=False))
        with atomic_write(self.path) as aside:
            np.savez(aside, **arrays)  # type: ignore[arg-type]  # no array is named allow_pickle

    def _load(self) -> None:
        file = ArrayFile(self.path)
        if "about" not in file.names:
            raise InputError(f"{self.path} is damaged; remove it to begin again.")
        (about,) = file.read(["about"])
        text = about.tobytes().decode("utf-8", "replace")
        found = build(_About, parse_json(text, self.path), self.path)
        self.history = found.epochs
        for name, array in zip(file.names, file.read(file.names), strict=True):
            if name.startswith("state_"):
                self._arrays.append(array)
            elif name.startswith("best_"):
                self.best.append(array)


@dataclass(frozen=True)
class _About:
    """Content of a checkpoint besides its arrays."""

    epochs: list[Epoch]


def _weights(network: keras.Model) -> list[keras.Variable]:
    """Variables of a network, dropout's generator too; `matrix_view` keeps them and their order."""
    return [*network.trainable_variables, *network.non_trainable_variables]


def _values(variables: Sequence[keras.Variable]) -> list[np.ndarray]:
    return [np.array(ops.convert_to_numpy(x)) for x in variables]


def assign_weights(network: keras.Model, values: Sequence[np.ndarray]) -> None:
    """Set a network to the best weights of a run."""
    for variable, value in zip(_weights(network), values, strict=True):
        variable.assign(value)


def _refuse_other_run(request: dict, out: Path) -> None:
    """Refuse a folder of another run, or one with files of no run, and name what differs."""
    path = out / "config.json"
    found = read_record(path) if path.exists() else {}
    if not found.keys() & request.keys():
        for name in ("config.json", "checkpoint.npz", "model.keras", "history.csv", "run.json"):
            if (out / name).exists():
                raise InputError(f"{out} contains a {name} of no run; choose another folder.")
        return
    for key, value in json.loads(json.dumps(request)).items():
        old = found.get(key)
        while isinstance(old, dict) and isinstance(value, dict) and old != value:
            name = next(x for x in old | value if old.get(x, "none") != value.get(x, "none"))
            key, old, value = f"{key}.{name}", old.get(name, "none"), value.get(name, "none")
        if old != value:
            raise InputError(
                f"{out} contains a run with another {key} ({printable(old)}, now "
                f"{printable(value)}); choose another folder, or remove it."
            )
