"""Zarr folders: arrays of numbers are opened, and nothing is unpickled.

Zarr raises many kinds of errors for unexpected metadata; `GroupFile` and `ArrayFile` accept only
those that this package writes for data sets and processed videos.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from math import prod
from pathlib import Path
from typing import Any, Literal

import numpy as np

from lf_flame._common.arrays_in_files import ArrayHeader
from lf_flame._common.input_files import read_record, readable
from lf_flame._common.memory import check_memory
from lf_flame.errors import InputError

ZARR_ERRORS = (OSError, ValueError, TypeError, LookupError, AttributeError, RuntimeError,
               NotImplementedError, OverflowError)  # fmt: skip
"""Exceptions of Zarr and its codecs for damaged metadata and chunks."""

METADATA = ("zarr.json", ".zarray", ".zgroup")
"""Names of the metadata of formats 3 and 2, one of which every Zarr folder holds."""

SAFE_CODECS = ("blosc", "zstd", "lz4", "zlib", "gzip", "bz2", "lzma")
"""Codecs of format 2 that only unpack; others may run what a chunk holds, as ``pickle`` does."""

EVERY_CHUNK = {"write_empty_chunks": True}
"""Configuration of arrays that we write: also chunks of zeros get files, so that a missing file is
noticed when the array is read, see `refuse_missing_chunks`."""

MOST_TOGETHER = 4096
"""Largest number of samples, or frames, in a file that this package writes."""

MOST_ARRAYS = 1000
"""Largest number of arrays of a group among which views are searched for."""


def is_zarr(path: str | Path) -> bool:
    """Whether a path is a Zarr folder, by the metadata in it."""
    return any((Path(path) / name).is_file() for name in METADATA)


class ZarrFile:
    """Arrays of numbers in a Zarr folder; the interface is that of `ArrayFile`.

    Attributes
    ----------
    path : Path
    names : list of str
        Names of the arrays in the group; a folder that is one array has the name "" alone.
    metadata : Path
        File with the metadata of the array or group.
    """

    def __init__(self, path: str | Path):
        self.path, zarr = Path(path), import_zarr()
        if not is_zarr(path):
            raise InputError(f"{path} is no Zarr folder: it holds none of {', '.join(METADATA)}.")
        self.metadata = next(self.path / x for x in METADATA if (self.path / x).is_file())
        with readable(self.metadata, ZARR_ERRORS):
            found = zarr.open(str(self.path), mode="r")
            arrays = {"": found} if isinstance(found, zarr.Array) else dict(found.arrays())
        some = list(arrays.items())[:MOST_ARRAYS]
        self._arrays = {name: array for name, array in some if array.dtype.kind in "biuf"}
        self.names = list(self._arrays)

    def header(self, name: str) -> ArrayHeader:
        """Shape and type of an array."""
        array = self._arrays[name]
        return ArrayHeader(array.shape, array.dtype)

    def _check(self, name: str) -> Any:
        """Refuse codecs that could run code, too large chunks, and missing files."""
        array = self._arrays[name]
        record = array.metadata.to_dict()
        if record["zarr_format"] == 2:
            codecs = filter(None, [*(record["filters"] or ()), record["compressor"]])
            odd = [codec["id"] for codec in codecs if codec["id"] not in SAFE_CODECS]
            if odd:
                raise InputError(
                    f"{self.path} cannot be read: {name or 'the array'} is packed by {odd[0]}; "
                    f"store it with one of {', '.join(SAFE_CODECS)}."
                )
        check_memory(prod(array.chunks) * array.dtype.itemsize, self.path)
        refuse_missing_chunks(array, self.path)
        return array

    def read(self, names: Iterable[str], copies: float = 1.0) -> list[np.ndarray]:
        """Read arrays by name, if they fit into memory `copies` times."""
        arrays = [self._check(name) for name in names]
        needed = sum(prod(array.shape) * array.dtype.itemsize for array in arrays)
        check_memory(int(copies * needed), self.path)
        with readable(self.metadata, ZARR_ERRORS):
            return [np.asarray(array[...]) for array in arrays]


def refuse_missing_chunks(array: Any, path: Path) -> None:
    """Refuse an array without all of its files: Zarr reads a missing one as the fill value.

    Raises
    ------
    InputError
    """
    together = array.shards or array.chunks
    files = prod(-(-size // step) for size, step in zip(array.shape, together, strict=True))
    missing = files - array.nchunks_initialized * prod(array.chunks) // prod(together)
    if missing:
        raise InputError(
            f"{path / array.path} cannot be read: {missing} of its {files} chunk files are "
            f"missing; if they were left out as they hold zeros, write the array with "
            f"write_empty_chunks=True."
        )


@dataclass(frozen=True)
class GroupFile:
    """Metadata file of a group that this package writes."""

    zarr_format: Literal[3]
    node_type: Literal["group"]
    attributes: dict[str, Any]


@dataclass(frozen=True)
class Chunks:
    """Shape of the chunks of a regular grid."""

    chunk_shape: list[int]


@dataclass(frozen=True)
class Grid:
    """Division of an array into chunks."""

    name: Literal["regular"]
    configuration: Chunks


@dataclass(frozen=True)
class Codec:
    """A step between an array and the bytes of its chunks."""

    name: Literal["bytes", "zstd", "crc32c", "sharding_indexed"]


@dataclass(frozen=True)
class ArrayFile:
    """Metadata file of an array that this package writes, with whole samples in each file."""

    zarr_format: Literal[3]
    node_type: Literal["array"]
    shape: list[int]
    data_type: Literal["float32", "float64", "uint8"]
    chunk_grid: Grid
    fill_value: Literal["NaN", 0]
    codecs: list[Codec]

    def __post_init__(self):
        chunk = self.chunk_grid.configuration.chunk_shape
        together = chunk[0] if chunk else 0
        whole = min(self.shape, default=0) >= 1 and chunk[1:] == self.shape[1:]
        if not (whole and 1 <= together <= MOST_TOGETHER):
            raise InputError(
                f"shape and chunk_shape must be those of whole samples, up to {MOST_TOGETHER} "
                f"together, got {self.shape[:6]} and {chunk[:6]}."
            )


def array_records(path: Path) -> dict[str, dict[str, Any]]:
    """Read the metadata file of each array in a group's folder, by the array's name."""
    files = sorted([*path.glob("*/zarr.json"), *path.glob("*/*/zarr.json")])
    found = {file.parent.relative_to(path).as_posix(): read_record(file) for file in files}
    return {name: record for name, record in found.items() if record.get("node_type") != "group"}


def open_array(group: Any, name: str) -> Any:
    """Open an array of a group in a folder, never a group inside it.

    Raises
    ------
    InputError
        If there is none of that name, or it is damaged.
    """
    with readable(group.store.root / name / "zarr.json", ZARR_ERRORS):
        array = group[name]
    if not isinstance(array, import_zarr().Array):
        raise InputError(f"{name} of {group.store.root} must be an array, got a group.")
    return array


def import_zarr() -> Any:
    """Import Zarr, or say how to install it."""
    try:
        import zarr
    except ImportError:
        raise InputError(
            "Zarr folders are read and written by zarr: pip install 'lf_flame[video]'."
        ) from None
    return zarr
