"""Zarr folders: arrays of numbers are opened, and nothing is unpickled.

Zarr raises many kinds of errors for unexpected metadata; of data sets and processed videos only
metadata that this package writes are accepted.
"""

from collections.abc import Iterable
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from lf_flame._common.arrays_in_files import ArrayHeader
from lf_flame._common.input_files import read_record, readable
from lf_flame._common.memory import check_memory
from lf_flame.errors import InputError

ZARR_ERRORS = (OSError, ValueError, TypeError, LookupError, AttributeError, RuntimeError,
               NotImplementedError, OverflowError)  # fmt: skip
"""Exceptions of Zarr and its codecs for damaged metadata and chunks."""

METADATA_3 = "zarr.json"
METADATA = (METADATA_3, ".zarray", ".zgroup")
"""Names of the metadata of formats 3 and 2, one of which every Zarr folder holds."""

SAFE_CODECS = ("blosc", "zstd", "lz4", "zlib", "gzip", "bz2", "lzma")
"""Codecs of format 2 that only unpack; others may run what a chunk holds, as ``pickle`` does."""

WRITTEN_CODECS = ("bytes", "zstd", "crc32c", "sharding_indexed")
WRITTEN_TYPES = ("float32", "float64", "uint8")
"""Codecs of format 3, and types of numbers, that this package writes."""

EVERY_CHUNK = {"write_empty_chunks": True}
"""Configuration of arrays that we write: also chunks of zeros get files, so that a missing file is
noticed when the array is read, see `refuse_missing_chunks`."""

MOST_TOGETHER = 4096
"""Largest number of samples, or frames, in a chunk that this package writes."""

MOST_ARRAYS = 1000
"""Largest number of arrays of a group among which views are searched for."""


def is_zarr(path: str | Path) -> bool:
    """Whether a path is a Zarr folder, by the metadata in it."""
    return any((Path(path) / name).is_file() for name in METADATA)


class ZarrFile:
    """Arrays of numbers in a Zarr folder; a folder that is one array has the name "" alone.

    The interface is that of `lf_flame._common.arrays_in_files`.
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
    """Refuse an array without all of its files: Zarr reads a missing one as the fill value."""
    together = array.shards or array.chunks
    files = prod(-(-size // step) for size, step in zip(array.shape, together, strict=True))
    missing = files - array.nchunks_initialized * prod(array.chunks) // prod(together)
    if missing:
        raise InputError(
            f"{path / array.path} cannot be read: {missing} of its {files} chunk files are "
            f"missing; if they were left out as they hold zeros, write the array with "
            f"write_empty_chunks=True."
        )


def read_attributes(folder: Path) -> dict[str, Any]:
    """Read the attributes of a group that this package writes."""
    record = read_record(folder / METADATA_3)
    kind, attributes = record.get("node_type"), record.get("attributes")
    if (kind, record.get("zarr_format")) != ("group", 3) or not isinstance(attributes, dict):
        raise InputError(f"{folder / METADATA_3} is damaged, or not that of a group of Zarr 3.")
    return attributes


def read_array_shape(folder: Path) -> list[int]:
    """Read the shape of an array that this package writes: whole samples or frames in a chunk."""
    record = read_record(folder / METADATA_3)
    try:
        shape, chunk = record["shape"], record["chunk_grid"]["configuration"]["chunk_shape"]
        ours = (
            (record["node_type"], record["zarr_format"]) == ("array", 3)
            and record["chunk_grid"]["name"] == "regular"
            and record["data_type"] in WRITTEN_TYPES
            and record["fill_value"] in ("NaN", 0)
            and all(codec["name"] in WRITTEN_CODECS for codec in record["codecs"])
            and all(type(n) is int and n >= 1 for n in (*shape, *chunk))
            and chunk[0] <= MOST_TOGETHER
            and chunk[1:] == shape[1:]
        )
    except (LookupError, TypeError):
        ours = False
    if not ours:
        raise InputError(
            f"{folder / METADATA_3} is damaged, or not that of an array of this program, with "
            f"chunks of whole samples, up to {MOST_TOGETHER} together."
        )
    return shape


def array_names(folder: Path) -> list[str]:
    """Names of the arrays in a group's folder, and in the groups in it."""
    files = sorted([*folder.glob(f"*/{METADATA_3}"), *folder.glob(f"*/*/{METADATA_3}")])
    return [
        file.parent.relative_to(folder).as_posix()
        for file in files
        if read_record(file).get("node_type") != "group"
    ]


def open_array(group: Any, name: str) -> Any:
    """Open an array of a group in a folder; refuse a group inside it, or a damaged array."""
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
            "Zarr folders are read and written by zarr: pip install '.[video]'."
        ) from None
    return zarr
