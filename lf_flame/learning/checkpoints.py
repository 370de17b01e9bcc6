"""A training run's checkpoints: the history, the best weights and the whole state of the trainer.

A run folder holds ``checkpoint-EPOCH/``, written aside and renamed, then its predecessor is
removed; so there is always one that is whole. ``history.csv`` is for reading.
"""

import shutil
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
import pandas as pd

from lf_flame._common.atomic_files import read_json, write_json, write_text
from lf_flame.errors import InputError


@dataclass
class Checkpoint:
    """How far a training run has come.

    Parameters
    ----------
    history : list of dict
        One row an epoch, from 0, the start; with "epoch", "loss", "val_loss" and "seconds"
        (of epoch 0: since the run was started).
    best : list of ndarray
        Weights of the epoch with the lowest validation loss.
    state : list of ndarray
        Of the trainer, see `lf_flame.learning.trainers`; empty before the first epoch.
    """

    history: list[dict] = field(default_factory=list)
    best: list[np.ndarray] = field(default_factory=list)
    state: list[np.ndarray] = field(default_factory=list)

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

    def record(self, row: dict, trainer) -> None:
        """Add an epoch to the history and keep its weights if they are the best."""
        self.history.append(row)
        if self.best_row is row:
            self.best = trainer.weights


def save_checkpoint(checkpoint: Checkpoint, folder: Path) -> None:
    """Write a checkpoint beside the last one, then remove that."""
    name = f"checkpoint-{checkpoint.epochs_done:06d}"
    aside = folder / f"{name}.part"
    shutil.rmtree(aside, ignore_errors=True)
    aside.mkdir()
    try:
        np.savez(aside / "state.npz", *checkpoint.state)
        np.savez(aside / "best.npz", *checkpoint.best)
        write_json(aside / "history.json", {"epochs": checkpoint.history})
    except BaseException:  # a full disk, Ctrl-C: the last checkpoint stays
        shutil.rmtree(aside, ignore_errors=True)
        raise
    older = _checkpoints(folder)
    aside.rename(folder / name)
    write_text(folder / "history.csv", pd.DataFrame(checkpoint.history).to_csv(index=False))
    for path in older:
        shutil.rmtree(path, ignore_errors=True)


def load_checkpoint(folder: Path) -> Checkpoint:
    """Load the newest checkpoint of a run folder; an empty one where there is none.

    Raises
    ------
    InputError
        If it is damaged.
    """
    if not _checkpoints(folder):
        return Checkpoint()
    path = _checkpoints(folder)[-1]
    try:
        return Checkpoint(
            read_json(path / "history.json")["epochs"],
            list(_load_arrays(path / "best.npz")),
            list(_load_arrays(path / "state.npz")),
        )
    except (OSError, ValueError, KeyError, BadZipFile) as error:
        raise InputError(
            f"The checkpoint {path} is damaged ({error}); remove it to start again."
        ) from None


def _checkpoints(folder: Path) -> list[Path]:
    return sorted(folder.glob("checkpoint-??????"))


def _load_arrays(path: Path) -> Iterator[np.ndarray]:
    with path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
        yield from (arrays[name] for name in arrays.files)
