"""Arrays of numbers in HDF5 and MATLAB files; shape, type and size are checked first.

No other file is opened and no filter is loaded.
"""

import math
import struct
import zlib
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from lf_flame._common.arrays_in_files import FileOfArrays, header_of
from lf_flame._common.input_files import check_memory, check_regular, memory_limit, readable
from lf_flame.errors import InputError

DEFLATE, SHUFFLE, CHECKSUM = 1, 2, 3
"""Numbers of the filters that are part of the HDF5 library itself."""

MOST_ARRAYS = 1000
"""Largest number of arrays of a file among which views are searched for."""


class Hdf5File(FileOfArrays):
    """Arrays of numbers in an HDF5 file, or in one of MATLAB 7.3.

    Such a file can name other files (external links, external storage, virtual arrays) and filters
    that the library would load as programs. Only arrays that lie in the file itself, plain or
    packed by DEFLATE, are listed, with their groups (``scene/views``); the library is not given any
    other. MATLAB stores axes in reverse; headers and arrays have the order of axes that it shows.
    `numbers` are the attributes by which files of HCI say how their cameras stand.
    """

    def __init__(self, path: str | Path):
        try:
            import h5py
        except ImportError:
            raise InputError(
                "HDF5 and MATLAB 7.3 files are read by h5py: pip install '.[hdf5]'."
            ) from None
        self._h5py, self.path, self._reversed = h5py, Path(path), is_matlab_hdf5(path)
        self.headers = {}
        with readable(path), h5py.File(path, "r") as file:
            file.visititems(self._note)  # follows hard links only, to each object once
            self.numbers = {
                name: float(np.ravel(file.attrs[name])[0])
                for name in ("dH", "focalLength", "shift")
                if name in file.attrs
            }
        self.names = list(self.headers)

    def _note(self, name: str, one: Any) -> bool | None:
        """Note an array that lies in the file; True ends the search."""
        # The library opens the sources of a virtual array to find its shape.
        if isinstance(one, self._h5py.Dataset) and not (one.is_virtual or one.external):
            shape, dtype = one.shape, one.dtype
            if shape is not None and dtype.kind in "biuf":
                shape = shape[::-1] if self._reversed else shape
                self.headers[name] = header_of(shape, dtype)
        return len(self.headers) >= MOST_ARRAYS or None

    def _read(self, name: str) -> np.ndarray:
        with readable(self.path), self._h5py.File(self.path, "r") as file:
            self._check(file[name], name)
            array = file[name][()]
        return array.T if self._reversed else array

    def _check(self, dataset: Any, name: str) -> None:
        """Refuse filters that the library would load, and chunks that hold more than they say."""
        made = dataset.id.get_create_plist()
        filters = [made.get_filter(k)[0] for k in range(made.get_nfilters())]
        if not set(filters) <= {DEFLATE, SHUFFLE, CHECKSUM} or filters.count(DEFLATE) > 1:
            raise InputError(
                f"{self.path} cannot be read: {name} is packed by filters {filters} of HDF5, and "
                f"no program is loaded for them; store it with gzip or without compression."
            )
        if DEFLATE not in filters:
            return
        # The library unpacks a whole chunk, whatever it holds; small ones cannot hold too much.
        most, large = math.prod(dataset.chunks) * dataset.dtype.itemsize, []
        check_memory(2 * most, self.path)
        dataset.id.chunk_iter(
            # 1032 is the largest ratio by which DEFLATE packs: 258 bytes in 2 bits (RFC 1951).
            lambda one: large.append(one) if one.size * 1032 > memory_limit() else None
        )
        for chunk in large:
            mask, data = dataset.id.read_direct_chunk(chunk.chunk_offset)
            if mask >> filters.index(DEFLATE) & 1:  # not packed
                continue
            if len(zlib.decompressobj().decompress(data, most + 1)) > most:
                raise InputError(
                    f"{self.path} cannot be read: {name} is damaged; a part of it holds more than "
                    f"the {most:,} bytes that it should."
                )


def is_matlab_hdf5(path: str | Path) -> bool:
    """Whether a file is one of MATLAB 7.3, by its first bytes."""
    with readable(path), Path(path).open("rb") as file:
        return file.read(10) == b"MATLAB 7.3"


# MATLAB 5 -----------------------------------------------------------------------------------------

MATRIX, PACKED = 14, 15
"""Types of the elements that a file consists of."""

HEAD = 4096
"""Number of bytes in which the kind, sizes and name of an array are looked for."""

STORED = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8",
          13: "u8"}  # fmt: skip
"""Types of stored numbers; MATLAB may store whole numbers of class double as bytes."""

CLASSES = {6: "f8", 7: "f4", 8: "i1", 9: "u1", 10: "i2", 11: "u2", 12: "i4", 13: "u4", 14: "i8",
           15: "u8"}  # fmt: skip
"""Types of the classes of arrays that hold numbers; cells, structures and objects are not read."""

LOGICAL, COMPLEX = 0x200, 0x800
"""Flags of arrays."""


class MatlabFile(FileOfArrays):
    """Real arrays of numbers in a MATLAB file of version 5 (before 7.3).

    scipy's reader takes any type of stored numbers for a place in its memory, which ends the
    program, and unpacks any amount. The numbers of an array are one block, which NumPy reads
    (MAT-File Format, MathWorks, 1999-2024, chapter 1).
    """

    def __init__(self, path: str | Path):
        self.path = Path(path)
        check_memory(check_regular(path), path)
        self.headers = {}
        self._elements: dict[str, tuple[int, memoryview, np.dtype]] = {}
        with readable(path, "no MATLAB file of version 5 or 7.3 (save it by save(..., '-v7.3'))"):
            data = memoryview(self.path.read_bytes())
            self._order = {b"IM": "<", b"MI": ">"}[bytes(data[126:128])]
            for kind, length, element in _elements(data[128:], self._order):
                if len(element) < length:
                    raise ValueError("its end is missing")
                found = self._parse(kind, element, HEAD)
                if found is not None and found[0] not in self.headers:
                    name, self.headers[name], stored, _ = found
                    self._elements[name] = kind, element, stored
        self.names = list(self.headers)

    def _parse(
        self, kind: int, element: memoryview, most: int
    ) -> tuple[str, np.ndarray, np.dtype, memoryview] | None:
        """Name and header of an array, type and bytes of its numbers; None without real numbers.

        Packed arrays are unpacked to `most` bytes.
        """
        if kind == PACKED:
            unpacked = memoryview(zlib.decompressobj().decompress(element, most))
            kind, _, element = next(_elements(unpacked, self._order))
        if kind != MATRIX:
            return None
        parts = _elements(element, self._order)
        flags = struct.unpack_from(f"{self._order}I", next(parts)[2])[0]
        dtype = "?" if flags & LOGICAL else CLASSES.get(flags & 0xFF)
        if dtype is None or flags & COMPLEX:
            return None
        (_, _, sizes), (_, _, name), (stored, _, numbers) = islice(parts, 3)
        shape = struct.unpack(f"{self._order}{len(sizes) // 4}I", sizes)
        header = header_of(shape, np.dtype(dtype))
        return bytes(name).decode("latin1"), header, np.dtype(self._order + STORED[stored]), numbers

    def _read(self, name: str) -> np.ndarray:
        header, (kind, element, stored) = self.headers[name], self._elements[name]
        count = math.prod(header.shape)
        most = HEAD + count * stored.itemsize
        check_memory(most + 2 * header.nbytes, self.path)  # as stored, and as it is
        with readable(self.path):
            *_, numbers = self._parse(kind, element, most)  # type: ignore[misc]  # found before
            array = np.frombuffer(numbers, stored, count).reshape(header.shape, order="F")
            return array.astype(header.dtype)


def _elements(data: memoryview, order: str) -> Iterator[tuple[int, int, memoryview]]:
    """Type, length and content of each element; the last content may be cut off."""
    at = 0
    while at < len(data):
        kind, length = struct.unpack_from(f"{order}II", data, at)
        if kind >> 16:  # four bytes or fewer follow their type and length directly
            yield kind & 0xFFFF, kind >> 16, data[at + 4 : at + 4 + (kind >> 16)]
            at += 8
        else:
            yield kind, length, data[at + 8 : at + 8 + length]
            at += 8 + length + (-length % 8 if kind != PACKED else 0)
