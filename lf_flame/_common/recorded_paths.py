"""Paths in records, relative to the record's folder."""

import os
from pathlib import Path


def recorded_path(path: str | Path, folder: str | Path) -> str:
    """Path of another file or folder, as a record in `folder` stores it.

    Links are resolved first: the system follows a link before it applies ``..``, so that a path
    relative to the link's own place would lead elsewhere.
    """
    return os.path.relpath(os.path.realpath(path), os.path.realpath(folder))
