"""Data sets of light-field images and their refocused stacks, as Zarr v3 groups.

A group has ``input`` (n, h, w, channels), the network's input from the light field, see
`lf_flame.datasets.encodings`; ``target`` (n, objects, h, w), the light field refocused at the slope
of each object; ``parameters/*``, the values that were drawn; and ``complete`` (n,). Images are in
shards, files of several samples, each compressed separately and with a checksum; other arrays are
in chunks of as many samples. `lf_flame.datasets.making` makes such groups.
"""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from lf_flame._common.config import build
from lf_flame.datasets.config import MOST_SAMPLES, DatasetConfig, config_from_json
from lf_flame.errors import InputError
from lf_flame.formats.array_files import ZarrFile


@dataclass(frozen=True)
class Attributes:
    """Attributes of a data set that are read again, `build` from them; others say its origin."""

    config: dict[str, Any]  # from `to_json`
    slopes: list[float]  # of the targets
    objects: list[str]  # names
    rays: int | None  # number per pixel along each axis, if the route traces rays


def check_file(file: ZarrFile, config: DatasetConfig) -> int:
    """Refuse a data set without arrays of the configuration's shapes; number of its samples."""
    known = {
        "complete": (),
        "input": config.input.shape(config.image),
        "target": (len(config.depths_mm), *config.image),
    }
    shapes = {name: header.shape for name, header in file.headers.items()}
    for name, shape in known.items():
        found = shapes.get(name)
        if not found or found[1:] != shape:
            raise InputError(
                f"{file.path} is damaged: a sample of its array {name} must have the shape "
                f"{shape}, got {found and found[1:6]}."
            )
    counts = {shape[0] for shape in shapes.values() if shape}
    if len(counts) > 1 or max(counts) > MOST_SAMPLES:
        raise InputError(
            f"{file.path} is damaged: its arrays must have the same number of samples, at most "
            f"{MOST_SAMPLES}, got {', '.join(map(str, sorted(counts)))}."
        )
    return counts.pop()


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
        if not (self.path / "zarr.json").exists():
            part = self.path.with_name(self.path.name + ".part")
            hint = " (it was begun, but is not finished)" if part.exists() else ""
            raise InputError(
                f"There is no data set at {path}{hint}; make it with `lf-flame dataset`."
            )
        self._file = ZarrFile(path)
        self.attrs = self._file.attributes
        found = build(Attributes, self.attrs, self._file.metadata)
        self.config = config_from_json(found.config, self.path)
        self._count = check_file(self._file, self.config)
        if not len(found.slopes) == len(found.objects) == len(self.config.depths_mm):
            raise InputError(
                f"{path} is damaged: there must be one slope and one name for each object."
            )
        complete = self._file.read_begun("complete")
        if not np.all(complete == 1):
            missing = np.flatnonzero(complete != 1)[0]
            raise InputError(f"{path} is not complete: sample {missing} is missing; make it again.")
        for name in self._file.names:
            self._file.refuse_missing_files(name)

    def __len__(self) -> int:
        return self._count

    @cached_property
    def inputs(self) -> np.ndarray:
        """Network inputs, shape (n, height, width, channels), float32 in [0, 1]."""
        return self._read("input")

    @cached_property
    def targets(self) -> np.ndarray:
        """Refocused images, shape (n, objects, h, w), float32 in [0, 1]."""
        return self._read("target")

    def parameters(self, name: str) -> np.ndarray:
        """Drawn values, shape (n, objects) or (n, objects, 2), float64."""
        return self._read(f"parameters/{name}")

    def _read(self, name: str) -> np.ndarray:
        (samples,) = self._file.read([name])
        finite = [bool(np.isfinite(sample).all()) for sample in samples]
        if not all(finite):
            raise InputError(
                f"Sample {finite.index(False)} of {self.path / name} is missing or not finite; "
                f"remove the data set and make it again."
            )
        return samples


def split_indices(n: int, shares: tuple[float, float, float], seed: int) -> dict[str, np.ndarray]:
    """Split n samples at random into "train", "validation" and "test".

    Parameters
    ----------
    n : int
        Number of samples.
    shares : (float, float, float)
        Fractions of training, validation and test.
    seed : int
        Seed of the random order.

    Returns
    -------
    dict of ndarray of int
        Indices of each part, increasing.

    Raises
    ------
    InputError
        If a part would be empty.

    Examples
    --------
    >>> from lf_flame.datasets import split_indices
    >>> {name: len(indices) for name, indices in split_indices(10, (0.8, 0.1, 0.1), 1).items()}
    {'train': 8, 'validation': 1, 'test': 1}
    """
    order = np.random.default_rng(seed).permutation(n)
    first, second = round(n * shares[0]), round(n * (shares[0] + shares[1]))
    parts = np.split(order, [first, second])
    if min(len(part) for part in parts) == 0:
        raise InputError(f"{n} samples are too few to split by {shares}: a part would be empty.")
    return dict(zip(("train", "validation", "test"), map(np.sort, parts), strict=True))
