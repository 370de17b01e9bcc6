"""Paths in records: from the record's folder, both with all links followed."""

import os
from pathlib import Path


def recorded_path(path: str | Path, folder: str | Path) -> str:
    """Give the path that a record in a folder holds for another file or folder.

    The system follows a link before it goes up by ``..``; a path that is counted from the link's
    own place leads elsewhere.
    """
    return os.path.relpath(os.path.realpath(path), os.path.realpath(folder))


def recorded_places(recorded: str, folder: str | Path) -> list[Path]:
    """List the places that a recorded path may mean, the likeliest first, links followed.

    Records of older versions counted from the folder as it was typed, links and all, or from the
    working folder.
    """
    beside = Path(folder) / recorded
    return [Path(os.path.realpath(way)) for way in (beside, os.path.normpath(beside), recorded)]
