"""Zarr folders of data sets and processed videos: only metadata that this package writes."""

from math import prod
from pathlib import Path
from typing import Any

from lf_flame._common.input_files import read_record, readable
from lf_flame.errors import InputError

METADATA_3 = "zarr.json"

WRITTEN_CODECS = ("bytes", "zstd", "crc32c", "sharding_indexed")
WRITTEN_TYPES = ("float32", "float64", "uint8")
"""Codecs of format 3, and types of numbers, that this package writes."""

MOST_TOGETHER = 4096
"""Largest number of samples, or frames, in a chunk that this package writes."""


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
    with readable(group.store.root / name / "zarr.json"):
        array = group[name]
    if not hasattr(array, "chunks"):
        raise InputError(f"{name} of {group.store.root} must be an array, got a group.")
    return array
