"""A training run's checkpoints: history, best weights, and the whole state of the trainer.

A run folder contains ``checkpoint-EPOCH/``. A new one is written under a temporary name and renamed
before its predecessor is removed, so there is always a complete one. Its ``manifest.json`` names
the run that it belongs to, and the SHA-256 of its files. ``history.csv`` is for reading.
"""

import shutil
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from lf_flame._common.arrays_in_files import open_arrays
from lf_flame._common.atomic_files import atomic_folder, write_json, write_text
from lf_flame._common.checksums import file_sha256
from lf_flame._common.config import load_record
from lf_flame._common.input_files import read_record, read_text
from lf_flame.errors import InputError

MANIFEST = "manifest.json"

FILES = ("state.npz", "best.npz", "history.json")
"""Names of a checkpoint's files."""


@dataclass(frozen=True)
class Manifest:
    """Run that a checkpoint belongs to, and the SHA-256 of its files."""

    run: dict[str, Any]
    sha256: dict[str, str]


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
    name = f"checkpoint-{checkpoint.epochs_done:06d}"
    with atomic_folder(folder / name, "checkpoint") as aside:
        np.savez(aside / "state.npz", *checkpoint.state)
        np.savez(aside / "best.npz", *checkpoint.best)
        write_json(aside / "history.json", {"epochs": checkpoint.history})
        hashes = {name: file_sha256(aside / name) for name in FILES}
        write_json(aside / MANIFEST, {"run": run, "sha256": hashes})
    _tidy(folder, checkpoint)


def _tidy(folder: Path, checkpoint: Checkpoint) -> None:
    """Write the history for reading, and remove all checkpoints but the newest."""
    write_text(folder / "history.csv", _history_table(checkpoint.history))
    for path in find_checkpoints(folder)[:-1]:
        shutil.rmtree(path, ignore_errors=True)


def _history_table(history: list[dict]) -> str:
    """History as a CSV table, a row for each epoch."""
    return pd.DataFrame(history).to_csv(index=False)


def verify_history(path: Path) -> None:
    """Compare ``history.csv`` with the history in a checkpoint of its run.

    After a kill it may lack the last epochs, or be missing: the next call writes it anew.

    Raises
    ------
    InputError
        If it holds anything but the first rows of that history.
    """
    table = path.parent / "history.csv"
    if table.exists():
        whole = _history_table(read_record(path / "history.json")["epochs"])
        if not whole.startswith(read_text(table)):
            raise InputError(f"{table} is not what was written: {path.name} holds another history.")


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
    arrays = (_load_arrays(path / name) for name in ("best.npz", "state.npz"))
    checkpoint = Checkpoint([asdict(row) for row in history], *arrays)
    _tidy(folder, checkpoint)
    return checkpoint


def verify_checkpoint(path: Path) -> Manifest:
    """Compare a checkpoint's files with their hashes.

    Returns
    -------
    Manifest

    Raises
    ------
    InputError
        If a file differs from its hash, or the manifest is missing.
    """
    if not (path / MANIFEST).is_file():
        raise InputError(
            f"The checkpoint {path} has no {MANIFEST}, which says what run it belongs to; remove "
            f"it to start again."
        )
    manifest = load_record(Manifest, path / MANIFEST)
    for name in FILES:
        if not (path / name).is_file() or file_sha256(path / name) != manifest.sha256.get(name):
            raise InputError(
                f"The checkpoint {path} is damaged ({name} is not the file that was written); "
                f"remove it to start again."
            )
    return manifest


def _check_manifest(path: Path, run: dict) -> None:
    belongs = verify_checkpoint(path).run
    if belongs != run:
        key = next((key for key in run if belongs.get(key) != run[key]), "request")
        raise InputError(
            f"The checkpoint {path} belongs to a run with another {key} ({belongs.get(key)}, now "
            f"{run.get(key)}); remove it, or choose another folder."
        )


def find_checkpoints(folder: Path) -> list[Path]:
    """List the checkpoints of a run folder, the oldest first."""
    return sorted(folder.glob("checkpoint-??????"))


def _load_arrays(path: Path) -> list[np.ndarray]:
    with open_arrays(path) as file:
        return file.read(file.names)
