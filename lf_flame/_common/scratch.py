"""Temporary files for what does not fit into memory, removed at the end."""

import shutil
import tempfile
import weakref
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from lf_flame.errors import InputError

FOLDER = "TMPDIR"
"""Name of the environment variable that sets another folder for temporary files."""


class Scratch:
    """A temporary folder with room for some bytes, removed with this object.

    Parameters
    ----------
    needed : int
        Number of bytes that its files will take.

    Attributes
    ----------
    folder : Path

    Raises
    ------
    InputError
        If the disk has too little room.
    """

    def __init__(self, needed: int):
        place = tempfile.gettempdir()
        free = shutil.disk_usage(place).free
        if needed > free:
            raise InputError(
                f"{needed / 1e9:.3g} GB of temporary files are needed in {place}, where "
                f"{free / 1e9:.3g} GB are free; {FOLDER} sets another folder."
            )
        self.folder = Path(tempfile.mkdtemp(prefix="lf-flame-"))
        weakref.finalize(self, shutil.rmtree, self.folder, ignore_errors=True)


class StoredBands(Sequence):
    """Arrays in temporary files, of which only the one asked for is in memory."""

    def __init__(self, needed: int):
        self._scratch, self._count = Scratch(needed), 0

    def append(self, band: np.ndarray) -> None:
        """Add an array."""
        np.save(self._scratch.folder / f"{self._count}.npy", band, allow_pickle=False)
        self._count += 1

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, k):
        at = range(self._count)[k]  # the end of a sequence is an IndexError
        return np.load(self._scratch.folder / f"{at}.npy", allow_pickle=False)
