"""HDF5 files, and those of MATLAB 7.3: arrays of numbers are read, and nothing else is opened.

A file of this kind can name other files (external links, external storage, virtual arrays) and
filters that the HDF5 library would load as programs. Only arrays that lie in the file itself, plain
or packed by DEFLATE, are listed; the library is not given any other.
"""

import zlib
from collections.abc import Iterable
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from lf_flame._common.array_files import ArrayHeader
from lf_flame._common.inflating import LARGEST_RATIO, inflated_size
from lf_flame._common.input_files import readable
from lf_flame._common.memory import check_memory, memory_limit
from lf_flame.errors import InputError

HDF5_ERRORS = (
    OSError, RuntimeError, ValueError, TypeError, LookupError, ArithmeticError, MemoryError,
    NotImplementedError, zlib.error,
)  # fmt: skip
"""Exceptions of h5py for damaged files."""

DEFLATE, SHUFFLE, CHECKSUM = 1, 2, 3
"""Numbers of the filters that are part of the HDF5 library itself."""

MOST_OBJECTS = 1000
"""Largest number of objects in a file among which arrays are searched for."""

DEEPEST = 8
"""Largest depth of groups that are searched."""

MATLAB = b"MATLAB 7.3"
"""First bytes of a MATLAB file that is HDF5."""


class Hdf5File:
    """Arrays of numbers in an HDF5 file; the interface is that of `ArrayFile`.

    Attributes
    ----------
    path : Path
    names : list of str
        Names of the arrays, with their groups: ``LF``, ``scene/views``.
    reversed : bool
        Whether the axes are stored in reverse, as MATLAB does. Shapes and arrays here have the
        order of axes that MATLAB shows.
    numbers : dict of str to float
        Attributes of the file itself that are one number.
    """

    def __init__(self, path: str | Path):
        self._h5py, self.path = _import_h5py(), Path(path)
        self.reversed = is_matlab_hdf5(path)
        with readable(path, HDF5_ERRORS), self._h5py.File(path, "r") as file:
            self._found: dict[str, ArrayHeader] = {}
            self._search(file, "", MOST_OBJECTS)
            self.numbers = _numbers(file)
        self.names = list(self._found)

    def header(self, name: str) -> ArrayHeader:
        """Shape and type of an array."""
        return self._found[name]

    def read(self, names: Iterable[str], copies: float = 1.0) -> list[np.ndarray]:
        """Read arrays by name, if they fit into memory `copies` times.

        Raises
        ------
        InputError
            If one is damaged or packed in another way than by DEFLATE, or they exceed the memory
            limit.
        """
        names = list(names)
        check_memory(int(copies * sum(self.header(name).nbytes for name in names)), self.path)
        with readable(self.path, HDF5_ERRORS), self._h5py.File(self.path, "r") as file:
            return [self._read(file[name], name) for name in names]

    def open(self, name: str) -> Any:
        """Open an array, to read parts of it; its axes are as stored, see `reversed`.

        Raises
        ------
        InputError
            If it is damaged or packed in another way than by DEFLATE.
        """
        with readable(self.path, HDF5_ERRORS):
            dataset = self._h5py.File(self.path, "r")[name]  # holds the file open
            self._check(dataset, name)
        return dataset

    def _search(self, group: Any, prefix: str, left: int) -> int:
        """Note the arrays of a group and of those in it; returns how many objects may still come.

        Only hard links are followed: others lead to other places, or to other files.
        """
        for name in group:
            if left <= 0:
                break
            left -= 1
            # A name that is no text comes as bytes.
            if isinstance(name, bytes) or not self._is_hard(group, name):
                continue
            one = group[name]
            if isinstance(one, self._h5py.Group) and prefix.count("/") < DEEPEST:
                left = self._search(one, f"{prefix}{name}/", left)
            elif isinstance(one, self._h5py.Dataset) and _lies_here(one):
                shape, dtype = one.shape, one.dtype
                if shape is not None and dtype.kind in "biuf":
                    header = ArrayHeader(shape[:: -1 if self.reversed else 1], dtype)
                    self._found[f"{prefix}{name}"] = header
        return left

    def _is_hard(self, group: Any, name: str) -> bool:
        link = group.id.links.get_info(name.encode("utf-8", "surrogateescape"))
        return link.type == self._h5py.h5l.TYPE_HARD

    def _read(self, dataset: Any, name: str) -> np.ndarray:
        self._check(dataset, name)
        array = dataset[()]
        return array.T if self.reversed else array

    def _check(self, dataset: Any, name: str) -> None:
        """Refuse filters that the library would load, and chunks that hold more than they say."""
        plain = {DEFLATE, SHUFFLE, CHECKSUM}
        filters = _filters(dataset)
        if not set(filters) <= plain:
            odd = next(number for number in filters if number not in plain)
            raise InputError(
                f"{self.path} cannot be read: {name} is packed by filter {odd} of HDF5, and no "
                f"program for it is loaded; store it with gzip or without compression."
            )
        if DEFLATE in filters:
            self._refuse_bombs(dataset, filters, name)

    def _refuse_bombs(self, dataset: Any, filters: list[int], name: str) -> None:
        """Refuse chunks that hold more than an array's chunk: the library would unpack them whole.

        Chunks that cannot exceed the memory limit are not unpacked here.
        """
        most = prod(dataset.chunks) * dataset.dtype.itemsize
        check_memory(most, self.path)
        large: list[Any] = []
        dataset.id.chunk_iter(
            lambda chunk: (
                large.append(chunk) if chunk.size * LARGEST_RATIO > memory_limit() else None
            )
        )
        outer = filters[filters.index(DEFLATE) + 1 :]
        if large and (filters.count(DEFLATE) > 1 or set(outer) > {CHECKSUM}):
            raise InputError(f"{self.path} cannot be read: {name} is packed more than once.")
        for chunk in large:
            unpacked, data = dataset.id.read_direct_chunk(chunk.chunk_offset)
            if unpacked & 1 << filters.index(DEFLATE):
                continue
            if inflated_size(data, most) > most:
                raise InputError(
                    f"{self.path} cannot be read: {name} is damaged; a part of it holds more than "
                    f"the {most:,} bytes that it should."
                )


def is_matlab_hdf5(path: str | Path) -> bool:
    """Whether a file is one of MATLAB 7.3, by its first bytes."""
    with readable(path, (OSError,)), Path(path).open("rb") as file:
        return file.read(len(MATLAB)) == MATLAB


def _lies_here(dataset: Any) -> bool:
    """Whether an array lies in its file as a whole.

    This comes before its shape is read, for which the library would open the sources of a virtual
    array.
    """
    return not dataset.is_virtual and not dataset.external


def _filters(dataset: Any) -> list[int]:
    """Numbers of an array's filters, in the order of packing."""
    made = dataset.id.get_create_plist()
    return [made.get_filter(k)[0] for k in range(made.get_nfilters())]


def _numbers(file: Any) -> dict[str, float]:
    """Attributes that are one number."""
    found = {}
    for name in list(file.attrs)[:MOST_OBJECTS]:
        kind = file.attrs.get_id(name)
        if kind.dtype.kind in "iuf" and prod(kind.shape) == 1:
            found[name] = float(np.ravel(file.attrs[name])[0])
    return found


def _import_h5py() -> Any:
    try:
        import h5py
    except ImportError:
        raise InputError(
            "HDF5 and MATLAB 7.3 files are read by h5py: pip install 'lf_flame[hdf5]'."
        ) from None
    return h5py
