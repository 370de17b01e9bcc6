"""Paths in records, relative to the record's folder, both with all links resolved."""

import os
from pathlib import Path


def recorded_path(path: str | Path, folder: str | Path) -> str:
    """Path of another file or folder, as a record in `folder` stores it.

    Links are resolved first: the system follows a link before it applies ``..``, so that a path
    relative to the link's own place would lead elsewhere.
    """
    return os.path.relpath(os.path.realpath(path), os.path.realpath(folder))


def recorded_places(recorded: str, folder: str | Path) -> list[Path]:
    """Places that a recorded path may mean, the likeliest first, with links resolved.

    Records of older versions are relative to the folder as it was typed, links included, or to
    the working folder.
    """
    beside = Path(folder) / recorded
    return [Path(os.path.realpath(way)) for way in (beside, os.path.normpath(beside), recorded)]
