"""Contents of folders without dates and durations: what must be equal in two runs."""

import csv
import hashlib
import io
import json
from contextlib import suppress
from pathlib import Path
from zipfile import ZipFile

VARYING = {
    "date", "command", "seconds", "wall_s", "train_s", "start_s", "ms", "versions", "machine",
    "git_revision", "provenance", "evaluation", "exported",
    # hashes of files that hold these
    "sha256", "model_sha256", "attributes_sha256", "record_sha256",
}  # fmt: skip
"""Keys of records, and columns of tables, that differ from run to run."""


def contents(folder: Path) -> dict[str, str]:
    """Describe each file, link and folder inside a folder, by its path."""
    return {str(path.relative_to(folder)): _describe(path) for path in sorted(folder.rglob("*"))}


def _describe(path: Path) -> str:
    """Hash of a file without what varies; of all its bytes if it is not what its name says."""
    if path.is_symlink():
        return f"link to {path.readlink()}"
    if not path.is_file():
        return "folder" if path.is_dir() else "device"
    content = path.read_bytes()
    with suppress(Exception):  # damaged in any way
        if path.suffix == ".json":
            content = json.dumps(_constant(json.loads(content)), sort_keys=True).encode()
        elif path.suffix == ".csv":
            rows = csv.DictReader(io.StringIO(content.decode()))
            content = json.dumps([_constant(row) for row in rows]).encode()
        elif path.suffix == ".keras":  # beside the weights Keras writes memory addresses
            content = ZipFile(path).read("model.weights.h5")
    return hashlib.sha256(content).hexdigest()[:16]


def _constant(value):
    if isinstance(value, dict):
        return {key: _constant(inside) for key, inside in value.items() if key not in VARYING}
    return [_constant(inside) for inside in value] if isinstance(value, list) else value


def differences(found: dict[str, str], expected: dict[str, str]) -> str:
    """Say in a few words how two folders differ; nothing if they are equal."""
    both = found.keys() & expected.keys()
    named = {
        "left over": found.keys() - expected.keys(),
        "missing": expected.keys() - found.keys(),
        "another content": {name for name in both if found[name] != expected[name]},
    }
    return "; ".join(f"{what}: {', '.join(sorted(n)[:4])}" for what, n in named.items() if n)


def is_recorded(path: Path) -> bool:
    """Whether a record in a file's folder names it with its hash."""
    for record in path.parent.glob("*.json"):
        with suppress(ValueError, KeyError, TypeError):  # no record, or one that names no files
            if path.name in dict(json.loads(record.read_bytes())["files"]):
                return True
    return False
