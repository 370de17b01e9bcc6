"""Hashes of a data set: of its images, its drawn parameters, and its attributes."""

import hashlib
import json
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from zarr.storage import FsspecStore, LocalStore

from lf_flame._common.input_files import parse_json, read_record, readable
from lf_flame._common.zarr_files import ZARR_ERRORS
from lf_flame.datasets.metadata import METADATA, SIMULATED
from lf_flame.errors import InputError

ATTRIBUTES_SHA256 = "attributes_sha256"
"""Name of the attribute that holds the hash of the others."""


def open_array(group: zarr.Group, name: str) -> zarr.Array:
    """Open an array of a group, never a group inside it.

    Raises
    ------
    InputError
        If there is none of that name, or it is damaged.
    """
    folder = _folder(group)
    with readable(folder / name / METADATA, ZARR_ERRORS) if folder else nullcontext():
        array = group[name]
    if not isinstance(array, zarr.Array):
        raise InputError(f"{name} of a data set must be an array, got a group: it is damaged.")
    return array


def samples_together(array: zarr.Array) -> int:
    """Count the samples in a file of an array, which are best read together."""
    return (array.shards or array.chunks)[0]


def hash_images(group: zarr.Group) -> str:
    """Hash input and target of each sample in turn: independent of how they are stored."""
    digest = hashlib.sha256()
    inputs, targets = open_array(group, "input"), open_array(group, "target")
    count = samples_together(inputs)
    for first in range(0, inputs.shape[0], count):
        some = (np.asarray(array[first : first + count]) for array in (inputs, targets))
        for shown, target in zip(*some, strict=True):
            digest.update(np.ascontiguousarray(shown).data)
            digest.update(np.ascontiguousarray(target).data)
    return digest.hexdigest()


def hash_parameters(group: zarr.Group) -> str:
    """Hash what was drawn and planned for each sample."""
    digest = hashlib.sha256()
    for name in describe_arrays(group):
        if name == SIMULATED or name.startswith("parameters/"):
            digest.update(name.encode())
            digest.update(np.ascontiguousarray(open_array(group, name)[:]).data)
    return digest.hexdigest()


def set_attributes(group: zarr.Group, attributes: dict[str, Any]) -> None:
    """Set attributes and their hash in one write."""
    attributes = json.loads(json.dumps(attributes))
    sealed = {**attributes, ATTRIBUTES_SHA256: _hash_attributes(group, attributes)}
    group.update_attributes(sealed)  # `group.attrs.update` would write the file for each of them


def check_attributes(group: zarr.Group, path: str | Path) -> None:
    """Compare attributes with their hash; older data sets have none.

    Raises
    ------
    InputError
        If they differ.
    """
    attributes = dict(group.attrs)
    known = attributes.get(ATTRIBUTES_SHA256)
    if known is not None and known != _hash_attributes(group, attributes):
        raise InputError(
            f"{path} is damaged: its attributes (zarr.json) are not those that were written; "
            f"remove it and make it again."
        )


def _hash_attributes(group: zarr.Group, attributes: dict[str, Any]) -> str:
    """Hash all attributes but this hash, and the metadata of each array."""
    attributes = {key: value for key, value in attributes.items() if key != ATTRIBUTES_SHA256}
    text = json.dumps({"attributes": attributes, "arrays": describe_arrays(group)}, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def describe_arrays(group: zarr.Group) -> dict[str, dict[str, Any]]:
    """Read the metadata of each array, by its name, as stored in its file."""
    found = dict(_describe_in_folder(group) if _folder(group) else _describe_in_store(group))
    return {name: found[name] for name in sorted(found) if name != "parameters"}


def _describe_in_folder(group: zarr.Group) -> Iterator[tuple[str, dict[str, Any]]]:
    root = _folder(group)
    assert root is not None
    for pattern in (f"*/{METADATA}", f"parameters/*/{METADATA}"):
        for file in root.glob(pattern):
            yield file.parent.relative_to(root).as_posix(), read_record(file)


def _describe_in_store(group: zarr.Group) -> Iterator[tuple[str, dict[str, Any]]]:
    import fsspec

    store = group.store
    assert isinstance(store, FsspecStore)
    protocol, options = store.fs.protocol, dict(store.fs.storage_options)
    # Zarr's own file system works in an event loop; this is the same one outside of it.
    options = {key: value for key, value in options.items() if key not in ("asynchronous", "loop")}
    files = fsspec.filesystem(protocol if isinstance(protocol, str) else protocol[0], **options)
    store.fs.invalidate_cache()  # its listing may be outdated
    for name, _ in group.members(max_depth=None):
        file = f"{store.path}/{name}/{METADATA}"
        record = parse_json(files.cat_file(file).decode(), file)
        if not isinstance(record, dict):
            raise InputError(f"{file} is no record: it must hold names and values.")
        yield name, record


def _folder(group: zarr.Group) -> Path | None:
    return group.store.root if isinstance(group.store, LocalStore) else None
