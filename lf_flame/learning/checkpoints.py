"""A training run's checkpoints: the history, the best weights and the whole state of the trainer.

A run folder holds ``checkpoint-EPOCH/``, written aside and renamed, then its predecessor is
removed; so there is always one that is whole. Its ``manifest.json`` says which run it belongs to,
and knows its files by their SHA-256. ``history.csv`` is for reading.
"""

import shutil
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
import pandas as pd

from lf_flame._common.atomic_files import atomic_folder, read_json, write_json, write_text
from lf_flame._common.checksums import file_sha256
from lf_flame._common.input_files import read_record
from lf_flame.errors import InputError

MANIFEST = "manifest.json"

FILES = ("state.npz", "best.npz", "history.json")
"""What a checkpoint is made of."""


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


def save_checkpoint(checkpoint: Checkpoint, folder: Path, run: dict) -> None:
    """Write a checkpoint of a run beside the last one, then remove that.

    Parameters
    ----------
    checkpoint : Checkpoint
    folder : Path
    run : dict
        All that decides how the run goes up to here, as JSON values.
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
    write_text(folder / "history.csv", pd.DataFrame(checkpoint.history).to_csv(index=False))
    for path in find_checkpoints(folder)[:-1]:
        shutil.rmtree(path, ignore_errors=True)


def load_checkpoint(folder: Path, run: dict) -> Checkpoint:
    """Load the newest checkpoint of a run folder; an empty one where there is none.

    Parameters
    ----------
    folder : Path
    run : dict
        As for `save_checkpoint`.

    Raises
    ------
    InputError
        If it is damaged, or belongs to another run.
    """
    if not find_checkpoints(folder):
        return Checkpoint()
    path = find_checkpoints(folder)[-1]
    _check_manifest(path, run)
    try:
        checkpoint = Checkpoint(
            read_json(path / "history.json")["epochs"],
            list(_load_arrays(path / "best.npz")),
            list(_load_arrays(path / "state.npz")),
        )
    except (OSError, ValueError, KeyError, BadZipFile) as error:
        raise InputError(
            f"The checkpoint {path} is damaged ({error}); remove it to start again."
        ) from None
    _tidy(folder, checkpoint)
    return checkpoint


def verify_checkpoint(path: Path) -> dict:
    """Compute the hashes of a checkpoint's files again.

    Returns
    -------
    dict
        Its manifest.

    Raises
    ------
    InputError
        If a file is not what was written, or the manifest is missing.
    """
    if not (path / MANIFEST).is_file():
        raise InputError(
            f"The checkpoint {path} has no {MANIFEST}, which says what run it belongs to; remove "
            f"it to start again."
        )
    manifest = read_record(path / MANIFEST)
    written = manifest.get("sha256")
    hashes = written if isinstance(written, dict) else {}
    for name in FILES:
        if not (path / name).is_file() or file_sha256(path / name) != hashes.get(name):
            raise InputError(
                f"The checkpoint {path} is damaged ({name} is not the file that was written); "
                f"remove it to start again."
            )
    return manifest


def _check_manifest(path: Path, run: dict) -> None:
    belongs = verify_checkpoint(path).get("run")
    if belongs != run:
        known = belongs if isinstance(belongs, dict) else {}
        key = next((key for key in run if known.get(key) != run[key]), "request")
        raise InputError(
            f"The checkpoint {path} belongs to a run with another {key} ({known.get(key)}, now "
            f"{run.get(key)}); remove it, or choose another folder."
        )


def find_checkpoints(folder: Path) -> list[Path]:
    """List the checkpoints of a run folder, the oldest first."""
    return sorted(folder.glob("checkpoint-??????"))


def _load_arrays(path: Path) -> Iterator[np.ndarray]:
    with path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
        yield from (arrays[name] for name in arrays.files)
