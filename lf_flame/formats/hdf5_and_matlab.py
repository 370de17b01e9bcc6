"""Arrays of numbers in HDF5 and MATLAB files; shape, type and size are checked first.

No other file is opened and no filter is loaded. The interface is that of
`lf_flame._common.arrays_in_files`.
"""

import math
import struct
import zlib
from collections.abc import Iterable
from pathlib import Path
from typing import IO, Any

import numpy as np

from lf_flame._common.arrays_in_files import ArrayHeader
from lf_flame._common.input_files import check_regular, readable
from lf_flame._common.memory import check_memory, memory_limit
from lf_flame.errors import InputError

HDF5_ERRORS = (
    OSError, RuntimeError, ValueError, TypeError, LookupError, ArithmeticError, MemoryError,
    NotImplementedError, zlib.error,
)  # fmt: skip
"""Exceptions of h5py for damaged files."""

DEFLATE, SHUFFLE, CHECKSUM = 1, 2, 3
"""Numbers of the filters that are part of the HDF5 library itself."""

MOST_OBJECTS, DEEPEST = 1000, 8
"""Largest number of objects, and largest depth of groups, among which arrays are searched for."""


class Hdf5File:
    """Arrays of numbers in an HDF5 file, or in one of MATLAB 7.3.

    Such a file can name other files (external links, external storage, virtual arrays) and filters
    that the library would load as programs. Only arrays that lie in the file itself, plain or
    packed by DEFLATE, are listed, with their groups (``scene/views``); the library is not given any
    other. MATLAB stores axes in reverse; headers and arrays have the order of axes that it shows.
    `numbers` are the attributes of the file itself that are one number.
    """

    def __init__(self, path: str | Path):
        try:
            import h5py
        except ImportError:
            raise InputError(
                "HDF5 and MATLAB 7.3 files are read by h5py: pip install '.[hdf5]'."
            ) from None
        self._h5py, self.path, self._reversed = h5py, Path(path), is_matlab_hdf5(path)
        self._found: dict[str, ArrayHeader] = {}
        with readable(path, HDF5_ERRORS), h5py.File(path, "r") as file:
            self._search(file, "", MOST_OBJECTS)
            self.numbers = {
                name: float(np.ravel(file.attrs[name])[0])
                for name in list(file.attrs)[:MOST_OBJECTS]
                if (kind := file.attrs.get_id(name)).dtype.kind in "iuf"
                and math.prod(kind.shape) == 1
            }
        self.names = list(self._found)

    def header(self, name: str) -> ArrayHeader:
        """Shape and type of an array."""
        return self._found[name]

    def read(self, names: Iterable[str], copies: float = 1.0) -> list[np.ndarray]:
        """Read arrays by name, if they fit into memory `copies` times."""
        names, arrays = list(names), []
        check_memory(int(copies * sum(self.header(name).nbytes for name in names)), self.path)
        with readable(self.path, HDF5_ERRORS), self._h5py.File(self.path, "r") as file:
            for name in names:
                self._check(file[name], name)
                arrays.append(file[name][()])
        return [array.T if self._reversed else array for array in arrays]

    def _search(self, group: Any, prefix: str, left: int) -> int:
        """Note the arrays of a group and of those in it; returns how many objects may still come.

        Only hard links are followed: others lead to other places, or to other files.
        """
        for name in group:
            if left <= 0:
                break
            left -= 1
            if isinstance(name, bytes):  # no text
                continue
            link = group.id.links.get_info(name.encode("utf-8", "surrogateescape"))
            if link.type != self._h5py.h5l.TYPE_HARD:
                continue
            one = group[name]
            if isinstance(one, self._h5py.Group) and prefix.count("/") < DEEPEST:
                left = self._search(one, f"{prefix}{name}/", left)
            elif isinstance(one, self._h5py.Dataset) and not (one.is_virtual or one.external):
                # The library opens the sources of a virtual array to find its shape.
                shape, dtype = one.shape, one.dtype
                if shape is not None and dtype.kind in "biuf":
                    shape = shape[::-1] if self._reversed else shape
                    self._found[f"{prefix}{name}"] = ArrayHeader(shape, dtype)
        return left

    def _check(self, dataset: Any, name: str) -> None:
        """Refuse filters that the library would load, and chunks that hold more than they say."""
        made = dataset.id.get_create_plist()
        filters = [made.get_filter(k)[0] for k in range(made.get_nfilters())]
        odd = [one for one in filters if one not in (DEFLATE, SHUFFLE, CHECKSUM)]
        if odd or filters.count(DEFLATE) > 1:
            how = f"by filter {odd[0]} of HDF5, and no program for it is loaded" if odd else "twice"
            raise InputError(
                f"{self.path} cannot be read: {name} is packed {how}; store it with gzip or "
                f"without compression."
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
    with readable(path, (OSError,)), Path(path).open("rb") as file:
        return file.read(10) == b"MATLAB 7.3"


MATLAB_ERRORS = (OSError, struct.error, zlib.error, ValueError, LookupError, MemoryError)
"""Exceptions for damaged files."""

START, TAG, LARGEST_HEAD = 128, 8, 4096
"""Number of bytes before the first element of a file, of the type and length of an element, and in
which flags, sizes and name of an array are looked for."""

MATRIX, COMPRESSED = 14, 15
"""Types of the elements that a file consists of."""

STORED = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8",
          13: "u8"}  # fmt: skip
"""Types of stored numbers; MATLAB may store whole numbers of class double as bytes."""

CLASSES = {6: "f8", 7: "f4", 8: "i1", 9: "u1", 10: "i2", 11: "u2", 12: "i4", 13: "u4", 14: "i8",
           15: "u8"}  # fmt: skip
"""Types of the classes of arrays that hold numbers; cells, structures and objects are not read."""

LOGICAL, COMPLEX = 0x200, 0x800
"""Flags of arrays."""


class MatlabFile:
    """Real arrays of numbers in a MATLAB file of version 5 (before 7.3).

    scipy's reader ends the program where the type of stored numbers makes no sense, and unpacks
    any amount. The numbers of an array are one block, which NumPy reads (MAT-File Format,
    MathWorks, 1999-2024, chapter 1).
    """

    def __init__(self, path: str | Path):
        self.path, size = Path(path), check_regular(path)
        self._found: dict[str, ArrayHeader] = {}
        self._places: dict[str, tuple[int, int, int, int, str]] = {}
        with readable(path, MATLAB_ERRORS), self.path.open("rb") as file:
            order = {b"IM": "<", b"MI": ">"}.get(file.read(START)[126:])
            if order is None:
                raise InputError(
                    f"{path} is no MATLAB file of version 5 or 7.3: save the light field in MATLAB "
                    f"by save(..., '-v7.3')."
                )
            while (place := file.tell()) < size:
                head = file.read(TAG + LARGEST_HEAD)
                kind, stored = struct.unpack_from(f"{order}II", head)
                end = place + TAG + stored
                if end > size:
                    raise InputError(f"{path} cannot be read: its end is missing.")
                packed = kind == COMPRESSED
                if packed:
                    head = zlib.decompressobj().decompress(head[TAG:], LARGEST_HEAD)
                    kind, count = struct.unpack_from(f"{order}II", head)
                if kind == MATRIX:
                    count = count if packed else stored
                    name, header, *block = _read_parts(head[TAG : TAG + count], count, order)
                    if header is not None and name not in self._found:
                        self._found[name] = header
                        self._places[name] = (place, stored, count if packed else 0, *block)
                file.seek(end)
        self.names = list(self._found)

    def header(self, name: str) -> ArrayHeader:
        """Shape and type of an array."""
        return self._found[name]

    def read(self, names: Iterable[str], copies: float = 1.0) -> list[np.ndarray]:
        """Read arrays by name, if they fit into memory `copies` times, and one as stored."""
        names, arrays = list(names), []
        need = [self.header(name).nbytes for name in names]
        check_memory(int(copies * sum(need) + 2 * max(need, default=0)), self.path)
        with readable(self.path, MATLAB_ERRORS), self.path.open("rb") as file:
            for name in names:
                place, stored, count, first, kind = self._places[name]
                shape, dtype = self.header(name).shape, self.header(name).dtype
                element = self._element(file, place, stored, count)
                numbers = np.frombuffer(element, kind, math.prod(shape), TAG + first)
                arrays.append(numbers.reshape(shape, order="F").astype(dtype))
        return arrays

    def _element(self, file: IO[bytes], place: int, stored: int, count: int) -> bytes:
        """Read the element of an array; if it is packed, unpack `count` bytes."""
        file.seek(place)
        element = file.read(TAG + stored)
        if not count:
            return element
        unpacker = zlib.decompressobj()
        element = unpacker.decompress(element[TAG:], TAG + count)
        unpacker.decompress(unpacker.unconsumed_tail, TAG)  # at most what fills up eight bytes
        if len(element) < TAG + count or not unpacker.eof:
            raise ValueError("an array holds more or fewer numbers than it says")
        return element


def _read_parts(head: bytes, count: int, order: str) -> tuple[str, ArrayHeader | None, int, str]:
    """Name, header, and place and type of the numbers; no header without real numbers."""
    parts, at = [], 0
    for _ in range(4):  # flags, sizes, name, numbers
        kind, length = struct.unpack_from(f"{order}II", head, at)
        first, after = at + TAG, at + TAG + length + -length % TAG
        if kind >> 16:  # four bytes or fewer follow their type and length directly
            kind, length, first, after = kind & 0xFFFF, kind >> 16, at + 4, at + TAG
        parts.append(head[first : first + length])
        at = after
        flags = struct.unpack_from(f"{order}I", parts[0])[0]
        dtype = "?" if flags & LOGICAL else CLASSES.get(flags & 0xFF)
        if dtype is None or flags & COMPLEX:
            return "", None, 0, ""
    sizes, name = parts[1], parts[2].decode("latin1")
    shape = struct.unpack(f"{order}{len(sizes) // 4}i", sizes)
    stored = order + STORED[kind]
    size = math.prod(shape) * np.dtype(stored).itemsize
    if min(shape) < 0 or length != size or first + length > count:
        raise ValueError("the numbers of an array do not fit its sizes")
    return name, ArrayHeader(shape, np.dtype(dtype)), first, stored
