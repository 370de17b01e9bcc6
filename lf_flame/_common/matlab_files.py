"""MATLAB files of version 5 (before 7.3): arrays of numbers, whose size is known before."""

import struct
import warnings
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from lf_flame._common.array_files import ArrayHeader
from lf_flame._common.inflating import LARGEST_RATIO, inflated_size
from lf_flame._common.input_files import check_regular, readable
from lf_flame._common.memory import check_memory, memory_limit
from lf_flame.errors import InputError

CLASSES = {
    "double": "f8", "single": "f4", "logical": "?", "int8": "i1", "uint8": "u1", "int16": "i2",
    "uint16": "u2", "int32": "i4", "uint32": "u4", "int64": "i8", "uint64": "u8",
}  # fmt: skip
"""Type of each class of numbers."""

HEADER, COMPRESSED = 128, 15
"""Number of bytes of the file's header, and type of an element that is packed (MAT-File Format)."""

MOST_ELEMENTS = 10_000
"""Largest number of variables."""


class MatlabFile:
    """Arrays of numbers in a MATLAB file of version 5; the interface is that of `ArrayFile`.

    Attributes
    ----------
    path : Path
    names : list of str
    """

    def __init__(self, path: str | Path):
        from scipy.io import whosmat

        self.path = Path(path)
        with readable(path, _errors()), self.path.open("rb") as file, _quiet():
            _check_elements(file.read(HEADER), file, self.path)
            file.seek(0)
            held = whosmat(file, appendmat=False)
        self._found: dict[str, ArrayHeader] = {}
        for name, shape, kind in reversed(held):  # of two of one name the first is read
            self._found.pop(name, None)
            if kind in CLASSES:
                self._found[name] = ArrayHeader(tuple(map(int, shape)), np.dtype(CLASSES[kind]))
        self.names = [name for name, _, _ in held if name in self._found]

    def header(self, name: str) -> ArrayHeader:
        """Shape and type of an array."""
        return self._found[name]

    def read(self, names: Iterable[str], copies: float = 1.0) -> list[np.ndarray]:
        """Read arrays by name, if they fit into memory `copies` times, and once as stored.

        Raises
        ------
        InputError
            If one is damaged, or they exceed the memory limit.
        """
        from scipy.io import loadmat

        names = list(names)
        need = sum(self.header(name).nbytes for name in names)
        check_memory(int((copies + 1) * need), self.path)
        with readable(self.path, _errors()), self.path.open("rb") as file, _quiet():
            # MATLAB may store whole numbers of a class double as bytes: the class is what counts.
            held = loadmat(file, appendmat=False, variable_names=names, mat_dtype=True)
        arrays = [held.get(name) for name in names]
        for name, array in zip(names, arrays, strict=True):
            header = self.header(name)
            if not isinstance(array, np.ndarray) or array.shape != header.shape:
                raise InputError(f"{self.path} cannot be read: {name} is damaged.")
        return arrays


def _check_elements(header: bytes, file, path: Path) -> None:
    """Refuse a file that is cut, or an element that holds more than the memory limit.

    The reader of scipy unpacks as much as an element says, whatever the size of its array.
    """
    order = {b"IM": "<", b"MI": ">"}.get(header[126:128])
    if order is None:
        raise InputError(
            f"{path} is no MATLAB file of version 5 or 7.3: save the light field in MATLAB by "
            f"save(..., '-v7.3')."
        )
    size, place, limit = check_regular(path), HEADER, memory_limit()
    for _ in range(MOST_ELEMENTS):
        if place + 8 > size:
            return
        file.seek(place)
        kind, count = struct.unpack(f"{order}II", file.read(8))
        if place + 8 + count > size:
            raise InputError(f"{path} cannot be read: it is damaged, its end is missing.")
        if kind == COMPRESSED and count * LARGEST_RATIO > limit:
            check_memory(inflated_size(file.read(count), int(limit)), path)
        place += 8 + count
    raise InputError(f"{path} cannot be read: it holds more than {MOST_ELEMENTS:,} variables.")


def _quiet() -> warnings.catch_warnings:
    """Silence warnings: what cannot be read is refused."""
    return warnings.catch_warnings(action="ignore")


def _errors() -> tuple[type[Exception], ...]:
    """Exceptions of scipy's reader for damaged files."""
    import zlib

    from scipy.io.matlab import MatReadError

    return (
        MatReadError, zlib.error, struct.error, OSError, ValueError, TypeError, LookupError,
        OverflowError, MemoryError, NotImplementedError, AttributeError, ArithmeticError,
        RuntimeError, EOFError,
    )  # fmt: skip
