"""One image file for each view of a light field, in a folder."""

import os
import re
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from decimal import Decimal
from fnmatch import fnmatch
from fractions import Fraction
from itertools import pairwise
from math import gcd, prod
from pathlib import Path

import numpy as np

from lf_flame._common import progress
from lf_flame._common.images import FLOAT, read_shape
from lf_flame._common.input_files import check_memory, printable
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
    read_grid,
    stated_order,
)
from lf_flame.lightfield import LightField

READERS = os.cpu_count() or 1
"""Number of files that are decoded at the same time."""


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
    """

    path: Path
    files: np.ndarray
    found: ViewOrder

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
        there = self.files != None  # noqa: E711 - of each file
        paths = self.files[there].tolist()
        first = read_image(paths[0])
        views = np.zeros((*self.files.shape, *first.shape), np.float32)

        def place(path: Path, at: np.ndarray) -> None:
            image = read_image(path)
            if image.shape != first.shape:
                raise InputError(
                    f"All views must have one shape: {path} has shape {image.shape}, "
                    f"{paths[0].name} {first.shape}."
                )
            views[tuple(at)] = image

        with ThreadPoolExecutor(READERS) as pool:  # decoders release the interpreter's lock
            done = pool.map(place, paths, np.argwhere(there))
            for _ in progress.steps(done, "reading", len(paths), "view"):
                pass
        return LightField(views, weights=None if there.all() else there)


def _find_files(path: Path, names: str) -> list[Path]:
    """Find the images whose names differ only in numbers, but for hidden files."""
    if not path.is_dir():
        raise InputError(f"The views cannot be read: {path} is not a folder.")
    images = [
        one
        for one in sorted(path.iterdir())
        if one.suffix.lower() in IMAGE_SUFFIXES and fnmatch(one.name, names) and one.name[0] != "."
    ]
    kinds: dict[str, list[Path]] = {}
    for one, parts in zip(images, split_numbers([one.stem for one in images]), strict=True):
        if len(parts) > 1:
            kinds.setdefault("#".join(map(str, parts[::2])) + one.suffix.lower(), []).append(one)
    several = sorted(kinds, key=lambda kind: -len(kinds[kind]))[:3]
    if len(kinds) == 1 and len(kinds[several[0]]) > 1:
        return kinds[several[0]]
    held = ", ".join(f"{len(kinds[kind])} of {kind}" for kind in several) or "none"
    raise InputError(
        f"{path} must contain one set of images ({', '.join(IMAGE_SUFFIXES)}) whose names are like "
        f"{names} and differ only in numbers, got {held}: choose the views with --names, such as "
        f"--names '{several[0].replace('#', '*') if several else 'view_*.png'}'."
    )


def scan_view_folder(
    path: str | Path,
    order: str | None = None,
    *,
    grid: Grid | str | None = None,
    names: str | None = None,
) -> ViewFolder:
    """Find the files that are the views of a light field, and their order.

    The views are the images (png, jpg, tif, bmp, webp, ppm, pgm) with names that differ only in
    numbers. The last two numbers that vary, and repeat, are row and column: ``row_col.png``,
    ``view_R_C.jpg``, ``2067_RR_CC.png``, Stanford's ``out_RR_CC_y_x.png``, positions such as
    ``pos_-40_12.5.png``. A single number, as in HCI's ``input_Cam000.png``, counts row by row a
    square, or the `grid`. Rows and columns need one step; views may be missing.

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
        not fill it are positions in it, counted from 0, or from 1 if the last one is then there;
        positions without a view get weight 0.
    names : str, optional
        Pattern of the views' names, such as ``input_Cam*.png``. Default: all images.

    Returns
    -------
    ViewFolder

    Raises
    ------
    InputError
        If the folder, its names or the order cannot be used, steps between views differ, or
        views with a running number move as a single row does.

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
    numbered = number_grid(files, path, turned)
    image = read_shape(files[0])
    # As floats, with a byte for whether a value is finite; decoding takes two more at a time.
    check_memory(((FLOAT + 1) * numbered.size + 2 * FLOAT * READERS) * prod(image), path)
    if numbered.ndim == 1:
        numbered, found = fold(numbered, path, shape, order, read=read_image)
    else:
        found = find_order(numbered, read_image, stated=order)
    ordered = arranged(numbered, found.order)
    check_grid(shape, ordered.shape, path)
    return ViewFolder(path, ordered, found)


# Numbers in names ---------------------------------------------------------------------------------

NUMBER = r"(?:(?<![0-9.])[0-9]+\.[0-9]+(?!\.?[0-9])|[0-9]+)"
"""Pattern of a decimal number, without another point beside it, or of an integer."""

SIGNS = r"(?:(?<![^\W_])[-+])?", "[-+]?"
"""Patterns of an optional sign, that after neither a letter nor a digit, and of any."""


def number_grid(files: list[Path], source: Path, grid: Grid | None = None) -> np.ndarray:
    """Arrange files, whose names differ only in numbers, by these; None for a missing view.

    The shape is (first number, second number), or (running number,). A stated `grid` is that of the
    numbers: (first, second). Numbers are multiples of one step, the same along both axes, as slopes
    would have no unit otherwise. Where they do not fill a stated grid, whole numbers are positions
    in it: they count from 0, or from 1 if the last position is then there.
    """
    columns = _row_and_column([file.stem for file in files], grid)
    if len(set(zip(*columns, strict=True))) < len(files):
        raise InputError(
            f"The {len(files)} images of {source} do not number a grid: each needs a unique row "
            f"and column, or a unique running number."
        )
    stated = (None, None) if grid is None else grid if len(columns) == 2 else (prod(grid),)
    found = [sorted(set(column)) for column in columns]
    texts = [", ".join(map(str, x[:4])) + (f" ... {x[-1]}" if len(x) > 4 else "") for x in found]
    all_places, sizes = [], []
    for numbers, places, size, text in zip(found, _multiples(found), stated, texts, strict=False):
        if size is None:
            if places is None or gcd(*places) > 1:
                raise InputError(
                    f"The views of {source} need equal steps along both axes, got "
                    f"{' and '.join(texts)} by the numbers in their names; if these only "
                    f"count, rename the files with 0, 1, 2 ..."
                )
            size = places[-1] + 1
        elif places is None or places[-1] + 1 != size:
            start = int(numbers[-1] == size)
            places = [int(number) - start for number in numbers]
            whole = all(number == int(number) for number in numbers)
            if not whole or places[0] < 0 or places[-1] >= size:
                raise InputError(
                    f"The numbers in the names of {source}, {text}, do not count {size} positions "
                    f"from {start}: state another --grid or --order, or rename the files."
                )
        all_places.append(dict(zip(numbers, places, strict=True)))
        sizes.append(size)
    if grid is None and len(columns) == 1 and sizes[0] > len(files):
        raise InputError(
            f"{source} has only {len(files)} views, numbered {texts[0]} with gaps: state the grid "
            f"that they do not fill, --grid ROWSxCOLUMNS."
        )
    if prod(sizes) > max(2 * len(files), 10_000):
        raise InputError(
            f"{source}: {len(files)} views cannot fill a grid of {' x '.join(map(str, sizes))}."
        )
    views = np.full(sizes, None, object)
    for file, *numbers in zip(files, *columns, strict=True):
        views[tuple(map(dict.__getitem__, all_places, numbers))] = file
    return views


def _row_and_column(names: list[str], grid: Grid | None) -> list[tuple[Decimal, ...]]:
    """Find the last two numbers that differ between views and repeat, or one that counts the views.

    A view's position by its row and column is unique, and neither of the two alone is. In a single
    row or column one is: there they are the last two numbers, of as many digits in all names, and
    the other is always 0 or 1.
    """
    columns = list(zip(*(one[1::2] for one in split_numbers(names)), strict=True))
    repeated = [column for column in columns if 1 < len(set(column)) < len(names)]
    if len(repeated) > 1:
        return repeated[-2:]
    running = next((column for column in columns if len(set(column)) == len(names)), None)
    last = columns[-2:]
    is_line = grid is None or 1 in grid or grid[0] * grid[1] != len(names)
    if is_line and running in last and any(set(column) in ({0}, {1}) for column in last):
        digits = [re.findall(r"[0-9]+", name)[-2:] for name in names]
        if len({min(map(len, column)) for column in zip(*digits, strict=False)}) == 1:
            return last
    return [running] if running else repeated


def _multiples(axes: list[list[Decimal]]) -> Sequence[list[int] | None]:
    """Rising numbers of one or two axes as multiples of one step from the first; None if not so.

    Whole numbers have a common divisor. Others are positions, and two of them are one step apart.
    """
    decimals = max(-int(number.as_tuple().exponent) for numbers in axes for number in numbers)
    exact = [[int(Fraction(number) * 10**decimals) for number in numbers] for numbers in axes]
    apart = [after - before for numbers in exact for before, after in pairwise(numbers)]
    step = gcd(*apart)
    if decimals and step < min(apart):
        return [None] * len(axes)
    return [[(number - numbers[0]) // step for number in numbers] for numbers in exact]


def split_numbers(names: Sequence[str]) -> list[tuple[str | Decimal, ...]]:
    """Split names into text and numbers in turn, so that they sort in natural order.

    A hyphen is a minus sign if it follows neither a letter nor a digit (``pos_-40``, unlike
    ``view-40`` and ``2024-01-05``), or if only some names have it there (``y-4, y0, y4``). A point
    is a decimal point if it is the only one of a number, and if all numbers have the same count of
    decimals or none ends in 0 (``5.48``, unlike ``1.9, 1.10``).

    Parts are ``("pos_", Decimal(-40), "_", Decimal("0.5"), "")``, with exact numbers: sorted by
    them, ``frame2`` comes before ``frame10``.
    """
    ends = {number.partition(".")[2] for name in names for number in re.findall(NUMBER, name)}
    uneven = len({len(end) for end in ends if end}) > 1 and any(end.endswith("0") for end in ends)
    number = "[0-9]+" if uneven else NUMBER
    pieces = min(
        ([re.split(f"({sign}{number})", name) for name in names] for sign in SIGNS),
        key=lambda some: len({tuple(one[::2]) for one in some}),  # texts between the numbers
    )
    return [tuple(Decimal(part) if k % 2 else part for k, part in enumerate(one)) for one in pieces]
