"""What folders hold, but for dates and durations: what has to be the same in two runs."""

import csv
import hashlib
import io
import json
from pathlib import Path
from zipfile import ZipFile

import h5py
import numpy as np

VARYING = {
    "date", "command", "seconds", "wall_s", "train_s", "start_s", "ms", "versions", "machine",
    "git_revision", "provenance", "evaluation", "exported",
    # hashes of files that hold these
    "sha256", "model_sha256", "attributes_sha256", "record_sha256",
}  # fmt: skip
"""Keys of records, and columns of tables, that differ from run to run."""


def contents(folder: Path, known: dict[int, str] | None = None) -> dict[str, str]:
    """Describe all that a folder holds.

    Parameters
    ----------
    folder : Path
    known : dict of str, optional
        Descriptions of large files by their inode, so that a file that was not replaced is not
        read.

    Returns
    -------
    dict of str
        By the path of each file, link and folder.
    """
    found = {}
    for path in sorted(folder.rglob("*")):
        name = str(path.relative_to(folder))
        if path.is_symlink():
            found[name] = f"link to {path.readlink()}"
        elif path.is_dir():
            found[name] = "folder"
        elif path.is_file():
            found[name] = (known or {}).get(path.stat().st_ino) or describe(path)
        else:
            found[name] = "device"
    return found


def describe(path: Path) -> str:
    """Hash a file, without what varies; what cannot be read as what it is called, by its bytes."""
    content = path.read_bytes()
    try:
        if path.suffix == ".json":
            content = json.dumps(_constant(json.loads(content)), sort_keys=True).encode()
        elif path.suffix == ".csv":
            content = _constant_table(content.decode())
        elif path.suffix == ".keras":
            content = _weights(path)
    except Exception:  # damaged, in whatever way: by its bytes
        content = path.read_bytes()
    return hashlib.sha256(content).hexdigest()[:16]


def _constant(value):
    if isinstance(value, dict):
        return {key: _constant(inside) for key, inside in value.items() if key not in VARYING}
    return [_constant(inside) for inside in value] if isinstance(value, list) else value


def _constant_table(text: str) -> bytes:
    rows = [
        {key: value for key, value in row.items() if key not in VARYING}
        for row in csv.DictReader(io.StringIO(text))
    ]
    return json.dumps(rows).encode()


def _weights(path: Path) -> bytes:
    """Hash a network's weights by name: in its configuration Keras writes memory addresses."""
    digest = hashlib.sha256()

    def add(name: str, value) -> None:
        if isinstance(value, h5py.Dataset):
            digest.update(name.encode())
            digest.update(np.ascontiguousarray(value[()]).tobytes())

    with ZipFile(path) as archive:
        stored = io.BytesIO(archive.read("model.weights.h5"))
    with h5py.File(stored) as weights:
        weights.visititems(add)
    return digest.digest()


def differences(found: dict[str, str], expected: dict[str, str]) -> str:
    """Say in a few words how two folders differ; nothing if they do not."""
    left = sorted(found.keys() - expected.keys())
    missing = sorted(expected.keys() - found.keys())
    other = sorted(name for name in found.keys() & expected.keys() if found[name] != expected[name])
    named = (("left over", left), ("missing", missing), ("another content", other))
    return "; ".join(f"{what}: {', '.join(names[:4])}" for what, names in named if names)
