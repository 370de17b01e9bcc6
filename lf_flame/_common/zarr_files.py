"""Zarr folders: arrays of numbers are opened, and nothing is unpickled."""

from collections.abc import Iterable
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from lf_flame._common.arrays_in_files import ArrayHeader
from lf_flame._common.input_files import readable
from lf_flame._common.memory import check_memory
from lf_flame.errors import InputError

ZARR_ERRORS = (OSError, ValueError, TypeError, LookupError, AttributeError, RuntimeError,
               NotImplementedError, OverflowError)  # fmt: skip
"""Exceptions of Zarr and its codecs for damaged metadata and chunks."""

METADATA = ("zarr.json", ".zarray", ".zgroup")
"""Names of the metadata of formats 3 and 2, one of which every Zarr folder holds."""

SAFE_CODECS = ("blosc", "zstd", "lz4", "zlib", "gzip", "bz2", "lzma")
"""Codecs of format 2 that only unpack; others may run what a chunk holds, as ``pickle`` does."""

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

    def open(self, name: str) -> Any:
        """Open an array, to read parts of it.

        Raises
        ------
        InputError
            If it is packed in a way that could run code, or one chunk exceeds the memory limit.
        """
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
        return array

    def read(self, names: Iterable[str], copies: float = 1.0) -> list[np.ndarray]:
        """Read arrays by name, if they fit into memory `copies` times.

        Raises
        ------
        InputError
            If one is damaged, or they exceed the memory limit.
        """
        arrays = [self.open(name) for name in names]
        needed = sum(prod(array.shape) * array.dtype.itemsize for array in arrays)
        check_memory(int(copies * needed), self.path)
        with readable(self.metadata, ZARR_ERRORS):
            return [np.asarray(array[...]) for array in arrays]


def import_zarr() -> Any:
    """Import Zarr, or say how to install it."""
    try:
        import zarr
    except ImportError:
        raise InputError(
            "Zarr folders are read and written by zarr: pip install 'lf_flame[video]'."
        ) from None
    return zarr
