"""What folders hold, but for dates and durations: what must be the same in two runs."""

import csv
import hashlib
import io
import json
from pathlib import Path
from zipfile import ZipFile

VARYING = {
    "date", "command", "seconds", "wall_s", "train_s", "start_s", "ms", "versions", "machine",
    "git_revision", "provenance", "evaluation", "exported",
    # hashes of files that hold these
    "sha256", "model_sha256", "attributes_sha256", "record_sha256",
}  # fmt: skip
"""Keys of records, and columns of tables, that differ from run to run."""


def contents(folder: Path, names_only: bool = False) -> dict[str, str]:
    """Describe each file, link and folder inside a folder, by its path."""
    found = {}
    for path in sorted(folder.rglob("*")):
        name = str(path.relative_to(folder))
        if path.is_symlink():
            found[name] = f"link to {path.readlink()}"
        elif path.is_file():
            found[name] = "file" if names_only else describe(path)
        else:
            found[name] = "folder" if path.is_dir() else "device"
    return found


def describe(path: Path) -> str:
    """Hash a file without what varies; one that is not what its ending says, by its bytes."""
    content = path.read_bytes()
    try:
        if path.suffix == ".json":
            content = json.dumps(_constant(json.loads(content)), sort_keys=True).encode()
        elif path.suffix == ".csv":
            rows = csv.DictReader(io.StringIO(content.decode()))
            content = json.dumps([_constant(row) for row in rows]).encode()
        elif path.suffix == ".keras":  # beside the weights Keras writes memory addresses
            content = ZipFile(path).read("model.weights.h5")
    except Exception:  # damaged, in whatever way
        content = path.read_bytes()
    return hashlib.sha256(content).hexdigest()[:16]


def _constant(value):
    if isinstance(value, dict):
        return {key: _constant(inside) for key, inside in value.items() if key not in VARYING}
    return [_constant(inside) for inside in value] if isinstance(value, list) else value


def differences(found: dict[str, str], expected: dict[str, str]) -> str:
    """Say in a few words how two folders differ; nothing if they do not."""
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
        try:
            if path.name in dict(json.loads(record.read_bytes())["files"]):
                return True
        except (ValueError, KeyError, TypeError):  # no record, or one that names no files
            continue
    return False
