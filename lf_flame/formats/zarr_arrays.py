"""Arrays of numbers in Zarr folders of any program; nothing is unpickled."""

import warnings
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from lf_flame._common.arrays_in_files import FileOfArrays, header_of
from lf_flame._common.input_files import check_memory, check_regular, readable
from lf_flame.errors import InputError

METADATA = "zarr.json"
"""Name of the metadata of format 3. Codecs of format 2, which is not read, may run what a chunk
holds, as ``pickle`` does."""

EVERY_CHUNK = {"write_empty_chunks": True}
"""Configuration of arrays that we write: also chunks of zeros get files, so that a missing file is
noticed when the array is read, see `ZarrFile`."""

MOST_ARRAYS = 1000
"""Largest number of arrays of a group among which views are searched for."""


class ZarrFile(FileOfArrays):
    """Arrays of numbers in a Zarr folder and in its groups; a folder that is one array names it "".

    No file may be a device, a pipe, or larger than the memory limit: Zarr reads whole files.
    """

    def __init__(self, path: str | Path):
        self.path, zarr = Path(path), import_zarr()
        self.metadata = self.path / METADATA
        if not self.metadata.is_file():
            raise InputError(f"{path} is no Zarr folder of format 3: it holds no {METADATA}.")
        for file in self.path.rglob("*"):
            if not file.is_dir():
                check_memory(check_regular(file), file)
        # Zarr warns of folders in it that are no arrays.
        with readable(self.metadata), warnings.catch_warnings(action="ignore"):
            found = zarr.open(str(self.path), mode="r", zarr_format=3)
            self.attributes = dict[str, Any](found.attrs)
            members = [("", found)] if isinstance(found, zarr.Array) else found.members(max_depth=1)
            arrays = [(name, x) for name, x in members if isinstance(x, zarr.Array)][:MOST_ARRAYS]
            self.arrays = {name: x for name, x in arrays if x.dtype.kind in "biuf"}
            self.headers = {name: header_of(x.shape, x.dtype) for name, x in self.arrays.items()}
        self.names = list(self.headers)

    def _read(self, name: str) -> np.ndarray:
        """Read an array; refuse too large chunks, and missing files."""
        array = self.arrays[name]
        check_memory(prod(array.chunks) * array.dtype.itemsize, self.path)
        self.refuse_missing_files(name)
        return self.read_begun(name)

    def read_begun(self, name: str) -> np.ndarray:
        """Read an array of which some files need not be written: they hold the fill value."""
        with readable(self.metadata, f"its array {name} is"):
            return np.asarray(self.arrays[name][...])

    def refuse_missing_files(self, name: str) -> None:
        """Refuse an array without all of its files: Zarr reads a missing one as the fill value."""
        array = self.arrays[name]
        together = array.shards or array.chunks
        files = prod(-(-size // step) for size, step in zip(array.shape, together, strict=True))
        missing = files - array.nchunks_initialized * prod(array.chunks) // prod(together)
        if missing:
            raise InputError(
                f"{Path(self.path, name)} cannot be read: {missing} of its {files} chunk files are "
                f"missing; if they were left out as they hold zeros, write the array with "
                f"write_empty_chunks=True."
            )


def import_zarr() -> Any:
    """Import Zarr, or say how to install it."""
    try:
        import zarr
    except ImportError:
        raise InputError(
            "Zarr folders are read and written by zarr: pip install '.[video]'."
        ) from None
    return zarr
