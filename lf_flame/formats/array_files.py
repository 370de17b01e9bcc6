"""Arrays of numbers in HDF5, MATLAB and Zarr files; shape, type and size are checked first.

No other file is opened, no filter is loaded, and nothing is unpickled.
"""

import math
import struct
import warnings
import zlib
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from lf_flame._common.arrays_in_files import FileOfArrays, header_of
from lf_flame._common.input_files import check_memory, check_regular, memory_limit, readable
from lf_flame.errors import InputError

# HDF5 ---------------------------------------------------------------------------------------------

DEFLATE, SHUFFLE, CHECKSUM = 1, 2, 3
"""Numbers of the filters that are part of the HDF5 library itself."""


class Hdf5File(FileOfArrays):
    """Arrays of numbers in an HDF5 file, or in one of MATLAB 7.3.

    Such a file can name other files (external links, external storage, virtual arrays) and filters
    that the library would load as programs. Only arrays that lie in the file itself, plain or
    compressed by DEFLATE, are listed, with their groups (``scene/views``); the library never sees
    any other. MATLAB stores axes in reverse; headers and arrays have the order of axes that it
    shows.
    """

    def __init__(self, path: str | Path):
        import h5py  # an extra

        self._h5py = h5py
        self.path, self.headers, self._reversed = Path(path), {}, is_matlab_hdf5(path)
        with readable(path), self._h5py.File(path, "r") as file:
            file.visititems(self._note)  # follows hard links only, to each object once
        self.names = list(self.headers)

    def _note(self, name: str, one: Any) -> None:
        """Note an array that lies in the file."""
        # The library opens the sources of a virtual array to find its shape.
        if isinstance(one, self._h5py.Dataset) and not (one.is_virtual or one.external):
            shape, dtype = one.shape, one.dtype
            if shape is not None and dtype.kind in "biuf":
                shape = shape[::-1] if self._reversed else shape
                self.headers[name] = header_of(shape, dtype)

    def _read(self, name: str) -> np.ndarray:
        with readable(self.path), self._h5py.File(self.path, "r") as file:
            self._check(file[name], name)
            array = file[name][()]
        return array.T if self._reversed else array

    def _check(self, dataset: Any, name: str) -> None:
        """Refuse filters that the library would load, and chunks larger than they state."""
        made = dataset.id.get_create_plist()
        filters = [made.get_filter(k)[0] for k in range(made.get_nfilters())]
        if not set(filters) <= {DEFLATE, SHUFFLE, CHECKSUM} or filters.count(DEFLATE) > 1:
            raise InputError(
                f"{self.path} cannot be read: {name} is compressed by filters {filters} of HDF5, "
                f"for which no program is loaded; store it with gzip or without compression."
            )
        if DEFLATE not in filters:
            return
        # The library expands a whole chunk, whatever its content; small ones cannot have too much.
        most, large = math.prod(dataset.chunks) * dataset.dtype.itemsize, []
        check_memory(2 * most, self.path)
        dataset.id.chunk_iter(
            # 1032 is the largest ratio by which DEFLATE compresses: 258 bytes in 2 bits (RFC 1951).
            lambda one: large.append(one) if one.size * 1032 > memory_limit() else None
        )
        for chunk in large:
            mask, data = dataset.id.read_direct_chunk(chunk.chunk_offset)
            if mask >> filters.index(DEFLATE) & 1:  # not compressed
                continue
            if len(zlib.decompressobj().decompress(data, most + 1)) > most:
                raise InputError(
                    f"{self.path} cannot be read: {name} is damaged; a part of it contains more "
                    f"than the {most:,} bytes that it should."
                )


def is_matlab_hdf5(path: str | Path) -> bool:
    """Whether a file is one of MATLAB 7.3, by its first bytes."""
    with readable(path), Path(path).open("rb") as file:
        return file.read(10) == b"MATLAB 7.3"


# MATLAB 5 -----------------------------------------------------------------------------------------

MATRIX, PACKED = 14, 15
"""Types of the elements that a file consists of."""

HEAD = 4096
"""Number of bytes in which the kind, sizes and name of an array are searched for."""

STORED = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8",
          13: "u8"}  # fmt: skip
"""Types of stored numbers; MATLAB may store whole numbers of class double as bytes."""

CLASSES = {6: "f8", 7: "f4", 8: "i1", 9: "u1", 10: "i2", 11: "u2", 12: "i4", 13: "u4", 14: "i8",
           15: "u8"}  # fmt: skip
"""Types of the classes of arrays of numbers; cells, structures and objects are not read."""


class MatlabFile(FileOfArrays):
    """Real arrays of numbers in a MATLAB file of version 5 to 7 (little endian, before 7.3).

    The numbers of an array are one block, which NumPy reads (MAT-File Format, MathWorks, 1999-2024,
    chapter 1). scipy 1.17 uses any type of stored numbers as an address in its memory, which ends
    the program, and expands any amount: checking both first takes as much code as reading.
    """

    def __init__(self, path: str | Path):
        self.path, self.headers = Path(path), {}
        self._elements: dict[str, tuple[int, memoryview, np.dtype]] = {}
        check_memory(check_regular(path), path)
        with readable(path, "not a MATLAB file of version 5 or 7.3 (save with save(..., '-v7.3'))"):
            data = memoryview(self.path.read_bytes())
            if data[126:128] != b"IM":
                raise ValueError("its header has another signature")
            for kind, length, element in _elements(data[128:]):
                if len(element) < length:
                    raise ValueError("its end is missing")
                found = _parse(kind, element, HEAD)
                if found is not None and found[0] not in self.headers:
                    name, self.headers[name], stored, _ = found
                    self._elements[name] = kind, element, stored
        self.names = list(self.headers)

    def _read(self, name: str) -> np.ndarray:
        header, (kind, element, stored) = self.headers[name], self._elements[name]
        most = HEAD + header.size * stored.itemsize
        check_memory(most + 2 * header.nbytes, self.path)  # as stored, and as it is
        with readable(self.path):
            *_, numbers = _parse(kind, element, most)  # type: ignore[misc]  # found before
            array = np.frombuffer(numbers, stored, header.size).reshape(header.shape, order="F")
            return array.astype(header.dtype)


def _parse(
    kind: int, element: memoryview, most: int
) -> tuple[str, np.ndarray, np.dtype, memoryview] | None:
    """Name and header of an array, type and bytes of its numbers; None without real numbers.

    Compressed arrays are expanded to `most` bytes.
    """
    if kind == PACKED:
        unpacked = memoryview(zlib.decompressobj().decompress(element, most))
        kind, _, element = next(_elements(unpacked))
    if kind != MATRIX:
        return None
    parts = _elements(element)
    (flags,) = struct.unpack_from("<I", next(parts)[2])
    dtype = CLASSES.get(flags & 0xFF) and ("?" if flags & 0x200 else CLASSES[flags & 0xFF])
    if dtype is None or flags & 0x800:  # complex
        return None
    (_, _, sizes), (_, _, name), (stored, _, numbers) = islice(parts, 3)
    shape = struct.unpack(f"<{len(sizes) // 4}I", sizes)
    header = header_of(shape, np.dtype(dtype))
    return bytes(name).decode("latin1"), header, np.dtype(f"<{STORED[stored]}"), numbers


def _elements(data: memoryview) -> Iterator[tuple[int, int, memoryview]]:
    """Type, length and content of each element; the last content may be cut off."""
    at = 0
    while at < len(data):
        kind, length = struct.unpack_from("<II", data, at)
        if kind >> 16:  # four bytes or fewer follow their type and length directly
            yield kind & 0xFFFF, kind >> 16, data[at + 4 : at + 4 + (kind >> 16)]
            at += 8
        else:
            yield kind, length, data[at + 8 : at + 8 + length]
            at += 8 + length + (-length % 8 if kind != PACKED else 0)


# Zarr ---------------------------------------------------------------------------------------------


class ZarrFile(FileOfArrays):
    """Arrays of numbers in a Zarr group of format 3, and in its groups.

    Codecs of format 2 may run what a chunk contains, as ``pickle`` does. No file may be a device, a
    pipe, or larger than the memory limit: Zarr reads whole files.
    """

    def __init__(self, path: str | Path):
        import zarr  # an extra

        self.path, self.metadata = Path(path), Path(path, "zarr.json")
        if not self.metadata.is_file():
            raise InputError(f"{path} is not a Zarr folder of format 3: it contains no zarr.json.")
        for file in self.path.rglob("*"):
            if not file.is_dir():
                check_memory(check_regular(file), file)
        # Zarr warns of folders in it that are not arrays.
        with readable(self.metadata), warnings.catch_warnings(action="ignore"):
            found = zarr.open_group(self.path, mode="r", zarr_format=3)
            self.attributes = dict[str, Any](found.attrs)
            members = found.members(max_depth=1)
            arrays = [(name, x) for name, x in members if isinstance(x, zarr.Array)]
            self.arrays = {name: x for name, x in arrays if x.dtype.kind in "biuf"}
            self.headers = {name: header_of(x.shape, x.dtype) for name, x in self.arrays.items()}
        self.names = list(self.headers)

    def _read(self, name: str) -> np.ndarray:
        """Read an array; refuse too large chunks, and missing files."""
        array = self.arrays[name]
        check_memory(math.prod(array.chunks) * array.dtype.itemsize, self.path)
        self.refuse_missing_files(name)
        return self.read_begun(name)

    def read_begun(self, name: str) -> np.ndarray:
        """Read an array of which some files need not be written: they contain the fill value."""
        with readable(self.metadata, f"its array {name} is"):
            return np.asarray(self.arrays[name][...])

    def refuse_missing_files(self, name: str) -> None:
        """Refuse an array without all of its files: Zarr reads a missing one as the fill value."""
        array = self.arrays[name]
        together = array.shards or array.chunks
        steps = zip(array.shape, together, strict=True)
        files = math.prod(-(-size // step) for size, step in steps)
        filled = array.nchunks_initialized * math.prod(array.chunks) // math.prod(together)
        if missing := files - filled:
            raise InputError(
                f"{Path(self.path, name)} cannot be read: {missing} of its {files} chunk files are "
                f"missing; if they were left out because they contain zeros, write the array with "
                f"write_empty_chunks=True."
            )
