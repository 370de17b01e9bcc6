"""Order of the views of a light field: as stated, or as the parallax shows.

An order names the meaning of the two numbers of a view, the slower one first: ``row,col`` is row by
row. A minus flips an axis: ``-row`` counts rows from the bottom, ``-col`` columns from the right.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from math import isqrt, prod
from pathlib import Path

import numpy as np
import skimage  # its parts load when they are used
from scipy.ndimage import gaussian_filter

from lf_flame._common.input_files import check_memory
from lf_flame.errors import InputError

ORDERS = (
    "row,col", "row,-col", "-row,col", "-row,-col",
    "col,row", "col,-row", "-col,row", "-col,-row",
)  # fmt: skip
"""Orders that may be stated; the first one is the default."""

Grid = tuple[int, int]
"""Number of rows and columns of views."""


@dataclass(frozen=True)
class ViewOrder:
    """Order of the views, one of `ORDERS`, and words for users on where it is from.

    `slopes` is the approximate range of the scene's slopes in this order, in pixels per view step
    (5th and 95th percentile of the patches); None where the parallax does not show an order.
    """

    order: str
    reason: str
    slopes: tuple[float, float] | None = None

    def __str__(self) -> str:
        return f"{self.order}, {self.reason}"

    def describe(self) -> list[str]:
        """Describe the order, and its ambiguity, in a line or two."""
        lines = [f"order {self}"]
        if self.slopes is not None and (self.order != ORDERS[0] or self.slopes[0] > 0):
            turned = half_turned(self.order)
            lines.append(
                f"order {turned} fits as well, and reverses all slopes: state --order={turned} if "
                f"nearer objects have the higher slopes here"
            )
        return lines


AS_STORED = ViewOrder(ORDERS[0], "as stored")


def stated_order(order: str | None) -> ViewOrder:
    """Order that the user stated, with blanks or without; `AS_STORED` if none."""
    if order is None:
        return AS_STORED
    plain = str(order).replace(" ", "")
    if plain not in ORDERS:
        raise InputError(f"order must be one of {'; '.join(ORDERS)}, got {order!r}.")
    return ViewOrder(plain, "as stated")


def by_columns(order: str) -> bool:
    """Whether the first number of an order is the column's."""
    return "col," in order


def arranged(views: np.ndarray, order: str) -> np.ndarray:
    """Reorder an array of views, or of files, from an order to ``[v, u, ...]``."""
    for axis, name in enumerate(order.split(",")):
        views = np.flip(views, axis) if name.startswith("-") else views
    return np.swapaxes(views, 0, 1) if by_columns(order) else views


def half_turned(order: str) -> str:
    """Order with both axes flipped, which only changes the sign of all slopes."""
    return ",".join(name[1:] if name.startswith("-") else f"-{name}" for name in order.split(","))


def read_grid(grid: Grid | str, name: str = "grid") -> Grid:
    """Read rows and columns of views from two numbers, or from text such as ``1x9``."""
    try:
        rows, columns = map(int, grid.lower().split("x") if isinstance(grid, str) else grid)
    except (TypeError, ValueError):
        rows = columns = 0
    if rows < 1 or columns < 1:
        raise InputError(
            f"{name} must be rows x columns of views, such as 1x9 or (1, 9), got {grid!r}."
        )
    return rows, columns


def check_grid(stated: Grid | None, found: tuple[int, ...], source: object) -> None:
    """Refuse a stated number of rows and columns that a source does not contain."""
    if stated not in (None, found):
        raise InputError(
            f"A grid of {stated[0]} x {stated[1]} views does not fit {source}, of {found[0]} x "
            f"{found[1]}."
        )


def fold(
    row: np.ndarray,
    source: str | Path,
    grid: Grid | None = None,
    order: str | None = None,
    *,
    read: Callable = np.asarray,
) -> tuple[np.ndarray, ViewOrder]:
    """Cut views with one running number into rows (or columns, if so stated); find their order.

    The views fill a `grid`, by default a square. Entries of `row` are views, or arguments of
    `read`. Other numbers of views, and views that move as one row or column does, are refused.
    """
    count, side = len(row), isqrt(len(row))
    rows, columns = grid or (side, side)
    if rows * columns != count:
        fault = "form no square" if grid is None else f"do not fill a grid of {rows} x {columns}"
        raise InputError(
            f"{source} contains {count} views with one running number, which {fault}: state their "
            f"rows x columns, --grid ROWSxCOLUMNS."
        )
    lines = (columns, rows) if order and by_columns(order) else (rows, columns)
    folded = row.reshape(*lines, *row.shape[1:])
    found = find_order(folded, read, stated=order, folded=source)
    return folded, found


# Parallax -----------------------------------------------------------------------------------------

LEAST_MARGIN = 0.28
"""Smallest lead of an order over the next one, as a fraction of the change between views.

Shuffled views, noise, and rows cut at the wrong positions lead by at most 0.25 by chance;
photographs and blurred noise in their true order by 0.3 to 0.99.
"""

SCALES = (1, 2, 4, 8, 16)
"""Factors by which views are reduced for the search; the parallax should be below one pixel."""

PATCH, BORDER = 16, 4
"""Side of the patches that are assumed to lie at one depth, and width of the border that is left
out, in reduced pixels."""

MOST_PIXELS = 4_000_000
"""Largest number of pixels of a view at a scale; larger views are reduced more."""

MOTIONS = {
    "row,col": ((1, 0), (0, 1)),
    "-row,col": ((-1, 0), (0, 1)),
    "col,row": ((0, 1), (1, 0)),
    "col,-row": ((0, 1), (-1, 0)),
}
"""Steps down and right that a step of the first and of the second number is, by order."""


def find_order(
    grid: np.ndarray,
    read: Callable = np.asarray,
    *,
    stated: str | None = None,
    folded: str | Path | None = None,
) -> ViewOrder:
    """Order as `stated`, or found from the parallax of four neighbours, at up to five positions.

    In a static scene a patch of slope d changes by ``-d dL/dt`` from one view row to the next and
    by ``-d dL/ds`` from one column to the next, with the same d (Bolles et al. 1987; Adelson and
    Wang 1992). Each order pairs the changes with the gradients differently; the one that explains
    most of the change, with one d for each patch in the centre and near the corners (four shuffled
    views agree with some order by chance), is chosen if it leads by `LEAST_MARGIN`; otherwise
    ``row,col``. No parallax shows a half-turn, which only changes the sign of all slopes: where
    rows and columns disagree, the columns are assumed to run from left to right.

    `grid`, of shape (first number, second number, ...), contains views or arguments of `read`, None
    for a missing view. Views with one running number, of the origin `folded`, are refused if they
    move as those of a single row or column do.
    """
    if stated is not None:
        return stated_order(stated)
    if min(grid.shape[:2]) < 2:
        return ViewOrder(ORDERS[0], "as the numbers are: there is only one row or column")
    count, lines = grid.shape[0] * grid.shape[1], grid.shape[1]
    motions: dict[str, tuple] = dict(MOTIONS)
    if folded is not None:
        motions |= {f"1x{count}": ((0, lines), (0, 1)), f"{count}x1": ((lines, 0), (1, 0))}
    sums = _sum_changes(grid, read)
    tried = [_compare(parts, scale, motions) for scale, parts in sums.items()]
    best, second, order, slopes = max(tried, default=(0.0, 0.0, ORDERS[0], (0.0, 0.0)))
    if best - second < LEAST_MARGIN:
        return ViewOrder(ORDERS[0], "as the numbers are: the parallax does not show an order")
    shares = f"of which it explains {best:.0%}, the next one {second:.0%}"
    if order not in MOTIONS:
        raise InputError(
            f"The {count} views of {folded} do not move as {grid.shape[0]} rows of {lines}, but as "
            f"one {'row' if order.startswith('1x') else 'column'}, by the parallax, {shares}: "
            f"state --grid {order}, or the --order."
        )
    return ViewOrder(order, f"by the parallax, {shares}", slopes)


def _blocks(grid: np.ndarray) -> list[list[int]]:
    """First row and column of four neighbours, in the centre and near the corners.

    The outer ones lie in the corners of a square that fits into a round aperture. They are the
    nearest blocks without missing views, each once.
    """
    filled = [one is not None for one in grid.reshape(-1, *grid.shape[2:])]
    there = np.reshape(filled, grid.shape[:2])
    whole = np.argwhere(there[:-1, :-1] & there[:-1, 1:] & there[1:, :-1] & there[1:, 1:])
    if not len(whole):
        return []
    last = np.array(grid.shape[:2]) - 2
    places = [(1 / 2, 1 / 2), *product((1 / 6, 5 / 6), repeat=2)]
    nearest = [int(((whole - last * place) ** 2).sum(axis=1).argmin()) for place in places]
    return whole[list(dict.fromkeys(nearest))].tolist()


def _sum_changes(grid: np.ndarray, read: Callable) -> dict[int, np.ndarray]:
    """Sum products of changes and gradients over blocks of four views, by scale and patch.

    Views that are small, not finite or of another shape are left out.
    """
    sums: dict[int, np.ndarray] = {}
    shape = None
    for v, u in _blocks(grid):
        views = [np.asarray(read(one)) for line in grid[v : v + 2] for one in line[u : u + 2]]
        grey = [view.reshape(*view.shape[:2], -1).mean(axis=2, dtype=np.float32) for view in views]
        shape = shape or grey[0].shape
        if {view.shape if np.isfinite(view).all() else None for view in grey} != {shape}:
            continue
        pixels = prod(shape)
        check_memory(240 * min(pixels, MOST_PIXELS) + 32 * pixels, "The order of the views")
        for scale in SCALES:
            if min(shape) // scale >= PATCH + 2 * BORDER and pixels / scale**2 <= MOST_PIXELS:
                block = np.reshape(grey, (2, 2, *shape))
                sums[scale] = sums.get(scale, 0.0) + _measure(block, scale)
    return sums


def _measure(block: np.ndarray, scale: int) -> np.ndarray:
    """Sum over each patch, to shape (7, patches).

    Rows: changes from row to row times the gradients down and right, those from column to column
    times both, the squares of both gradients, and those of the changes.
    """
    reduced = skimage.transform.downscale_local_mean(block, (1, 1, scale, scale)).astype(float)
    views, mean = gaussian_filter(reduced, 1.0, axes=(2, 3)), reduced.mean((0, 1))
    changes = [np.diff(views, axis=0)[0].mean(0), np.diff(views, axis=1)[:, 0].mean(0)]
    slants = [gaussian_filter(mean, 1.0, order=order) for order in ((1, 0), (0, 1))]
    fields = [change * slant for change in changes for slant in slants]
    fields += [slant**2 for slant in slants] + [changes[0] ** 2 + changes[1] ** 2]
    inner = np.array(fields)[:, BORDER:-BORDER, BORDER:-BORDER]
    rows, columns = (n // PATCH for n in inner.shape[1:])
    whole = inner[:, : rows * PATCH, : columns * PATCH]
    return whole.reshape(7, rows, PATCH, columns, PATCH).sum(axis=(2, 4)).reshape(7, -1)


def _compare(
    sums: np.ndarray, scale: int, motions: dict[str, tuple]
) -> tuple[float, float, str, tuple[float, float]]:
    """Fractions of the change that the best and the second-best motion explain, at one scale."""
    products, squares, change = sums[:4].reshape(2, 2, -1), sums[4:6], sums[6]
    steps = np.array(list(motions.values()), float)
    shared = np.einsum("mij,ijp->mp", steps, products)
    texture = np.einsum("mij,jp->mp", steps**2, squares)
    # The slope that fits a patch best, by least squares.
    slopes = -np.divide(shared, texture, out=np.zeros_like(shared), where=texture > 0)
    shares = -np.sum(slopes * shared, axis=1) / max(change.sum(), np.finfo(float).tiny)
    second, best = np.argsort(shares)[-2:]
    seen = slopes[best, texture[best] >= texture[best].mean() / 4]  # others are mostly noise
    low, high = (scale * np.percentile(seen, (5, 95))).tolist()
    return float(shares[best]), float(shares[second]), list(motions)[best], (low, high)
