"""Checks of the metadata in a data set's Zarr files, before Zarr reads them.

Zarr raises many kinds of errors for unexpected metadata. Only the metadata that
`lf_flame.datasets.making` writes are accepted here.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from lf_flame._common.config import build_record, load_record
from lf_flame._common.input_files import check_regular, read_record
from lf_flame._common.memory import check_memory
from lf_flame.datasets.config import MOST_SAMPLES, DatasetConfig
from lf_flame.errors import InputError

METADATA = "zarr.json"

IMAGES = ("complete", "input", "target")
"""Names of the arrays that every data set has."""

SIMULATED = "simulated"
"""Name of an array, and attribute, on the effects of each sample, if they are planned for each."""

MOST_TOGETHER = 4096
"""Largest number of samples in a file."""


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
    sha256 : str, optional
        SHA-256 of inputs and targets, if the data set is finished.
    """

    config: dict[str, Any]
    slopes: list[float]
    objects: list[str]
    rays: int | None = None
    sha256: str | None = None


@dataclass(frozen=True)
class GroupFile:
    """Metadata file of a group."""

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
    """Metadata file of an array, with whole samples in each file."""

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


def read_attributes(path: Path) -> Attributes | None:
    """Read the attributes of a data set's group; None if its arrays do not exist yet.

    Raises
    ------
    InputError
        If its metadata are damaged, or those of something else.
    """
    found = load_record(GroupFile, path / METADATA).attributes
    if "config" not in found:  # it is written last
        return None
    return build_record(Attributes, found, path / METADATA)


def check_array(record: dict[str, Any], shapes: Sequence[tuple[int, ...]], source: str) -> int:
    """Check the metadata of an array of a data set.

    Parameters
    ----------
    record : dict
        Metadata of the array.
    shapes : sequence of tuple of int
        Allowed shapes of a sample.
    source : str
        Name of the array, for messages.

    Returns
    -------
    int
        Number of samples.

    Raises
    ------
    InputError
        If it is not an array of a data set.
    """
    samples, *shape = build_record(ArrayFile, record, f"{source}/{METADATA}").shape
    if tuple(shape) not in shapes:
        raise InputError(
            f"{source} is damaged: a sample must have the shape {shapes[0]}, got "
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
    records = {name: read_record(path / name / METADATA) for name in IMAGES}
    return check_array_records(path, records, config)


def check_array_records(
    source: str | Path, records: Mapping[str, dict[str, Any]], config: DatasetConfig
) -> int:
    """Check the metadata of a data set's arrays.

    Parameters
    ----------
    source : str or Path
        Name of the data set, for messages.
    records : mapping of str to dict
        Metadata by the name of the array.
    config : DatasetConfig

    Returns
    -------
    int
        Number of samples.

    Raises
    ------
    InputError
        If an array is missing, damaged, or does not fit the configuration.
    """
    shown = config.input.shape(config.image)
    shapes = {
        "complete": [()],
        # Older data sets store one channel without an axis.
        "input": [shown, shown[:2]] if shown[2] == 1 else [shown],
        "target": [(len(config.depths_mm), *config.image)],
    }
    for name in IMAGES:
        if name not in records:
            raise InputError(f"{source} is damaged: it has no {name}.")
    counts = {check_array(records[name], shapes[name], f"{source}/{name}") for name in IMAGES}
    if len(counts) > 1 or max(counts) > MOST_SAMPLES:
        raise InputError(
            f"{source} is damaged: its arrays must have as many samples, up to {MOST_SAMPLES}, got "
            f"{', '.join(map(str, sorted(counts)))}."
        )
    return counts.pop()
