"""A training run's checkpoints: history, best weights, and the whole state of the trainer.

A run folder contains ``checkpoint-EPOCH/``. A new one is written under a temporary name and renamed
before its predecessor is removed, so there is always a complete one. Its ``manifest.json`` names
the run that it belongs to. ``history.csv`` is for reading.
"""

import reprlib
import shutil
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from lf_flame._common.arrays_in_files import open_arrays
from lf_flame._common.atomic_files import atomic_folder, write_json, write_text
from lf_flame._common.config import load_record
from lf_flame.errors import InputError

MANIFEST = "manifest.json"


@dataclass(frozen=True)
class Manifest:
    """Run that a checkpoint belongs to."""

    run: dict[str, Any]


@dataclass(frozen=True)
class Epoch:
    """A row of the history; the PSNR of images without an error is None."""

    epoch: int
    loss: float
    val_loss: float
    val_psnr_db: float | None
    seconds: float


@dataclass(frozen=True)
class History:
    """The history as stored in a checkpoint."""

    epochs: list[Epoch]


@dataclass
class Checkpoint:
    """Progress of a training run.

    Parameters
    ----------
    history : list of dict
        One row for each epoch, from 0 (the start), with "epoch", "loss", "val_loss" and "seconds"
        (for epoch 0: since the start of the run).
    best : list of ndarray
        Weights of the epoch with the lowest validation loss.
    state : list of ndarray
        State of the trainer, see `lf_flame.learning.trainers`; empty before the first epoch.
    """

    history: list[dict] = field(default_factory=list)
    best: list[np.ndarray] = field(default_factory=list)
    state: list[np.ndarray] = field(default_factory=list)

    @property
    def next_epoch(self) -> int:
        """Number of the next epoch: 1 to the last of the configuration, or 0 for the start."""
        return len(self.history)

    @property
    def epochs_done(self) -> int:
        """Number of completed epochs of training."""
        return max(len(self.history) - 1, 0)

    @property
    def best_row(self) -> dict:
        """Row of the history with the lowest validation loss."""
        return min(self.history, key=lambda row: row["val_loss"])

    def record(self, row: dict, trainer) -> None:
        """Add an epoch to the history, and keep its weights if they are the best."""
        self.history.append(row)
        if self.best_row is row:
            self.best = trainer.weights


def save_checkpoint(checkpoint: Checkpoint, folder: Path, run: dict) -> None:
    """Write a checkpoint of a run beside the previous one, then remove that.

    Parameters
    ----------
    checkpoint : Checkpoint
    folder : Path
    run : dict
        Everything that determines the run up to here, as JSON values.
    """
    path = folder / f"checkpoint-{checkpoint.epochs_done:06d}"
    with atomic_folder(path) as aside:
        np.savez(aside / "state.npz", *checkpoint.state)
        np.savez(aside / "best.npz", *checkpoint.best)
        write_json(aside / "history.json", {"epochs": checkpoint.history})
        write_json(aside / MANIFEST, {"run": run})
    _tidy(folder, checkpoint)


def _tidy(folder: Path, checkpoint: Checkpoint) -> None:
    """Write the history for reading, and remove all but the newest checkpoint, as kills left."""
    write_text(folder / "history.csv", pd.DataFrame(checkpoint.history).to_csv(index=False))
    for path in [*find_checkpoints(folder)[:-1], *folder.glob(".checkpoint-*.part")]:
        shutil.rmtree(path, ignore_errors=True)


def load_checkpoint(folder: Path, run: dict) -> Checkpoint:
    """Load the newest checkpoint of a run folder, or an empty one if there is none.

    Parameters
    ----------
    folder : Path
    run : dict
        As for `save_checkpoint`.

    Raises
    ------
    InputError
        If the checkpoint is damaged, or belongs to another run.
    """
    if not find_checkpoints(folder):
        return Checkpoint()
    path = find_checkpoints(folder)[-1]
    _check_manifest(path, run)
    history = load_record(History, path / "history.json").epochs
    if len(history) - 1 != int(path.name.partition("-")[2]):
        raise InputError(
            f"{path} is damaged: its history ends elsewhere; remove it to start again."
        )
    arrays = (_load_arrays(path / name) for name in ("best.npz", "state.npz"))
    checkpoint = Checkpoint([asdict(row) for row in history], *arrays)
    _tidy(folder, checkpoint)
    return checkpoint


def _check_manifest(path: Path, run: dict) -> None:
    belongs = load_record(Manifest, path / MANIFEST).run
    # Older versions have other entries; those that both have decide.
    key = next((key for key in run if key in belongs and belongs[key] != run[key]), None)
    if key is not None:
        raise InputError(
            f"The checkpoint {path} belongs to a run with another {key} "
            f"({reprlib.repr(belongs[key])}, now {reprlib.repr(run[key])}); remove it, or choose "
            f"another folder."
        )


def find_checkpoints(folder: Path) -> list[Path]:
    """List the checkpoints of a run folder, the oldest first."""
    return sorted(folder.glob("checkpoint-??????"))


def _load_arrays(path: Path) -> list[np.ndarray]:
    with open_arrays(path) as file:
        return file.read(file.names)
