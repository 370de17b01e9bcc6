"""One image file for each view of a light field, in a folder."""

import os
import re
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from decimal import Decimal
from fnmatch import fnmatch
from itertools import pairwise
from math import gcd, prod
from pathlib import Path

import numpy as np

from lf_flame._common import progress
from lf_flame._common.images import FLOAT, read_shape
from lf_flame._common.memory import check_memory
from lf_flame._common.printable import printable
from lf_flame.errors import InputError
from lf_flame.formats.images import IMAGE_SUFFIXES, read_image
from lf_flame.formats.view_files.orders import (
    Grid,
    ViewOrder,
    arranged,
    by_columns,
    check_grid,
    find_order,
    fold,
    order_memory,
    read_grid,
    stated_order,
)
from lf_flame.formats.zarr_arrays import is_zarr
from lf_flame.lightfield import LightField


@dataclass(frozen=True, eq=False)
class ViewFolder:
    """Files of a light field in the order of its views.

    Attributes
    ----------
    path : Path
    files : ndarray of Path, shape (v, u)
        Files of the views; None for a missing view.
    found : ViewOrder
        Order in which the file names count the views, and how it was found.
    left_out : int
        Number of other files in the folder.
    """

    path: Path
    files: np.ndarray
    found: ViewOrder
    left_out: int

    def describe(self) -> str:
        """Describe the views, their order and the missing ones in a few lines."""
        v, u = self.files.shape
        first, last = (
            "(missing)" if file is None else printable(file.name)
            for file in self.files[[0, -1], [0, -1]]
        )
        lines = [
            f"{printable(self.path)}: {v} x {u} views, top left {first}, bottom right {last}",
            *self.found.describe(),
        ]
        if gaps := [f"{v}_{u}" for v, u in np.argwhere(self.files == None)]:  # noqa: E711
            named = ", ".join(gaps[:3]) + (" ..." if len(gaps) > 3 else "")
            lines.append(f"missing views, with weight 0: {len(gaps)} ({named})")
        if self.left_out:
            lines.append(f"other files left out: {self.left_out}")
        return "\n".join(lines)

    def read(self) -> LightField:
        """Read the views.

        Returns
        -------
        LightField
            Values from 0 to 1; colour images give a last axis of 3 channels. Missing views are
            black, and have weight 0.

        Raises
        ------
        InputError
            If a file cannot be read, or differs from the first in size or channels.
        """
        there = np.array([file is not None for file in self.files.flat])
        places, paths = np.flatnonzero(there), list(self.files.flat[there])
        first = read_image(paths[0])
        views = np.zeros((self.files.size, *first.shape), np.float32)

        def place(k: int) -> None:
            image = read_image(paths[k])
            if image.shape != first.shape:
                raise InputError(
                    f"All views must be alike: {paths[k]} has shape {image.shape}, "
                    f"{paths[0].name} {first.shape}."
                )
            views[places[k]] = image

        with ThreadPoolExecutor(_readers(paths)) as pool:  # decoders release the interpreter's lock
            done = pool.map(place, range(len(paths)))
            for _ in progress.steps(done, "reading", len(paths), "view"):
                pass
        shape = self.files.shape
        weights = None if there.all() else there.reshape(shape)
        return LightField(views.reshape(shape + first.shape), weights=weights)


def _readers(files: list[Path]) -> int:
    """Count the files that are decoded at the same time."""
    return min(len(files), os.cpu_count() or 1)


def is_view_folder(path: str | Path) -> bool:
    """Whether a path is read as one file for each view: a folder, but none of Zarr."""
    return Path(path).is_dir() and not (Path(path).suffix.lower() == ".zarr" and is_zarr(path))


def first_image(path: Path) -> Path | None:
    """First image of a folder by its name; None if there is none."""
    return next(iter(_images(path)), None)


def _images(path: Path, names: str = "*") -> list[Path]:
    """List the images of a folder by name, without hidden files."""
    if not path.is_dir():
        raise InputError(f"The views cannot be read: {path} is no folder.")
    return [
        one
        for one in sorted(path.iterdir())
        if one.suffix.lower() in IMAGE_SUFFIXES and fnmatch(one.name, names) and one.name[0] != "."
    ]


def _find_files(path: Path, names: str) -> list[Path]:
    """Find the images whose names differ only in numbers."""
    images = _images(path, names)
    kinds: dict[str, list[Path]] = {}
    for one, parts in zip(images, split_numbers([one.stem for one in images]), strict=True):
        if len(parts) > 1:
            kinds.setdefault("#".join(map(str, parts[::2])) + one.suffix.lower(), []).append(one)
    if len(kinds) > 1:
        several = sorted(kinds, key=lambda kind: -len(kinds[kind]))[:3]
        raise InputError(
            f"{path} holds several sets of images, "
            f"{', '.join(f'{len(kinds[kind])} of {kind}' for kind in several)}: choose the views "
            f"by --names, such as --names '{several[0].replace('#', '*')}'."
        )
    found = next(iter(kinds.values()), [])
    if len(found) < 2:
        raise InputError(
            f"{path} holds no two images ({', '.join(IMAGE_SUFFIXES)}) whose names are like "
            f"{names} and differ in numbers only."
        )
    return found


def scan_view_folder(
    path: str | Path,
    order: str | None = None,
    *,
    grid: Grid | str | None = None,
    names: str | None = None,
    first: int | None = None,
) -> ViewFolder:
    """Find the files that are the views of a light field, and their order.

    The views are the images (png, jpg, tif, bmp, webp, ppm, pgm) with names that differ only in
    numbers. The last two numbers that vary are row and column: ``row_col.png``, ``view_R_C.jpg``,
    ``2067_RR_CC.png``, positions such as ``pos_-40_12.5.png``; in Stanford's
    ``out_RR_CC_y_x.png`` the last two that lie on a grid. A single number, as in HCI's
    ``input_Cam000.png``, counts row by row a square, or the `grid`. Rows and columns need one step;
    views may be missing.

    Parameters
    ----------
    path : str or Path
        Folder with the images.
    order : str, optional
        Meaning of the numbers, the slower one first, with a minus for an axis that runs the other
        way: ``row,col`` (row by row from the top left), ``col,row``, ``-row,col`` (rows from the
        bottom), ``row,-col``, and so on. Default: the order that the parallax between views shows
        (`lf_flame.formats.view_files.orders.find_order`), otherwise ``row,col``.
    grid : (int, int) or str, optional
        Number of rows and columns of the light field, such as (1, 9) or ``9x9``. Numbers that do
        not fill it are places in it, and places without a view get weight 0.
    names : str, optional
        Pattern of the views' names, such as ``input_Cam*.png``. Default: all images.
    first : int, optional
        Number of the first place of the grid. Default: 1 if the last place is then there,
        otherwise 0; for numbers that fill the grid, the lowest.

    Returns
    -------
    ViewFolder

    Raises
    ------
    InputError
        If the folder, its names or the order cannot be used, steps between views differ, or the
        views of a running number move as a single row does.

    Notes
    -----
    Nearer objects have the lower slopes, as in `lf_flame.refocus`, and parallel cameras give slopes
    below 0. A folder that gives higher slopes to nearer objects has both axes flipped, which no
    parallax shows: read it as ``-row,-col``.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame import LightField, formats
    >>> light_field = LightField(np.random.default_rng(1).uniform(size=(3, 3, 20, 30)))

    >>> formats.write_light_field(light_field, "views")
    >>> formats.scan_view_folder("views").files.shape
    (3, 3)
    """
    path, shape = Path(path), None if grid is None else read_grid(grid)
    order = None if order is None else stated_order(order).order
    files = _find_files(path, names or "*")
    turned = shape[::-1] if shape and order and by_columns(order) else shape
    numbered = number_grid(files, path, turned, first)
    image = read_shape(files[0])
    # As floats, with a byte for whether a value is finite; decoding takes two more at a time.
    reading = ((FLOAT + 1) * numbered.size + 2 * FLOAT * _readers(files)) * prod(image)
    check_memory(max(reading, order_memory(image) + 2 * FLOAT * prod(image)), path)
    if numbered.ndim == 1:
        numbered, found = fold(numbered, path, shape, order, read=read_image)
    else:
        found = find_order(numbered, read_image, stated=order)
    ordered = arranged(numbered, found.order)
    check_grid(shape, ordered.shape, path)
    return ViewFolder(path, ordered, found, len(list(path.iterdir())) - len(files))


# Numbers in names ---------------------------------------------------------------------------------

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
    return last if alike and any(set(column) in ({0}, {1}) for column in last) else varying


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
