"""Data sets of light-field images and their refocused stacks, as Zarr v3 groups.

A group has ``input`` (n, h, w, channels), the network's input from the light field, see
`lf_flame.datasets.encodings`; ``target`` (n, objects, h, w), the light field refocused at the slope
of each object; ``parameters/*``, the values that were drawn; and ``complete`` (n,). If effects are
planned for each sample, ``simulated`` (n, 1 + effects) says whether rays were traced and which
effects were simulated, and an attribute of that name counts the samples. Images are in shards,
files of some samples, each compressed separately and with a checksum; other arrays are in chunks of
as many samples. `lf_flame.datasets.making` makes such groups.
"""

from functools import cached_property
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import zarr

from lf_flame._common.input_files import readable
from lf_flame._common.memory import check_memory
from lf_flame._common.zarr_files import ZARR_ERRORS, open_array, refuse_missing_chunks
from lf_flame.datasets.config import config_from_json
from lf_flame.datasets.metadata import METADATA, check_array_files, read_attributes
from lf_flame.errors import InputError


class Dataset:
    """A finished data set on disk.

    Parameters
    ----------
    path : str or Path
        Folder of the Zarr group.

    Raises
    ------
    InputError
        If there is no data set, it is not finished, or it is damaged.
    """

    def __init__(self, path: str | Path):
        self.path = Path(path)
        if not (self.path / METADATA).exists():
            part = self.path.with_name(self.path.name + ".part")
            hint = " (it was begun, but is not finished)" if part.exists() else ""
            raise InputError(
                f"There is no data set at {path}{hint}; make it with `lf-flame dataset`."
            )
        found = read_attributes(self.path)
        if found is None:
            raise InputError(f"{path} is not a data set, or is damaged: it does not say what of.")
        self.config = config_from_json(found.config, self.path)
        check_array_files(self.path, self.config)
        if not len(found.slopes) == len(found.objects) == len(self.config.depths_mm):
            raise InputError(f"{path} is damaged: its slopes or objects are not as many as depths.")
        with readable(self.path / METADATA, ZARR_ERRORS):
            self._group = zarr.open_group(self.path, mode="r")
            self.attrs: dict[str, Any] = dict(self._group.attrs)
            complete = np.asarray(open_array(self._group, "complete")[:])
        if not np.all(complete == 1):
            missing = np.flatnonzero(complete != 1)[0]
            raise InputError(f"{path} is not complete: sample {missing} is missing; make it again.")

    def __len__(self) -> int:
        return open_array(self._group, "complete").shape[0]

    @cached_property
    def inputs(self) -> np.ndarray:
        """Network inputs, shape (n, height, width, channels), float32 in [0, 1]."""
        # Older data sets store them without an axis of channels.
        return self._read("input").reshape(-1, *self.config.input.shape(self.config.image))

    @cached_property
    def targets(self) -> np.ndarray:
        """Refocused images, shape (n, objects, h, w), float32 in [0, 1]."""
        return self._read("target")

    def parameters(self, name: str) -> np.ndarray:
        """Drawn values, shape (n, objects) or (n, objects, 2), float64."""
        return self._read(f"parameters/{name}")

    def _read(self, name: str) -> np.ndarray:
        array = open_array(self._group, name)
        check_memory(array.nbytes, self.path / name)
        refuse_missing_chunks(array, self.path)
        samples, count = np.empty(array.shape, array.dtype), (array.shards or array.chunks)[0]
        for first in range(0, len(self), count):
            some = slice(first, first + count)
            try:
                samples[some] = array[some]
            except ZARR_ERRORS:
                self._name_damaged(array, range(len(self))[some])
            finite = np.isfinite(samples[some]).reshape(len(samples[some]), -1).all(axis=1)
            if not finite.all():
                raise InputError(
                    f"Sample {first + int(finite.argmin())} of {self.path}/{name} is missing or "
                    f"not finite; remove the data set and make it again."
                )
        return samples

    def _name_damaged(self, array: zarr.Array, indices: range) -> NoReturn:
        """Find the sample that cannot be read among those that share a file."""
        for index in indices:
            try:
                array[index]
            except ZARR_ERRORS as error:
                damaged, reason = index, error
                break
        else:
            damaged, reason = indices[0], OSError("its file cannot be read as a whole")
        raise InputError(
            f"Sample {damaged} of {self.path}/{array.path} is damaged ({reason}); "
            f"remove the data set and make it again."
        ) from None
