"""Checks of the metadata in a data set's Zarr files, before Zarr reads them."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lf_flame._common import zarr_files
from lf_flame._common.config import build_record
from lf_flame._common.input_files import check_regular
from lf_flame._common.memory import check_memory
from lf_flame.datasets.config import MOST_SAMPLES, DatasetConfig
from lf_flame.errors import InputError

METADATA = "zarr.json"

SIMULATED = "simulated"
"""Name of an array, and attribute, on the effects of each sample, if they are planned for each."""


@dataclass(frozen=True)
class Attributes:
    """Attributes of a data set's group, once its arrays exist.

    Attributes
    ----------
    config : dict
        Configuration, see `lf_flame.datasets.config.config_to_json`.
    slopes : list of float
        Slopes of the targets.
    objects : list of str
        Names of the objects.
    rays : int, optional
        Number of rays per pixel along each axis, if the data set's route traces rays.
    """

    config: dict[str, Any]
    slopes: list[float]
    objects: list[str]
    rays: int | None = None


def read_attributes(path: Path) -> Attributes | None:
    """Read the attributes of a data set's group; None if its arrays do not exist yet.

    Raises
    ------
    InputError
        If its metadata are damaged, or those of something else.
    """
    found = zarr_files.read_attributes(path)
    if "config" not in found:  # it is written last
        return None
    return build_record(Attributes, found, path / METADATA)


def _check_array(folder: Path, shapes: Sequence[tuple[int, ...]]) -> int:
    """Check the metadata of an array for the allowed shapes of a sample; returns their number."""
    samples, *shape = zarr_files.read_array_shape(folder)
    if tuple(shape) not in shapes:
        raise InputError(
            f"{folder} is damaged: a sample must have the shape {shapes[0]}, got "
            f"{tuple(shape[:6])}."
        )
    return samples


def check_array_files(path: Path, config: DatasetConfig) -> int:
    """Check the metadata of a data set's arrays, and the kinds and sizes of its files.

    Returns
    -------
    int
        Number of samples.

    Raises
    ------
    InputError
        If an array is missing, damaged, or does not fit the configuration; or a file is a device, a
        pipe, or larger than the memory limit, because Zarr reads whole files.
    """
    for file in path.rglob("*"):
        if not file.is_dir():
            check_memory(check_regular(file), file)
    shown = config.input.shape(config.image)
    shapes = {
        "complete": [()],
        # Older data sets store one channel without an axis.
        "input": [shown, shown[:2]] if shown[2] == 1 else [shown],
        "target": [(len(config.depths_mm), *config.image)],
    }
    counts = {_check_array(path / name, shapes[name]) for name in shapes}
    if len(counts) > 1 or max(counts) > MOST_SAMPLES:
        raise InputError(
            f"{path} is damaged: its arrays must have as many samples, up to {MOST_SAMPLES}, got "
            f"{', '.join(map(str, sorted(counts)))}."
        )
    return counts.pop()
