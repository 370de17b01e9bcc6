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


class Axis(NamedTuple):
    """Places 0, 1 ... of numbers along an axis.

    `step` is the distance between places, None for a single number; `error` its largest error by
    rounding in the names.
    """

    places: dict[Decimal, int]
    size: int
    step: Decimal | None
    error: Decimal

    def number(self, place: int) -> Decimal:
        """Give the number that a place has in the names."""
        one, at = next(iter(self.places.items()))
        return one + (place - at) * (self.step or 1)


def number_grid(
    files: list[File],
    source: Source,
    grid: Grid | None = None,
    order: str | None = None,
    first: int | None = None,
) -> tuple[np.ndarray, tuple[str, ...]]:
    """Arrange files, whose names differ only in numbers, by these.

    The last two numbers that vary and lie on a grid are places along its axes. Where one number
    varies it counts all views, unless a constant 0 or 1 of as many digits stands beside it: then
    they are a single row or column. Other arguments are those of
    `lf_flame.formats.scan_view_folder`.

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
    columns = _columns([part[1::2] for part in split_numbers([file.stem for file in files])])
    digits = _columns([[Decimal(word) for word in one] for one in words])
    pairs = [(columns[a], columns[b]) for a, b in pairwise(_varying(columns))][::-1]
    if columns == digits and not pairs:
        pairs = _lone_lines(columns, words)
    try:
        return _arranged(files, columns, pairs, source, grid, order, first)
    except InputError as fault:
        if len(_varying(columns)) != 1 or len(_varying(digits)) != 2:
            raise
        one, other = _varying(digits)  # 01.02.png is a row and a column, and no decimal number
        pairs = [(digits[one], digits[other])]
        try:
            return _arranged(files, digits, pairs, source, grid, order, first)
        except InputError:
            raise fault from None


def _arranged(
    files: list[File],
    columns: list[Column],
    pairs: list[tuple[Column, Column]],
    source: Source,
    grid: Grid | None,
    order: str | None,
    first: int | None,
) -> tuple[np.ndarray, tuple[str, ...]]:
    """Arrange files by the first pair of numbers with the smallest grid, or by a running number."""
    faults, found = [], []
    for pair in filter(_counts_two_axes, pairs):
        try:
            found.append((_two_axes(pair, source, grid, order, first), pair))
        except InputError as fault:
            faults.append(fault)
    if faults and not found:
        raise faults[0]
    if not found:
        column = _running_number(columns, files)
        axis = _axis(column, source, prod(grid) if grid else None, first)
        if grid is None and axis.size != len(files):
            raise InputError(
                f"Only {len(files)} views of {source} are there, numbered from {min(column)} to "
                f"{max(column)} with gaps: state the grid that they do not fill, --grid "
                f"ROWSxCOLUMNS."
            )
        return _placed(files, [axis], (column,))
    axes, pair = min(found, key=lambda one: prod(axis.size for axis in one[0]))
    rows, across = (axis.size for axis in axes)
    if rows * across > max(2 * len(files), LARGEST_GRID):
        raise InputError(f"{source}: {len(files)} views cannot fill a grid of {rows} x {across}.")
    return _placed(files, axes, pair)


def _columns(numbers: Sequence[Sequence]) -> list[Column]:
    """Numbers that all names have, by their place in the name."""
    shared = min(map(len, numbers))
    return list(zip(*(one[:shared] for one in numbers), strict=True))


def _varying(columns: list[Column]) -> list[int]:
    return [k for k, column in enumerate(columns) if len(set(column)) > 1]


def _lone_lines(columns: list[Column], words: list[list[str]]) -> list[tuple[Column, Column]]:
    """Pairs of neighbours of which one varies, and the other is a 0 or 1 of as many digits."""
    return [
        (columns[k], columns[k + 1])
        for k in range(len(columns) - 1)
        for constant, other in ((k, k + 1), (k + 1, k))
        if set(columns[constant]) <= {0, 1}
        and len(set(columns[constant])) == 1 < len(set(columns[other]))
        and len(words[0][constant]) == min(len(one[other]) for one in words)
    ]


def _counts_two_axes(pair: tuple[Column, Column]) -> bool:
    """Whether each view has a place of its own: two decimals, or some share a row or a column."""
    count = len(pair[0])
    decimals = [any(number % 1 for number in column) for column in pair]
    shared = any(len(set(column)) < count for column in pair)
    return len(set(zip(*pair, strict=True))) == count and (shared or all(decimals))


def _running_number(columns: list[Column], files: list[File]) -> Column:
    for column in columns:
        if len(set(column)) == len(files):
            return column
    raise InputError(
        f"The {len(files)} images like {files[0]} do not number a grid: each needs a unique row "
        f"and column, or a unique running number."
    )


def _two_axes(
    pair: tuple[Column, Column],
    source: Source,
    grid: Grid | None,
    order: str | None,
    first: int | None,
) -> list[Axis]:
    """Find the places of two numbers; refuse steps that differ, as slopes would have no unit."""
    sizes = grid or (None, None)
    sizes = sizes[::-1] if order and by_columns(order) else sizes
    try:
        axes = [_axis(*one, first) for one in zip(pair, [source] * 2, sizes, strict=True)]
    except InputError:
        if order or grid is None:
            raise
        # The names may count columns before rows, as the parallax then has to show.
        axes = [_axis(*one, first) for one in zip(pair, [source] * 2, sizes[::-1], strict=True)]
    one, other = axes
    if one.step and other.step and abs(one.step - other.step) > one.error + other.error:
        raise InputError(
            f"The views of {source} are {float(one.step):.4g} apart by the first number in their "
            f"names, and {float(other.step):.4g} by the second, but views need equal steps along "
            f"both axes; where these numbers only count, rename the files with 0, 1, 2 ..."
        )
    return axes


def _axis(numbers: Column, source: Source, size: int | None, first: int | None) -> Axis:
    """Find the places of numbers along an axis: multiples of one step, some may be missing.

    Where they do not fill a stated size, whole numbers are places. They count from `first`, by
    default from 0, or from 1 if the last place is then there.
    """
    found = sorted(set(numbers))
    few = ", ".join(map(str, found[:4])) + (f" ... {found[-1]}" if len(found) > 4 else "")
    decimals = -min(0, *(int(number.as_tuple().exponent) for number in found))
    error = Decimal(1).scaleb(-decimals) if decimals else Decimal(0)
    axis = Axis({found[0]: 0}, 1, None, error)
    if len(found) > 1:
        steps = [after - before for before, after in pairwise(found)]
        span = found[-1] - found[0]
        last = round(span / (min(steps) if decimals else gcd(*map(int, steps))))
        step = span / last  # less rounded than a single one
        places = {number: round((number - found[0]) / step) for number in found}
        away = max(abs(number - found[0] - place * step) for number, place in places.items())
        if away > error or len(set(places.values())) < len(found):
            raise InputError(
                f"The views of {source} are at places off a regular grid, {few} by the numbers in "
                f"their names; only multiples of one step can be used."
            )
        axis = Axis(places, last + 1, step, error / last)
    if size is None or (size == axis.size and first is None):
        return axis
    start = int(found[-1] == size) if first is None else first
    if decimals or not start <= found[0] <= found[-1] < start + size:
        raise InputError(
            f"The numbers in the names of {source}, {few}, do not count {size} places from "
            f"{start}: state another --grid, or the number of the first place (`lf-flame "
            f"convert --first`)."
        )
    return Axis({number: int(number) - start for number in found}, size, Decimal(1), error)


def _placed(
    files: list[File], axes: list[Axis], columns: Sequence[Column]
) -> tuple[np.ndarray, tuple[str, ...]]:
    """Place files in a grid; name what is missing by its numbers."""
    grid = np.full([axis.size for axis in axes], None, object)
    for file, *numbers in zip(files, *columns, strict=True):
        grid[tuple(axis.places[one] for axis, one in zip(axes, numbers, strict=True))] = file
    missing = [at for at in np.ndindex(grid.shape) if grid[at] is None]
    named = ["_".join(str(a.number(n)) for a, n in zip(axes, at, strict=True)) for at in missing]
    return grid, tuple(named)


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
