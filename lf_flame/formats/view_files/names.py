"""Rows and columns of views, by the numbers in the names of their files."""

import re
from collections import defaultdict
from collections.abc import Sequence
from decimal import Decimal
from itertools import pairwise
from math import gcd, prod
from typing import NamedTuple

import numpy as np

from lf_flame._common.input_files import File, Source
from lf_flame.errors import InputError
from lf_flame.formats.view_files.orders import Grid, by_columns

NUMBER = re.compile(r"([-+]?)([0-9]+(?:\.[0-9]+)*)")
"""Pattern of an optional sign or hyphen, then digits that points may divide."""

Parts = tuple[str | Decimal, ...]
"""Text and numbers of a name in turn; text, perhaps empty, comes first and last."""

Column = tuple[Decimal, ...]
"""Number at one place of the name of each file."""

LARGEST_GRID = 10_000
"""Largest number of places in a grid of which more than half are missing."""


class Stated(NamedTuple):
    """Folder of the views, for messages, and arguments of `scan_view_folder` on their numbers."""

    source: Source
    grid: Grid | None = None
    order: str | None = None
    first: int | None = None


class Axis(NamedTuple):
    """Places 0, 1 ... of numbers along an axis.

    `step` is the distance between places, 0 for a single number; `error` its largest error by
    rounding in the names.
    """

    places: dict[Decimal, int]
    size: int
    step: Decimal
    error: Decimal

    def number(self, place: int) -> Decimal:
        """Give the number that a place has in the names."""
        one, at = next(iter(self.places.items()))
        return one + (place - at) * self.step


def number_grid(files: list[File], stated: Stated) -> tuple[np.ndarray, tuple[str, ...]]:
    """Arrange files, whose names differ only in numbers, by these.

    The last two numbers that vary and lie on a grid are places along its axes. Where one number
    varies it counts all views, unless a constant 0 or 1 of as many digits stands beside it: then
    they are a single row or column.

    Returns
    -------
    files : ndarray of Path, shape (first number, second number) or (running number,)
        None for a missing view.
    missing : tuple of str
        Numbers of the missing views.

    Raises
    ------
    InputError
        If the numbers make no grid of equal steps, or do not fit the stated one.
    """
    words = [re.findall(r"[0-9]+", file.stem) for file in files]
    digits = _columns([[Decimal(word) for word in one] for one in words])
    columns = _columns([part[1::2] for part in split_numbers([file.stem for file in files])])
    pairs = list(pairwise(_varying(columns)))[::-1]
    if columns == digits and not pairs:
        pairs = _lone_lines(columns, words)
    try:
        return _arranged(files, columns, pairs, stated)
    except InputError as fault:
        pair = _varying(digits)
        if len(_varying(columns)) == 1 and len(pair) == 2:
            try:  # 01.02.png is a row and a column, and no decimal number
                return _arranged(files, digits, [pair], stated)
            except InputError:
                raise fault from None
        raise


def _columns(numbers: Sequence[Sequence]) -> list[Column]:
    """Numbers that all names have, by their place in the name."""
    shared = min(map(len, numbers))
    return list(zip(*(one[:shared] for one in numbers), strict=True))


def _varying(columns: list[Column]) -> list[Column]:
    return [column for column in columns if len(set(column)) > 1]


def _lone_lines(columns: list[Column], words: list[list[str]]) -> list[tuple[Column, Column]]:
    """Pairs of neighbours of which one varies, and the other is a 0 or 1 of as many digits."""
    widths = [min(len(one[k]) for one in words) for k in range(len(columns))]
    return [
        (columns[k], columns[k + 1])
        for k in range(len(columns) - 1)
        for one, other in ((k, k + 1), (k + 1, k))
        if set(columns[one]) in ({0}, {1})
        and len(set(columns[other])) > 1
        and widths[one] == widths[other]
    ]


def _arranged(
    files: list[File], columns: list[Column], pairs: Sequence[Sequence[Column]], stated: Stated
) -> tuple[np.ndarray, tuple[str, ...]]:
    """Arrange files by the first pair of numbers with the smallest grid, or by a running number."""
    faults, found = [], []
    for pair in filter(_counts_two_axes, pairs):
        try:
            found.append((_two_axes(pair, stated), pair))
        except InputError as fault:
            faults.append(fault)
    if found:
        axes, pair = min(found, key=lambda one: prod(axis.size for axis in one[0]))
    elif faults:
        raise faults[0]
    else:
        axes, pair = _running_number(files, columns, stated)
    if prod(axis.size for axis in axes) > max(2 * len(files), LARGEST_GRID):
        sizes = " x ".join(str(axis.size) for axis in axes)
        raise InputError(f"{stated.source}: {len(files)} views cannot fill a grid of {sizes}.")
    grid = np.full([axis.size for axis in axes], None, object)
    for file, *numbers in zip(files, *pair, strict=True):
        grid[tuple(axis.places[one] for axis, one in zip(axes, numbers, strict=True))] = file
    gaps = [at for at in np.ndindex(grid.shape) if grid[at] is None]
    return grid, tuple(
        "_".join(str(a.number(n)) for a, n in zip(axes, at, strict=True)) for at in gaps
    )


def _counts_two_axes(pair: Sequence[Column]) -> bool:
    """Whether each view has a place of its own: two decimals, or some share a row or a column."""
    count = len(pair[0])
    decimals = all(any(number % 1 for number in column) for column in pair)
    shared = any(len(set(column)) < count for column in pair)
    return len(set(zip(*pair, strict=True))) == count and (shared or decimals)


def _running_number(
    files: list[File], columns: list[Column], stated: Stated
) -> tuple[list[Axis], list[Column]]:
    """Find the number that counts all views; gaps need a stated grid."""
    unique = [column for column in columns if len(set(column)) == len(files)]
    if not unique:
        raise InputError(
            f"The {len(files)} images like {files[0]} do not number a grid: each needs a unique "
            f"row and column, or a unique running number."
        )
    axis = _axis(unique[0], prod(stated.grid) if stated.grid else None, stated)
    if stated.grid is None and axis.size != len(files):
        raise InputError(
            f"Only {len(files)} views of {stated.source} are there, numbered from "
            f"{min(unique[0])} to {max(unique[0])} with gaps: state the grid that they do not "
            f"fill, --grid ROWSxCOLUMNS."
        )
    return [axis], unique[:1]


def _two_axes(pair: Sequence[Column], stated: Stated) -> list[Axis]:
    """Find the places of two numbers; refuse steps that differ, as slopes would have no unit."""
    sizes = stated.grid or (None, None)
    sizes = sizes[::-1] if stated.order and by_columns(stated.order) else sizes
    try:
        one, other = (_axis(*along, stated) for along in zip(pair, sizes, strict=True))
    except InputError:
        if stated.order or stated.grid is None:
            raise
        # The names may count columns before rows, as the parallax then has to show.
        one, other = (_axis(*along, stated) for along in zip(pair, sizes[::-1], strict=True))
    if one.step and other.step and abs(one.step - other.step) > one.error + other.error:
        raise InputError(
            f"The views of {stated.source} are {float(one.step):.4g} apart by the first number in "
            f"their names, and {float(other.step):.4g} by the second, but views need equal steps "
            f"along both axes; where these numbers only count, rename the files with 0, 1, 2 ..."
        )
    return [one, other]


def _axis(numbers: Column, size: int | None, stated: Stated) -> Axis:
    """Find the places of numbers along an axis: multiples of one step, some may be missing.

    Where they do not fill a stated size, whole numbers are places. They count from `first`, by
    default from 0, or from 1 if the last place is then there.
    """
    found = sorted(set(numbers))
    few = ", ".join(map(str, found[:4])) + (f" ... {found[-1]}" if len(found) > 4 else "")
    decimals = -min(0, *(int(number.as_tuple().exponent) for number in found))
    error = Decimal(1).scaleb(-decimals) if decimals else Decimal(0)
    axis = Axis({found[0]: 0}, 1, Decimal(0), error)
    if len(found) > 1:
        steps = [after - before for before, after in pairwise(found)]
        span = found[-1] - found[0]
        last = round(span / (min(steps) if decimals else gcd(*map(int, steps))))
        step = span / last  # less rounded than a single one
        places = {number: round((number - found[0]) / step) for number in found}
        away = max(abs(number - found[0] - place * step) for number, place in places.items())
        if away > error or len(set(places.values())) < len(found):
            raise InputError(
                f"The views of {stated.source} are at places off a regular grid, {few} by the "
                f"numbers in their names; only multiples of one step can be used."
            )
        axis = Axis(places, last + 1, step, error / last)
    if size is None or (size == axis.size and stated.first is None):
        return axis
    start = int(found[-1] == size) if stated.first is None else stated.first
    if decimals or not start <= found[0] <= found[-1] < start + size:
        raise InputError(
            f"The numbers in the names of {stated.source}, {few}, do not count {size} places from "
            f"{start}: state another --grid, or the number of the first place (`lf-flame convert "
            f"--first`)."
        )
    return Axis({number: int(number) - start for number in found}, size, Decimal(1), error)


def split_numbers(names: Sequence[str]) -> list[Parts]:
    """Split names into text and numbers, so that they sort in natural order.

    Names that differ only in their numbers are read together, because this shows what hyphens and
    points mean. A hyphen is a minus sign if it follows neither a letter nor a digit (``pos_-40``,
    unlike ``view-40`` and ``2024-01-05``), if other names have no hyphen at the same place (``y-4,
    y0, y4``), or if a name has a plus sign (``y-5x+2``). A point is a decimal point if it is the
    only one of a number, and if all numbers have the same count of decimals or none ends in 0
    (``5.48``, unlike ``1.9, 1.10``).

    Returns
    -------
    list of tuple
        Parts of each name: ``("pos_", Decimal(-40), "_", Decimal("0.5"), "")``. Sorted by these,
        ``frame2`` comes before ``frame10``; ``parts[1::2]`` are the exact numbers.
    """
    pieces = [NUMBER.split(name) for name in names]
    alike: dict[tuple[str, ...], list[list[str]]] = defaultdict(list)
    for one in pieces:
        alike[tuple(one[::3])].append(one)
    marks = {kind: _meanings(some) for kind, some in alike.items()}
    return [_parts(one, marks[tuple(one[::3])]) for one in pieces]


def _meanings(pieces: list[list[str]]) -> list[tuple[bool, bool]]:
    """For each number: whether hyphens before it separate, and whether points are decimal ones."""
    signed = any("+" in one[1::3] for one in pieces)
    found = []
    for k in range(1, len(pieces[0]), 3):
        before, words = pieces[0][k - 1], [one[k + 1] for one in pieces]
        joined = before[-1:].isalnum() or (k > 1 and not before)
        separates = joined and not signed and {one[k] for one in pieces} == {"-"}
        decimals = [word.partition(".")[2] for word in words]
        single = not any("." in one for one in decimals)
        alike = len({len(one) for one in decimals if one}) <= 1
        found.append((separates, single and (alike or not any(w.endswith("0") for w in decimals))))
    return found


def _parts(piece: list[str], meanings: list[tuple[bool, bool]]) -> Parts:
    parts: list[str | Decimal] = [piece[0]]
    for k, (separates, decimal) in zip(range(1, len(piece), 3), meanings, strict=True):
        mark, word, after = piece[k : k + 3]
        numbers = [word] if decimal else word.split(".")
        parts[-1] = f"{parts[-1]}{mark if separates else ''}"
        parts.append(Decimal(numbers[0] if separates else mark + numbers[0]))
        for number in numbers[1:]:
            parts += [".", Decimal(number)]
        parts.append(after)
    return tuple(parts)
