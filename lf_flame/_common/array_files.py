"""NumPy files, ``.npy`` and ``.npz``: shape, type and size are checked before data are read.

Only arrays of numbers are read; nothing is unpickled.
"""

import math
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tokenize import TokenError
from typing import IO, Any, Literal
from zipfile import ZipFile, is_zipfile

import numpy as np

from lf_flame._common.input_files import ZIP_ERRORS, readable
from lf_flame._common.memory import check_memory
from lf_flame.errors import InputError

NUMPY_ERRORS = (
    ValueError, TypeError, SyntaxError, TokenError, OverflowError, EOFError, OSError,
)  # fmt: skip
"""Exceptions that NumPy raises for a damaged ``.npy`` file; its header is a Python literal."""

FAULT = "is no NumPy file of plain arrays"

HEADERS = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}
"""Header reader for each format version; arrays of numbers need no other version."""


@dataclass(frozen=True)
class ArrayHeader:
    """Shape and type of a stored array, from its header.

    Attributes
    ----------
    shape : tuple of int
    dtype : numpy.dtype
    """

    shape: tuple[int, ...]
    dtype: np.dtype

    @property
    def nbytes(self) -> int:
        """Bytes of the array in memory."""
        return math.prod(self.shape) * self.dtype.itemsize


class MappedArray:
    """Array in a ``.npy`` file, of which parts are read and written.

    The file is mapped into memory for each part only: the memory of a process counts what is
    mapped.

    Parameters
    ----------
    path : str or Path
    held : optional
        Object that is kept as long as the array, such as the folder that holds it.

    Attributes
    ----------
    shape : tuple of int
    dtype : numpy.dtype
    """

    def __init__(self, path: str | Path, held: Any = None):
        self._path, self._held = path, held
        with open_arrays(path) as file:
            header = file.header("")
        self.shape, self.dtype = header.shape, header.dtype

    @classmethod
    def new(cls, path: str | Path, shape: tuple[int, ...], held: Any = None) -> "MappedArray":
        """Make a file of zeros, float32."""
        np.lib.format.open_memmap(path, "w+", np.float32, shape)
        return cls(path, held)

    def __getitem__(self, key: Any) -> np.ndarray:
        return np.array(self._map("r")[key])

    def __setitem__(self, key: Any, values: np.ndarray) -> None:
        self._map("r+")[key] = values

    def _map(self, mode: Literal["r", "r+"]) -> np.ndarray:
        with readable(self._path, NUMPY_ERRORS):
            return np.load(self._path, mmap_mode=mode, allow_pickle=False)


class ArrayFile:
    """An open ``.npy`` or ``.npz`` file; the content decides which.

    Parameters
    ----------
    path : str or Path
    archive : ZipFile or None
        None for a ``.npy`` file, which holds one array without a name.
    """

    def __init__(self, path: str | Path, archive: ZipFile | None):
        self.path = path
        self._archive = archive
        members = archive.namelist() if archive else [".npy"]
        self.names = [name.removesuffix(".npy") for name in members if name.endswith(".npy")]

    def header(self, name: str) -> ArrayHeader:
        """Read the header of one array: its shape and type.

        Raises
        ------
        InputError
            If it is not an array of numbers.
        """
        with self._open(name) as file:
            return self._read_header(name, file)

    def read(self, names: Iterable[str], copies: float = 1.0) -> list[np.ndarray]:
        """Read arrays by name, if they fit into memory.

        Parameters
        ----------
        names : iterable of str
        copies : float, optional
            Number of times that the arrays will be held in memory.

        Raises
        ------
        InputError
            If one is not an array of numbers or is damaged, or together they exceed the memory
            limit.
        """
        names = list(names)
        check_memory(int(copies * sum(self.header(name).nbytes for name in names)), self.path)
        return [self._read(name) for name in names]

    def open(self, name: str) -> MappedArray:
        """Open the array of a ``.npy`` file, to read parts of it.

        Raises
        ------
        InputError
            If the file is a ``.npz`` file, of which no parts can be read.
        """
        if self._archive is not None:
            raise InputError(f"Parts of {self.path} cannot be read: store it as .npy or .zarr.")
        return MappedArray(self.path)

    def _read(self, name: str) -> np.ndarray:
        with self._open(name) as file, readable(self.path, NUMPY_ERRORS + ZIP_ERRORS):
            return np.lib.format.read_array(file, allow_pickle=False)

    @contextmanager
    def _open(self, name: str) -> Iterator[IO[bytes]]:
        if self._archive is None:
            with Path(self.path).open("rb") as file:
                yield file
            return
        with readable(self.path, (KeyError, *ZIP_ERRORS)):
            member = self._archive.open(f"{name}.npy")
        with member:
            yield member

    def _read_header(self, name: str, file: IO[bytes]) -> ArrayHeader:
        errors = (KeyError, *NUMPY_ERRORS, *ZIP_ERRORS)
        with readable(self.path, errors, FAULT), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # NumPy warns of headers that Python 2 may have written
            shape, _, dtype = HEADERS[np.lib.format.read_magic(file)](file)
        if dtype.kind not in "biufc" or min(shape, default=0) < 0:
            what = name or "what it holds"
            raise InputError(f"{self.path} cannot be read: {what} is no plain array of numbers.")
        return ArrayHeader(shape, dtype)


@contextmanager
def open_arrays(path: str | Path) -> Iterator[ArrayFile]:
    """Open a ``.npy`` or ``.npz`` file.

    Yields
    ------
    ArrayFile

    Raises
    ------
    InputError
        If the file cannot be read, or is neither of the two.
    """
    with readable(path, ZIP_ERRORS):
        archive = ZipFile(path) if is_zipfile(path) else None
    if archive is None:
        plain = ArrayFile(path, None)
        plain.header("")  # refuses a file that is not an array
        yield plain
        return
    with archive:
        yield ArrayFile(path, archive)
