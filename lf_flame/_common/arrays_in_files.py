"""Arrays of numbers in NumPy files; shape, type and size are checked first.

Nothing is unpickled. Files of arrays of all kinds have the interface of `FileOfArrays`.
"""

import warnings
from collections.abc import Iterable
from pathlib import Path
from typing import IO
from zipfile import ZIP_DEFLATED, ZIP_STORED, ZipFile, is_zipfile

import numpy as np

from lf_flame._common.input_files import check_memory, readable
from lf_flame.errors import InputError


def header_of(shape: tuple[int, ...], dtype: np.dtype) -> np.ndarray:
    """Stand-in for a stored array: one of its shape and type that takes no memory."""
    return np.broadcast_to(np.empty((), dtype), shape)


class FileOfArrays:
    """Arrays of numbers in a file of any kind, by name.

    A subclass finds names and headers in the file's own description, and reads one array.
    """

    path: str | Path
    names: list[str]
    headers: dict[str, np.ndarray]

    def header(self, name: str) -> np.ndarray:
        """Shape and type of an array."""
        return self.headers[name]

    def read(self, names: Iterable[str], copies: float = 1.0) -> list[np.ndarray]:
        """Read arrays by name, if they fit into memory `copies` times."""
        names = list(names)
        check_memory(int(copies * sum(self.header(name).nbytes for name in names)), self.path)
        return [self._read(name) for name in names]

    def _read(self, name: str) -> np.ndarray:
        raise NotImplementedError


class ArrayFile(FileOfArrays):
    """A ``.npy`` file, with one array named "", or a ``.npz`` file; the content decides."""

    def __init__(self, path: str | Path):
        self.path = path
        with readable(path):
            self._archive = ZipFile(path) if is_zipfile(path) else None
        members = self._archive.namelist() if self._archive else [".npy"]
        self.names = [name.removesuffix(".npy") for name in members if name.endswith(".npy")]
        if not self._archive:
            self.header("")  # refuses a file that is not an array

    def header(self, name: str) -> np.ndarray:
        """Read shape and type of an array; refuse anything but an array of numbers."""
        with (
            self._open(name) as file,
            readable(self.path, "is not a NumPy file of plain arrays"),
            warnings.catch_warnings(action="ignore"),  # of headers that Python 2 may have written
        ):
            major, minor = np.lib.format.read_magic(file)  # 1.0 or 2.0 for numbers
            shape, _, dtype = getattr(np.lib.format, f"read_array_header_{major}_{minor}")(file)
            if dtype.kind in "biufc":
                return header_of(shape, dtype)
        what = name or "its content"
        raise InputError(f"{self.path} cannot be read: {what} is not a plain array of numbers.")

    def _read(self, name: str) -> np.ndarray:
        with self._open(name) as file, readable(self.path):
            return np.lib.format.read_array(file, allow_pickle=False)

    def _open(self, name: str) -> IO[bytes]:
        if not self._archive:
            return Path(self.path).open("rb")
        with readable(self.path):
            packing = self._archive.getinfo(f"{name}.npy").compress_type
            if packing not in (ZIP_STORED, ZIP_DEFLATED):  # zipfile unpacks others without a bound
                raise InputError(f"{self.path}: {name} is compressed by method {packing}.")
            return self._archive.open(f"{name}.npy")
