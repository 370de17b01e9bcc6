"""Arrays of light fields in Zarr folders of any program; nothing is unpickled."""

from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from lf_flame._common.arrays_in_files import ArrayHeader, FileOfArrays
from lf_flame._common.input_files import check_memory, readable
from lf_flame._common.zarr_files import METADATA_3, refuse_missing_chunks
from lf_flame.errors import InputError

METADATA = (METADATA_3, ".zarray", ".zgroup")
"""Names of the metadata of formats 3 and 2, one of which every Zarr folder holds."""

SAFE_CODECS = ("blosc", "zstd", "lz4", "zlib", "gzip", "bz2", "lzma")
"""Codecs of format 2 that only unpack; others may run what a chunk holds, as ``pickle`` does."""

EVERY_CHUNK = {"write_empty_chunks": True}
"""Configuration of arrays that we write: also chunks of zeros get files, so that a missing file is
noticed when the array is read, see `refuse_missing_chunks`."""

MOST_ARRAYS = 1000
"""Largest number of arrays of a group among which views are searched for."""


def is_zarr(path: str | Path) -> bool:
    """Whether a path is a Zarr folder, by the metadata in it."""
    return any((Path(path) / name).is_file() for name in METADATA)


class ZarrFile(FileOfArrays):
    """Arrays of numbers in a Zarr folder; a folder that is one array has the name "" alone."""

    def __init__(self, path: str | Path):
        self.path, zarr = Path(path), import_zarr()
        if not is_zarr(path):
            raise InputError(f"{path} is no Zarr folder: it holds none of {', '.join(METADATA)}.")
        self.metadata = next(self.path / x for x in METADATA if (self.path / x).is_file())
        with readable(self.metadata):
            found = zarr.open(str(self.path), mode="r")
            arrays = {"": found} if isinstance(found, zarr.Array) else dict(found.arrays())
        some = list(arrays.items())[:MOST_ARRAYS]
        self._arrays = {name: array for name, array in some if array.dtype.kind in "biuf"}
        self.names = list(self._arrays)
        self.headers = {name: ArrayHeader(x.shape, x.dtype) for name, x in self._arrays.items()}

    def _read(self, name: str) -> np.ndarray:
        """Read an array; refuse codecs that could run code, too large chunks, missing files."""
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
        refuse_missing_chunks(array, Path(self.path))
        with readable(self.metadata):
            return np.asarray(array[...])


def import_zarr() -> Any:
    """Import Zarr, or say how to install it."""
    try:
        import zarr
    except ImportError:
        raise InputError(
            "Zarr folders are read and written by zarr: pip install '.[video]'."
        ) from None
    return zarr
