"""Order of the views: as stated, or as the parallax shows.

An order names the meaning of the two numbers of a view, the slower one first: ``row,col`` is row by
row. A minus turns an axis: ``-row`` counts rows from the bottom, ``-col`` columns from the right.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import ceil, isqrt, prod, sqrt
from pathlib import Path

import numpy as np
import skimage  # its parts load when they are used
from scipy.ndimage import gaussian_filter

from lf_flame.errors import InputError
from lf_flame.formats.view_files.orders import SNAKE, Grid, arranged

SCALES = (1, 2, 4, 8, 16)
"""Factors by which views are reduced for the parallax search; it should be below one pixel."""

PATCH = 16
"""Side of the patches that are assumed to lie at one depth, in reduced pixels."""

SMOOTHING = 1.0
"""Standard deviation of the Gaussian for the gradients, in reduced pixels."""

BORDER = 4
"""Width of the border that is left out on each side, in reduced pixels."""

MOST_PIXELS = 4_000_000
"""Largest number of pixels of a view for the parallax search; larger views are reduced first."""

ORDER_BYTES = 140
"""Number of bytes of memory that the search takes for each of these pixels."""

LEAST_EXPLAINED, LEAST_RATIO = 0.3, 2.0
"""Smallest fraction of the change between views that an order must explain, and its smallest ratio
to the next order."""

LEAST_LEAD = 2.5
"""Smallest ratio to the next order with which a running number counts a square.

For a single row of n * n views the best order explains at most 1.96 times as much as the next,
whatever the texture: a step down in the square would be n steps along the row.
"""

LEAST_NEXT = 1e-6
"""Explained fraction below which the next order counts as this much."""


@dataclass(frozen=True)
class FoundOrder:
    """Order of the views, and the evidence for it.

    Attributes
    ----------
    order : str
        An order as in `lf_flame.formats.view_files.orders`.
    reason : str
        Sentence for users on how the order was found.
    slopes : (float, float), optional
        Approximate range of the scene's slopes in this order, in pixels per view step: the 5th and
        the 95th percentile of the patches.
    lead : float, optional
        Explained change between views, divided by that of the next order; 0 if the parallax does
        not show an order.
    """

    order: str
    reason: str
    slopes: tuple[float, float] | None = None
    lead: float = 0.0

    def describe(self) -> list[str]:
        """Describe the order, and what no parallax shows, in a line or two."""
        lines = [f"order {self.order}, {self.reason}"]
        if self.slopes and self.slopes[0] > 0 and self.order == "row,col":
            lines.append(
                "most slopes are above 0, those of parallel cameras below: if nearer objects have "
                "the higher slopes here, the order is -row,-col"
            )
        return lines


def find_order(grid: np.ndarray, read: Callable = np.asarray) -> FoundOrder:
    """Find the order of the views from the parallax of four neighbours in the centre.

    In a static scene a patch of slope d changes by ``-d dL/dt`` from one view row to the next and
    by ``-d dL/ds`` from one column to the next, with the same d (Bolles et al. 1987; Adelson and
    Wang 1992). Each order pairs the changes with the gradients differently; the one that explains
    most of the change, with one d for each patch, is chosen. Turning both axes only changes the
    sign of all slopes, which no parallax shows. Where rows and columns disagree, either could be
    turned: the columns are then assumed to run from left to right.

    Where no order explains the change, every other row may run back (a camera that a stage moves in
    a snake). Views of a single row, folded so, change along one axis only, which all orders explain
    alike: they are not taken for a snake.

    Parameters
    ----------
    grid : ndarray, shape (first number, second number, ...)
        Views, or arguments of `read`, in the order of their numbers; None for a missing view.
    read : callable, optional
        Function that gives the view for an entry of the grid.

    Returns
    -------
    FoundOrder
        The order; ``row,col`` if the views are too few, too small, too similar or too different.
    """
    if min(grid.shape[:2]) < 2:
        return FoundOrder("row,col", "as the numbers stand: there is one row or column only")
    numbers = np.arange(prod(grid.shape[:2])).reshape(grid.shape[:2])
    found = _find_order(grid, numbers, read)
    if found.lead:
        return found
    snake = _find_order(grid, arranged(numbers, SNAKE), read)
    if snake.lead <= LEAST_LEAD:
        return found
    reason = f"every other row runs back, {snake.reason}"
    return replace(snake, order=f"{SNAKE},{snake.order}", reason=reason)


def _find_order(grid: np.ndarray, numbers: np.ndarray, read: Callable) -> FoundOrder:
    """Find the order of the views with these running numbers, row by row."""
    block, scales, times = _middle_views(grid, numbers, read)
    explained, next_best, order, slopes = max(
        (_explain(block, scale) for scale in scales), default=(0.0, 0.0, "row,col", (0.0, 0.0))
    )
    if explained < max(LEAST_EXPLAINED, LEAST_RATIO * next_best):
        return FoundOrder("row,col", "as the numbers stand: the parallax does not tell")
    reason = f"by the parallax, of which it explains {explained:.0%}, the next one {next_best:.0%}"
    low, high = (slope * times for slope in slopes)
    return FoundOrder(order, reason, (low, high), explained / max(next_best, LEAST_NEXT))


def fold(
    views: np.ndarray, source: str | Path, shape: Grid | None = None, read: Callable = np.asarray
) -> np.ndarray:
    """Arrange views with one running number in rows and columns.

    Parameters
    ----------
    views : ndarray, shape (number, ...)
        Views in their order, or arguments of `read`.
    source : str or Path
        Origin of the views, for the message.
    shape : (int, int), optional
        Number of rows and columns. Default: a square, if the parallax of the four views in its
        centre shows rows and columns.
    read : callable, optional
        Function that gives the view for an entry of `views`.

    Returns
    -------
    ndarray, shape (rows, columns, ...)

    Raises
    ------
    InputError
        If the shape does not match the number of views, or none is stated and no square shows.
    """
    count, side = len(views), isqrt(len(views))
    if shape is not None:
        if prod(shape) != count:
            raise InputError(
                f"A grid of {shape[0]} x {shape[1]} views does not fit {source}, which holds "
                f"{count}."
            )
        return views.reshape(*shape, *views.shape[1:])
    if side**2 == count > 1:
        square = views.reshape(side, side, *views.shape[1:])
        if find_order(square, read).lead > LEAST_LEAD:
            return square
    shown = f"their parallax shows no {side} rows" if side**2 == count else "they make no square"
    raise InputError(
        f"{source} holds {count} views with one running number, and {shown}: state rows x columns "
        f"as --grid 1x{count}, if they are one row (in Python grid=(1, {count}))."
    )


def _middle_views(
    grid: np.ndarray, numbers: np.ndarray, read: Callable
) -> tuple[np.ndarray, list[int], int]:
    """Read four neighbouring views, and find the scales at which their parallax may show.

    They are the whole block nearest the centre. There is no such scale if there is none, or if they
    differ in shape or are not finite. The last result is the number of pixels along an axis that
    were averaged to one.
    """
    nothing: tuple = (np.empty((2, 2, 0, 0)), [], 1)
    there = np.array([grid[divmod(k, grid.shape[1])] is not None for k in numbers.flat])
    there = there.reshape(numbers.shape)
    whole = there[:-1, :-1] & there[:-1, 1:] & there[1:, :-1] & there[1:, 1:]
    if not whole.any():
        return nothing
    rows, columns = np.indices(whole.shape)
    distance = (rows - (len(grid) - 1) // 2) ** 2 + (columns - (grid.shape[1] - 1) // 2) ** 2
    v, u = np.unravel_index(np.where(whole, distance, distance.max() + 1).argmin(), whole.shape)
    chosen = numbers[v : v + 2, u : u + 2].flat
    block = [_grey(read(grid[divmod(k, grid.shape[1])])) for k in chosen]
    shapes = {view.shape if np.isfinite(view).all() else None for view, _ in block}
    if len(shapes) != 1 or None in shapes:
        return nothing
    views, times = np.array([view for view, _ in block]), block[0][1]
    scales = [n for n in SCALES if min(views.shape[1:]) // n >= PATCH + 2 * BORDER]
    return views.reshape(2, 2, *views.shape[1:]), scales, times


def _grey(view: np.ndarray) -> tuple[np.ndarray, int]:
    """Average the colours, and n x n pixels of a large view to one; also returns n."""
    times = ceil(sqrt(prod(view.shape[:2]) / MOST_PIXELS))
    grey = view.mean(axis=2, dtype=np.float64) if view.ndim == 3 else view.astype(np.float64)
    return skimage.transform.downscale_local_mean(
        grey, (times, times)
    ) if times > 1 else grey, times


def order_memory(shape: tuple[int, ...]) -> int:
    """Count the bytes that `find_order` takes for views of a shape (rows, columns, ...)."""
    rows, columns = shape[:2]
    return ORDER_BYTES * min(rows * columns, MOST_PIXELS) + 8 * rows * columns


def _explain(block: np.ndarray, scale: int) -> tuple[float, float, str, tuple[float, float]]:
    """Fractions of the change that the best and the second-best order explain, at one scale."""
    first, second, down, right = _changes(block, scale)
    texture = _patches(down**2 + right**2)
    found = []
    for order, with_first, with_second in (
        ("row,col", down, right),
        ("-row,col", -down, right),
        ("col,row", right, down),
        ("col,-row", right, -down),
    ):
        share, slopes = _fit(first, second, with_first, with_second)
        found.append((share, order, slopes * scale))
    found.sort(key=lambda one: one[0], reverse=True)
    (best, order, slopes), (next_best, *_) = found[:2]
    seen = slopes[texture >= texture.mean() / 4]  # others are mostly noise
    low, high = (float(x) for x in np.percentile(seen, (5, 95)))
    return best, next_best, order, (low, high)


def _changes(block: np.ndarray, scale: int) -> list[np.ndarray]:
    """Find the changes from row to row and column to column, and the gradients down and right."""
    reduced = skimage.transform.downscale_local_mean(block, (1, 1, scale, scale))
    views = gaussian_filter(reduced, SMOOTHING, axes=(2, 3))
    first = np.diff(views, axis=0)[0].mean(0)
    second = np.diff(views, axis=1)[:, 0].mean(0)
    mean = reduced.mean((0, 1))
    down, right = (gaussian_filter(mean, SMOOTHING, order=order) for order in ((1, 0), (0, 1)))
    inner = np.s_[BORDER:-BORDER, BORDER:-BORDER]
    return [field[inner] for field in (first, second, down, right)]


def _fit(
    first: np.ndarray, second: np.ndarray, with_first: np.ndarray, with_second: np.ndarray
) -> tuple[float, np.ndarray]:
    """Fit one slope to each patch; returns the explained fraction of the change, and the slopes."""
    product = _patches(first * with_first + second * with_second)
    texture = _patches(with_first**2 + with_second**2)
    slopes = -np.divide(product, texture, out=np.zeros_like(product), where=texture > 0)
    change = max(_patches(first**2 + second**2).sum(), np.finfo(float).tiny)
    return float(-np.sum(slopes * product) / change), slopes


def _patches(field: np.ndarray) -> np.ndarray:
    """Sum over all whole patches."""
    rows, columns = (n // PATCH for n in field.shape)
    whole = field[: rows * PATCH, : columns * PATCH]
    return whole.reshape(rows, PATCH, columns, PATCH).sum(axis=(1, 3))
