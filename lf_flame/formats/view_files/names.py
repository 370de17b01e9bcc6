"""Finding the views of a light field among the files of a folder, by their numbers."""

import re
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from decimal import Decimal
from itertools import pairwise
from math import gcd, isqrt, prod
from pathlib import Path, PurePath
from typing import TypeVar

import numpy as np

from lf_flame._common.input_files import File, Source
from lf_flame.errors import InputError
from lf_flame.formats.images import IMAGE_SUFFIXES

NUMBER = re.compile(r"([-+]?)([0-9]+(?:\.[0-9]+)*)")
"""Pattern of an optional sign or hyphen, then digits that points may divide."""

Parts = tuple[str | Decimal, ...]
"""Text and numbers of a name in turn; text, perhaps empty, comes first and last."""

Name = TypeVar("Name", bound=PurePath)

MOST_NAMED = 3
"""Largest number of missing views that an error names."""

MOST_MISSING = 1 / 3
"""Largest fraction of a grid that may be missing where its size is not stated: the corners of a
round aperture are."""

LARGEST_GRID = 10_000
"""Largest number of places in a grid of which more than half are missing."""


def largest_set(names: list[Name], source: Path) -> list[Name]:
    """Largest set of images with names that differ only in numbers, of one folder.

    Parameters
    ----------
    names : list of Path or PurePath
    source : Path
        Folder or archive that holds them, for messages.

    Raises
    ------
    InputError
        If there are no two such images, or another set half as large or more.
    """
    sets = defaultdict(list)
    for path in names:
        if path.suffix.lower() in IMAGE_SUFFIXES and not path.name.startswith("."):
            like = re.sub(r"[-+]?\d+(\.\d+)?", "#", path.stem) + path.suffix.lower()
            if "#" in like:
                sets[str(path.parent / like)].append(path)
    by_size = sorted(sets.items(), key=lambda item: len(item[1]), reverse=True)
    if not by_size or len(by_size[0][1]) < 2:
        raise InputError(
            f"{source} holds no two images ({', '.join(IMAGE_SUFFIXES)}) whose names differ in "
            f"numbers only."
        )
    if len(by_size) > 1 and 2 * len(by_size[1][1]) >= len(by_size[0][1]):
        found = " and ".join(f"{len(files)} of {like}" for like, files in by_size[:2])
        raise InputError(
            f"{source} holds more than one set of images, {found}: leave only the views there."
        )
    return by_size[0][1]


def number_grid(
    files: list[File], shape: tuple[int, int] | None = None
) -> tuple[np.ndarray, tuple[str, ...]]:
    """Arrange files by the numbers in their names.

    The first two neighbouring numbers that make a full grid count rows and columns. They may start
    anywhere and rise by any step; a constant number counts only if it is 0 or 1 and has as many
    digits as its partner. Signs and decimals are read, as in positions, unless the digits alone
    make a fuller grid (``01.02``). Otherwise one running number counts all views.

    Parameters
    ----------
    files : list of Path or PackedFile
        Files with names that differ only in numbers.
    shape : (int, int), optional
        Stated number of rows and columns, which the names may count as columns and rows; a running
        number need not show them.

    Returns
    -------
    grid : ndarray of Path, shape (first number, second number) or (running number,)
        None for a missing view.
    missing : tuple of str
        Numbers of the missing views.

    Raises
    ------
    InputError
        If the numbers make no grid, or not the stated one; or if none is stated, and more than
        `MOST_MISSING` of the views are missing, or one with a running number is.
    """
    readings = [numbers_of(split_numbers([path.stem for path in files])), digits_of(files)]
    readings = readings[readings[0] == readings[1] :]  # one if there is no sign or decimal
    pairs = [pair for numbers in readings if (pair := fullest_pair(numbers, shape))]
    if pairs:
        rows_columns, _ = min(pairs, key=lambda pair: pair[1])
        grid, missing = grid_of(files, rows_columns, files[0])
        if shape not in (None, grid.shape, grid.shape[::-1]):
            raise InputError(
                f"The names of the images like {files[0]} number {grid.shape[0]} x "
                f"{grid.shape[1]} views, not the {shape[0]} x {shape[1]} of the grid stated."
            )
        if shape is None and len(missing) > MOST_MISSING * grid.size:
            _refuse_missing(missing, files, grid.shape)
        return grid, missing
    for numbers in readings:
        for column in zip(*numbers, strict=True):
            if len(set(column)) == len(files):
                return _in_a_row(files, column, shape)
    raise InputError(
        f"The {len(files)} images like {files[0]} do not number a grid: each needs a unique "
        f"row and column, or a unique running number."
    )


@dataclass(frozen=True, order=True)
class Count:
    """A number in a name, with its digits as written."""

    value: Decimal
    text: str = field(compare=False)


Columns = list[tuple[Count, ...]]
"""Numbers in the name of each file."""


def numbers_of(parts: list[Parts]) -> Columns:
    """Numbers that all names have, with signs and decimals."""
    shared = min(len(part) // 2 for part in parts)
    values = [[x for x in part if isinstance(x, Decimal)] for part in parts]
    return [tuple(Count(x, f"{x}") for x in one[:shared]) for one in values]


def digits_of(files: list[File]) -> Columns:
    """Find the runs of digits that all names have."""
    words = [re.findall(r"[0-9]+", path.stem) for path in files]
    shared = min(map(len, words))
    return [tuple(Count(Decimal(word), word) for word in one[:shared]) for one in words]


def fullest_pair(
    numbers: Columns, shape: tuple[int, int] | None
) -> tuple[list[tuple[Count, Count]], int] | None:
    """First pair of neighbouring numbers that makes the fullest grid, and the size of the grid."""
    found = []
    for k in range(len(numbers[0]) - 1):
        pair = [(one[k], one[k + 1]) for one in numbers]
        rows, columns = ({count.value for count in axis} for axis in zip(*pair, strict=True))
        widths = [min(len(count.text) for count in axis) for axis in zip(*pair, strict=True)]
        constant = next((values for values in (rows, columns) if len(values) == 1), None)
        one_row = constant is None or (constant <= {0, 1} and widths[0] == widths[1])
        # A grid that is less than half full is not one with gaps, unless it is stated: its numbers
        # mean something else.
        places = len(rows) * len(columns)
        full_enough = places <= 2 * len(numbers) or shape in (
            (len(rows), len(columns)),
            (len(columns), len(rows)),
        )
        if one_row and full_enough and len(set(pair)) == len(numbers):
            found.append((pair, places))
    return min(found, key=lambda one: one[1], default=None)


def grid_of(
    files: list[File], numbers: list[tuple[Count, Count]], source: Source
) -> tuple[np.ndarray, tuple[str, ...]]:
    """Place files in a grid by their rows and columns.

    Returns
    -------
    files : ndarray of Path, shape (rows, columns)
        None for a missing view.
    missing : tuple of str
        Numbers of the missing views, as their names would hold them.

    Raises
    ------
    InputError
        If the grid would have more than `LARGEST_GRID` places, of which most are missing.
    """
    rows, columns = (evenly(axis) for axis in zip(*numbers, strict=True))
    if len(rows) * len(columns) > max(2 * len(files), LARGEST_GRID):
        raise InputError(
            f"{source}: {len(files)} views cannot fill a grid of {len(rows)} x {len(columns)}."
        )
    placed = dict(zip(numbers, files, strict=True))
    wanted = [(row, column) for row in rows for column in columns]
    missing = [f"{row.text}_{column.text}" for row, column in wanted if (row, column) not in placed]
    grid = _as_array([placed.get(pair) for pair in wanted]).reshape(len(rows), len(columns))
    return grid, tuple(missing)


def _in_a_row(
    files: list[File], column: tuple[Count, ...], shape: tuple[int, int] | None
) -> tuple[np.ndarray, tuple[str, ...]]:
    """Place files by a running number; gaps are kept only where they fill the stated grid."""
    placed, run = dict(zip(column, files, strict=True)), evenly(column)
    gaps = [count.text for count in run if count not in placed]
    if shape is None and isqrt(len(files)) ** 2 != len(files):
        _refuse_missing(gaps, files, None)
    if shape is None or len(run) != prod(shape):
        gaps, run = [], sorted(column)
    return _as_array([placed.get(count) for count in run]), tuple(gaps)


def evenly(numbers: tuple[Count, ...]) -> list[Count]:
    """Numbers from the lowest to the highest, in steps of their greatest common divisor."""
    found = sorted(set(numbers))
    finest = min(int(count.value.as_tuple().exponent) for count in found)
    ticks = [int(count.value.scaleb(-finest)) for count in found]
    step = gcd(*(after - before for before, after in pairwise(ticks))) or 1
    steps = range(ticks[0], ticks[-1] + 1, step)
    if len(steps) > 2 * len(found):
        # Wide gaps are not missing views; these numbers are positions or times.
        return found
    width, known = min(len(count.text) for count in found), dict(zip(ticks, found, strict=True))
    return [known.get(k) or _between(Decimal(k).scaleb(finest), width) for k in steps]


def _between(value: Decimal, width: int) -> Count:
    """Write a number that no name has like the others."""
    return Count(value, f"{value:f}".zfill(width))


def name_some(missing: Sequence[str]) -> str:
    """Name the first missing views, and count the others."""
    more = f" and {len(missing) - MOST_NAMED} more" if len(missing) > MOST_NAMED else ""
    return ", ".join(missing[:MOST_NAMED]) + more


def _refuse_missing(
    missing: Sequence[str], files: list[File], shape: tuple[int, ...] | None
) -> None:
    if missing:
        what = f"{len(files)} views" if shape is None else f"{shape[0]} x {shape[1]} views"
        grid = "ROWSxCOLUMNS" if shape is None else f"{shape[0]}x{shape[1]}"
        are = "view {} is" if len(missing) == 1 else "views {} are"
        raise InputError(
            f"Of {what} like {files[0]}, {are.format(name_some(missing))} missing; --grid {grid} "
            f"reads the others, and gives weight 0 to what is missing."
        )


def _as_array(files: Sequence[File | None]) -> np.ndarray:
    array = np.empty(len(files), object)
    array[:] = files
    return array


def split_numbers(names: Sequence[str]) -> list[Parts]:
    """Split names into text and numbers, so that they sort in natural order.

    Names that differ only in their numbers are read together, because this shows what hyphens and
    points mean. A hyphen is a minus sign if it follows neither a letter nor a digit (``pos_-40``,
    unlike ``view-40`` and ``2024-01-05``), if other names have no hyphen at the same place (``y-4,
    y0, y4``), or if a name has a plus sign (``y-5x+2``). A point is a decimal point if it is the
    only one of a number, and if all numbers have the same count of decimals or none ends in 0
    (``5.48``, unlike ``1.9, 1.10``).

    Parameters
    ----------
    names : sequence of str
        Names without their endings.

    Returns
    -------
    list of tuple
        Parts of each name: ``("pos_", Decimal(-40), "_", Decimal("0.5"), "")``. Sorted by these,
        ``frame2`` comes before ``frame10``; ``parts[1::2]`` are the exact numbers.
    """
    alike: dict[tuple[str, ...], list[int]] = defaultdict(list)
    pieces = [NUMBER.split(name) for name in names]
    for k, one in enumerate(pieces):
        alike[tuple(one[::3])].append(k)
    found: dict[int, Parts] = {}
    for places in alike.values():
        found.update(zip(places, _split_alike([pieces[k] for k in places]), strict=True))
    return [found[k] for k in range(len(names))]


def _split_alike(pieces: list[list[str]]) -> list[Parts]:
    """Split names that have the same text between the numbers."""
    parts: list[list[str | Decimal]] = [[one[0]] for one in pieces]
    signed = any("+" in one[1::3] for one in pieces)
    for k in range(1, len(pieces[0]), 3):
        before = pieces[0][k - 1]
        marks, words = [one[k] for one in pieces], [one[k + 1] for one in pieces]
        joined = before[-1:].isalnum() or (k > 1 and not before)
        separates = joined and not signed and set(marks) == {"-"}
        decimal = _is_decimal(words)
        for part, mark, word, one in zip(parts, marks, words, pieces, strict=True):
            if separates:
                part[-1] = f"{part[-1]}{mark}"
            numbers = [word] if decimal else word.split(".")
            numbers[0] = numbers[0] if separates else mark + numbers[0]
            for number in numbers:
                part += [Decimal(number), "."]
            part[-1] = one[k + 2]
    return [tuple(part) for part in parts]


def _is_decimal(words: Sequence[str]) -> bool:
    """Whether the points in strings of digits are decimal points."""
    if any(word.count(".") > 1 for word in words):
        return False
    decimals = [word.partition(".")[2] for word in words]
    alike = len({len(word) for word in decimals if word}) <= 1
    return alike or not any(word.endswith("0") for word in decimals)
