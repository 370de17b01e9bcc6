"""Rows and columns of views, by the numbers in the names of their files."""

import re
from collections.abc import Sequence
from decimal import Decimal
from itertools import pairwise
from math import gcd, prod
from pathlib import Path

import numpy as np

from lf_flame.errors import InputError
from lf_flame.formats.view_files.orders import Grid

NUMBER = r"(?:(?<![0-9.])[0-9]{1,99}\.[0-9]{1,99}(?!\.?[0-9])|[0-9]{1,99})"
"""Pattern of a decimal number, beside which there is no other point, or of a whole one; a float."""

SIGNS = r"(?:(?<![^\W_])[-+])?", "[-+]?"
"""Patterns of an optional sign, that after neither a letter nor a digit, and of any."""

Column = tuple[Decimal, ...]
"""Number at one place of the name of each file."""

Axis = tuple[list[int], int, float, float]
"""Place of each number along an axis, count of places, step between them, and its error."""


def number_grid(
    files: list[Path], source: Path, grid: Grid | None = None, first: int | None = None
) -> np.ndarray:
    """Arrange files, whose names differ only in numbers, by these; None for a missing view.

    The last two numbers that vary and lie on a grid are places along its axes: (first number,
    second number). Where only one varies it counts all views, (running number,), unless it is one
    of the last two of as many digits, and the other always 0 or 1: a single row or column. A stated
    `grid` is that of the numbers: (first, second), and `first` the number of the first place.
    """
    columns = _columns([file.stem for file in files])
    found: list[list[Axis]] = []
    faults: list[InputError] = []
    for pair in pairwise(columns):
        alone = len(set(zip(*pair, strict=True))) == len(files)
        if alone and min(len(set(column)) for column in pair) < len(files):
            try:  # each view has a place; some share a row or a column
                found.insert(0, _two_axes(pair, grid or (None, None), first, source))
            except InputError as fault:  # positions beside the numbers of rows and columns
                faults.append(fault)
    if faults and not found:
        raise faults[-1]
    found = found or [[_running_number(columns, grid, first, source, len(files))]]
    axes = min(found, key=lambda axes: prod(size for _, size, *_ in axes))
    sizes = [size for _, size, *_ in axes]
    if prod(sizes) > max(2 * len(files), 10_000):
        raise InputError(
            f"{source}: {len(files)} views cannot fill a grid of {' x '.join(map(str, sizes))}."
        )
    views = np.full(sizes, None, object)
    views[tuple(places for places, *_ in axes)] = files
    return views


def _columns(names: list[str]) -> list[Column]:
    """Columns of numbers that vary, or the last two of all if they may be a row and a column."""
    numbers = (one[1::2] for one in split_numbers(names))
    columns: list[Column] = list(zip(*numbers, strict=True))
    varying = [column for column in columns if len(set(column)) > 1]
    if len(varying) != 1 or len(columns) < 2 or varying[0] not in (last := columns[-2:]):
        return varying
    digits = [re.findall(r"[0-9]+", name)[-2:] for name in names]
    alike = len({min(map(len, column)) for column in zip(*digits, strict=False)}) == 1
    whole = all(number % 1 == 0 for number in varying[0])
    constant = any(set(column) in ({0}, {1}) for column in last)
    return last if alike and whole and constant else varying


def _running_number(
    columns: list[Column], grid: Grid | None, first: int | None, source: Path, count: int
) -> Axis:
    """Find the number that counts all views; gaps need a stated grid."""
    numbers = next((column for column in columns if len(set(column)) == count), None)
    if numbers is None:
        raise InputError(
            f"The {count} images of {source} do not number a grid: each needs a unique row and "
            f"column, or a unique running number."
        )
    axis = _axis(numbers, prod(grid) if grid else None, first, source)
    if grid is None and axis[1] != count:
        raise InputError(
            f"Only {count} views of {source} are there, numbered from {min(numbers)} to "
            f"{max(numbers)} with gaps: state the grid that they do not fill, --grid ROWSxCOLUMNS."
        )
    return axis


def _two_axes(pair, grid: Sequence[int | None], first: int | None, source: Path) -> list[Axis]:
    """Find the places of two numbers; refuse steps that differ, as slopes would have no unit."""
    axes = [_axis(numbers, n, first, source) for numbers, n in zip(pair, grid, strict=True)]
    (*_, step, error), (*_, other, other_error) = axes
    if step and other and abs(step - other) > error + other_error:
        raise InputError(
            f"The views of {source} are {step:.4g} apart by the first number in their names, and "
            f"{other:.4g} by the second, but views need equal steps along both axes; where these "
            f"numbers only count, rename the files with 0, 1, 2 ..."
        )
    return axes


def _axis(numbers: Column, size: int | None, first: int | None, source: Path) -> Axis:
    """Find the places of numbers along an axis: multiples of one step, some may be missing.

    Where they do not fill a stated size, whole numbers are places. They count from `first`, by
    default from 0, or from 1 if the last place is then there.
    """
    found = sorted(set(numbers))
    few = ", ".join(map(str, found[:4])) + (f" ... {found[-1]}" if len(found) > 4 else "")
    unit = 10.0 ** min(int(number.as_tuple().exponent) for number in found)
    rounding = unit if unit < 1 else 0.0
    away = np.array([float(number - found[0]) for number in found])
    places, last, step = np.zeros(1, int), 0, 0.0
    if len(found) > 1:
        least = np.diff(away).min() if rounding else gcd(*(int(one) for one in np.diff(away)))
        last = round(away[-1] / least)
        step = float(away[-1] / last)  # less rounded than a single one
        places = np.rint(away / step).astype(int)
        if abs(away - places * step).max() > rounding or len(set(places)) < len(found):
            raise InputError(
                f"The views of {source} are at places off a regular grid, {few} by the numbers in "
                f"their names; only multiples of one step can be used."
            )
    if size is None or (size == last + 1 and first is None):
        placed = dict(zip(found, places.tolist(), strict=True))
        return [placed[number] for number in numbers], last + 1, step, rounding / max(last, 1)
    start = int(found[-1] == size) if first is None else first
    if rounding or not start <= found[0] <= found[-1] < start + size:
        raise InputError(
            f"The numbers in the names of {source}, {few}, do not count {size} places from "
            f"{start}: state another --grid, the --order of the numbers, or the number of the "
            f"first place (`lf-flame convert --first`)."
        )
    return [int(number) - start for number in numbers], size, 1.0, 0.0


def split_numbers(names: Sequence[str]) -> list[tuple[str | Decimal, ...]]:
    """Split names into text and numbers in turn, so that they sort in natural order.

    A hyphen is a minus sign if it follows neither a letter nor a digit (``pos_-40``, unlike
    ``view-40`` and ``2024-01-05``), or if only some names have it there (``y-4, y0, y4``). A point
    is a decimal point if it is the only one of a number, and if all numbers have the same count of
    decimals or none ends in 0 (``5.48``, unlike ``1.9, 1.10``).

    Returns
    -------
    list of tuple
        Parts of each name: ``("pos_", Decimal(-40), "_", Decimal("0.5"), "")``. Sorted by these,
        ``frame2`` comes before ``frame10``; ``parts[1::2]`` are the exact numbers.
    """
    pieces = min(
        ([re.split(f"({sign}{NUMBER})", name) for name in names] for sign in SIGNS),
        key=lambda some: len({tuple(one[::2]) for one in some}),  # texts between the numbers
    )
    for k in reversed(range(1, max(map(len, pieces), default=0), 2)):
        ends = [one[k].partition(".")[2] for one in pieces if k < len(one)]
        uneven = len({len(end) for end in ends if end}) > 1
        if uneven and any(end.endswith("0") for end in ends):
            for one in pieces:
                one[k : k + 1] = [
                    part for word in one[k : k + 1] for part in re.split(r"(\.)", word)
                ]
    return [tuple(Decimal(part) if k % 2 else part for k, part in enumerate(one)) for one in pieces]
