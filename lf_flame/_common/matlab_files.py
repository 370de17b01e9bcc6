"""MATLAB files of version 5 (before 7.3): arrays of numbers (MAT-File Format, MathWorks 1999-2024).

The reader of scipy ends the program, or takes any amount of memory, where such a file is damaged.
Here every size is compared with that of its array before data are read.
"""

import math
import struct
import zlib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lf_flame._common.array_files import ArrayHeader
from lf_flame._common.input_files import check_regular, readable
from lf_flame._common.memory import check_memory
from lf_flame.errors import InputError

ERRORS = (OSError, struct.error, zlib.error, ValueError, OverflowError)
"""Exceptions for damaged files."""

HEADER = 128
"""Number of bytes of a file's header."""

MATRIX, COMPRESSED = 14, 15
"""Types of the elements that a file consists of."""

STORED = {
    1: "i1",
    2: "u1",
    3: "i2",
    4: "u2",
    5: "i4",
    6: "u4",
    7: "f4",
    9: "f8",
    12: "i8",
    13: "u8",
}
"""Types of stored numbers."""

CLASSES = {
    6: "f8", 7: "f4", 8: "i1", 9: "u1", 10: "i2", 11: "u2", 12: "i4", 13: "u4", 14: "i8", 15: "u8",
}  # fmt: skip
"""Types of the classes of arrays that hold numbers."""

LOGICAL, COMPLEX = 0x200, 0x800
"""Flags of arrays."""

LARGEST_HEAD = 4096
"""Number of bytes in which flags, sizes and name of an array are looked for."""

MOST_ELEMENTS = 10_000
"""Largest number of arrays."""


@dataclass(frozen=True)
class _Array:
    """Place of an array: its element in the file, and its numbers in the element's content."""

    header: ArrayHeader
    start: int
    count: int
    packed: bool
    first: int
    stored: np.dtype

    @property
    def end(self) -> int:
        """Number of bytes of the content up to the last number."""
        return self.first + math.prod(self.header.shape) * self.stored.itemsize


class MatlabFile:
    """Arrays of numbers in a MATLAB file of version 5; the interface is that of `ArrayFile`.

    Attributes
    ----------
    path : Path
    names : list of str
    """

    def __init__(self, path: str | Path):
        self.path = Path(path)
        size = check_regular(path)
        self._found: dict[str, _Array] = {}
        with readable(path, ERRORS), self.path.open("rb") as file:
            self._order = {b"IM": "<", b"MI": ">"}.get(file.read(HEADER)[126:])
            if self._order is None:
                raise InputError(
                    f"{path} is no MATLAB file of version 5 or 7.3: save the light field in MATLAB "
                    f"by save(..., '-v7.3')."
                )
            place = HEADER
            for _ in range(MOST_ELEMENTS):
                if place == size:
                    break
                file.seek(place)
                kind, count = struct.unpack(f"{self._order}II", file.read(8))
                place += 8
                if place + count > size:
                    raise InputError(f"{path} cannot be read: its end is missing.")
                if kind in (MATRIX, COMPRESSED):
                    head = file.read(min(count, LARGEST_HEAD))
                    self._note(head, place, count, kind == COMPRESSED)
                place += count
            else:
                raise InputError(f"{path} cannot be read: it holds too many arrays.")
        self.names = list(self._found)

    def header(self, name: str) -> ArrayHeader:
        """Shape and type of an array."""
        return self._found[name].header

    def read(self, names: Iterable[str], copies: float = 1.0) -> list[np.ndarray]:
        """Read arrays by name, if they fit into memory `copies` times, and as stored.

        Raises
        ------
        InputError
            If one is damaged, or they exceed the memory limit.
        """
        wanted = [self._found[name] for name in names]
        stored = sum(one.count + one.end for one in wanted)
        check_memory(int(copies * sum(one.header.nbytes for one in wanted)) + stored, self.path)
        with readable(self.path, ERRORS), self.path.open("rb") as file:
            arrays = []
            for one in wanted:
                file.seek(one.start)
                content = file.read(one.count)
                if one.packed:
                    content = self._unpacked(content, one.end)
                count = math.prod(one.header.shape)
                array = np.frombuffer(content, one.stored, count, one.first)
                # Whole numbers of class double may be stored as bytes: the class is what counts.
                arrays.append(array.reshape(one.header.shape, order="F").astype(one.header.dtype))
        return arrays

    def _note(self, head: bytes, start: int, count: int, packed: bool) -> None:
        """Note the place of an array, if it is one of real numbers."""
        at = 0
        if packed:
            head = zlib.decompressobj().decompress(head, LARGEST_HEAD)
            kind, count_inside = struct.unpack_from(f"{self._order}II", head)
            if kind != MATRIX:
                return
            at, limit = 8, 8 + count_inside
        else:
            limit = count
        _, flags, _, at = self._part(head, at)
        kinds = struct.unpack_from(f"{self._order}I", flags)[0]
        dtype = "?" if kinds & LOGICAL else CLASSES.get(kinds & 0xFF)
        if dtype is None or kinds & COMPLEX:
            return
        _, sizes, _, at = self._part(head, at)
        shape = struct.unpack(f"{self._order}{len(sizes) // 4}i", sizes)
        _, name, _, at = self._part(head, at)
        kind, _, length, _ = self._part(head, at, whole=False)
        if kind not in STORED or min(shape) < 0:
            raise ValueError("the sizes of an array make no sense")
        small = struct.unpack_from(f"{self._order}I", head, at)[0] >> 16
        stored = np.dtype(f"{self._order}{STORED[kind]}")
        array = _Array(
            ArrayHeader(shape, np.dtype(dtype)),
            start,
            count,
            packed,
            at + (4 if small else 8),
            stored,
        )
        if length != math.prod(shape) * stored.itemsize or array.end > limit:
            raise ValueError("the numbers of an array are more or fewer than its sizes say")
        self._found.setdefault(name.decode("latin1"), array)

    def _part(self, head: bytes, at: int, whole: bool = True) -> tuple[int, bytes, int, int]:
        """Type, content and length of a part of an array, and the place of the next part."""
        kind, length = struct.unpack_from(f"{self._order}II", head, at)
        first, after = at + 8, at + 8 + length + -length % 8
        if kind >> 16:  # four bytes or fewer stand beside their type and length
            kind, length, first, after = kind & 0xFFFF, kind >> 16, at + 4, at + 8
        if whole and first + length > len(head):
            raise ValueError("an array has no beginning")
        return kind, head[first : first + length], length, after

    def _unpacked(self, content: bytes, end: int) -> bytes:
        """Unpack as many bytes as an array has; what is left may only fill up eight bytes."""
        unpacker = zlib.decompressobj()
        found = unpacker.decompress(content, end)
        unpacker.decompress(unpacker.unconsumed_tail, 8)
        if len(found) < end or not unpacker.eof:
            raise ValueError("an array holds more or fewer numbers than its sizes say")
        return found
