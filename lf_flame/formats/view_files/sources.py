"""Files of the views of a light field: in a folder, in a ZIP archive, or named by a list."""

import csv
import re
from decimal import Decimal
from pathlib import Path

from lf_flame._common.input_files import File, list_zip, read_text, read_zip
from lf_flame._common.zarr_files import is_zarr
from lf_flame.errors import InputError
from lf_flame.formats.images import IMAGE_SUFFIXES
from lf_flame.formats.view_files.names import Count, largest_set

ARCHIVE, LIST, ZARR = ".zip", ".csv", ".zarr"
"""File endings of an archive of views, of a list of views, and of a folder that is an array."""

LARGEST_LIST = 1 << 20
"""Largest size of a list, in bytes."""

POSITION = re.compile(r"[-+]?[0-9]{1,9}(\.[0-9]{1,9})?")
"""Row or column in a list."""


def is_view_folder(path: str | Path) -> bool:
    """Whether a path is read as one file for each view: a folder, an archive, or a list."""
    if Path(path).suffix.lower() == ZARR and is_zarr(path):
        return False
    return Path(path).is_dir() or Path(path).suffix.lower() in (ARCHIVE, LIST)


def find_files(path: Path) -> tuple[list[File], int]:
    """Find the files of the views in a folder or an archive.

    Returns
    -------
    files : list of Path or PackedFile
        Largest set of images with names that differ only in numbers.
    left_out : int
        Number of other files.

    Raises
    ------
    InputError
        If the folder or archive cannot be read, or holds no such set, or another one half as large.
    """
    if path.is_dir():
        entries = sorted(path.iterdir())
        files: list[File] = list(largest_set(entries, path))
        return files, len(entries) - len(files)
    if path.suffix.lower() != ARCHIVE:
        raise InputError(f"The views cannot be read: {path} is no folder.")
    names = [name for name in list_zip(path) if "__MACOSX" not in name.parts]
    packed = read_zip(path, largest_set(sorted(names), path))
    return list(packed), len(names) - len(packed)


def first_image(path: Path) -> File | None:
    """First image of a folder, an archive or a list by its name; None if there is none."""
    if path.is_dir():
        return min(filter(_is_image, path.iterdir()), default=None)
    if path.suffix.lower() == ARCHIVE:
        names = [name for name in list_zip(path) if "__MACOSX" not in name.parts]
        first = min(filter(_is_image, names), default=None)
        return None if first is None else read_zip(path, [first])[0]
    return min(read_list(path).values(), key=lambda file: file.name)


def _is_image(path) -> bool:
    return path.suffix.lower() in IMAGE_SUFFIXES and not path.name.startswith(".")


def read_list(path: Path) -> dict[tuple[Count, Count], File]:
    """Read a list of views: in each line the name of a file, its row and its column.

    Names are looked up among the images of the list's own folder; no path is made of them. A first
    line without numbers is a heading; lines that begin with # are left out.

    Returns
    -------
    dict of (Count, Count) to Path
        Views by their row and column.

    Raises
    ------
    InputError
        If the list cannot be read, or a line does not name one image and its place.
    """
    try:
        text = read_text(path, LARGEST_LIST).lstrip("\ufeff")
        lines = list(csv.reader(text.splitlines(), skipinitialspace=True))
    except csv.Error as error:
        raise InputError(f"{path} cannot be read as a list of views: {error}.") from None
    there = {file.name: file for file in path.parent.iterdir() if _is_image(file)}
    placed: dict[tuple[Count, Count], File] = {}
    for number, line in enumerate(lines, 1):
        words = [word.strip() for word in line]
        heading = number == 1 and len(words) == 3 and not any(map(POSITION.fullmatch, words[1:]))
        if not any(words) or words[0].startswith("#") or heading:
            continue
        if len(words) != 3 or not all(map(POSITION.fullmatch, words[1:])):
            raise InputError(
                f"Line {number} of {path} must be the name of an image, its row and its column, "
                f"such as view_7.png,0,3, got {','.join(line)[:80]!r}."
            )
        name, row, column = words[0], *(Count(Decimal(word), word) for word in words[1:])
        if name not in there:
            raise InputError(
                f"Line {number} of {path} names {name[:80]!r}, which is no image in the list's own "
                f"folder."
            )
        if (row, column) in placed or there[name] in placed.values():
            raise InputError(
                f"Line {number} of {path} names a view or a place for the second time: "
                f"{','.join(line)[:80]!r}."
            )
        placed[row, column] = there[name]
    if len(placed) < 2:
        raise InputError(f"{path} must list at least two views, got {len(placed)}.")
    return placed
