"""Which way the views of a light field are counted, as stated or as the parallax shows.

An order names what the two numbers of a view count, the slower one first: ``row,col`` is row by
row. A minus turns an axis: ``-row`` counts rows from the bottom, ``-col`` columns from the right.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import ceil, isqrt, prod, sqrt
from pathlib import Path

import numpy as np
import skimage  # its parts load when they are used
from scipy.ndimage import gaussian_filter

from lf_flame.errors import InputError

ORDERS = tuple(
    f"{a}{first},{b}{second}"
    for first, second in (("row", "col"), ("col", "row"))
    for a in ("", "-")
    for b in ("", "-")
)

SCALES = (1, 2, 4, 8, 16)
"""Reductions of the views at which the parallax is looked for: it should be below a pixel."""

PATCH = 16
"""Side of the patches that are taken to lie at one depth, in reduced pixels."""

SMOOTHING = 1.0
"""Standard deviation, in reduced pixels, of the Gaussian that the gradients are taken of."""

BORDER = 4
"""Reduced pixels that are left out on each side."""

MOST_PIXELS = 4_000_000
"""Pixels of a view in which the parallax is looked for; larger ones are reduced before."""

ORDER_BYTES = 140
"""Bytes of memory that this takes for each of these pixels."""

LEAST_EXPLAINED, LEAST_RATIO = 0.3, 2.0
"""Share of the change between views that an order must explain, and how far before the next."""

LEAST_LEAD = 2.5
"""How far before the next an order must be for a running number to count a square.

Of one row of n * n views, whatever its texture, the best order explains at most 1.96 times as much
as the next: what is taken for a step down is n steps along the row.
"""

LEAST_NEXT = 1e-6
"""Share below which the next order counts as nothing."""


Grid = tuple[int, int]
"""Rows and columns of views."""


@dataclass(frozen=True)
class FoundOrder:
    """The order of the views, and what speaks for it.

    Attributes
    ----------
    order : str
        One of `ORDERS`.
    reason : str
        How it was found, for people.
    slopes : (float, float), optional
        About the slopes at which the scene is sharp in this order, in pixels per view step: the
        5th and the 95th percentile of its patches.
    lead : float, optional
        How many times as much of the change between the views it explains as the next order; 0 if
        the parallax does not tell.
    """

    order: str
    reason: str
    slopes: tuple[float, float] | None = None
    lead: float = 0.0


def arranged(views: np.ndarray, order: str) -> np.ndarray:
    """Bring an array of views, or of their files, from an order of `ORDERS` to ``[v, u, ...]``."""
    for axis, name in enumerate(check_order(order).split(",")):
        if name.startswith("-"):
            views = np.flip(views, axis)
    return np.swapaxes(views, 0, 1) if "col," in order else views


def check_order(order: str) -> str:
    """Return a stated order without its blanks.

    Raises
    ------
    InputError
        If it is not one of `ORDERS`.
    """
    plain = str(order).replace(" ", "")
    if plain not in ORDERS:
        raise InputError(f"order must be one of {'; '.join(ORDERS)}, got {order!r}.")
    return plain


def find_order(grid: np.ndarray, read: Callable = np.asarray) -> FoundOrder:
    """Find the order of the views from the parallax of the four in the middle.

    In a static scene a patch of slope d changes by ``-d dL/dt`` from one view row to the next and
    by ``-d dL/ds`` from one column to the next, with the same d (Bolles et al. 1987; Adelson and
    Wang 1992). Each order pairs the changes with the gradients differently; the one that explains
    most of the change, with one d for each patch, holds. Both axes turned at once only turn the
    sign of all slopes, which no parallax tells, and where rows and columns disagree, either could
    be turned: then the columns are taken to run from left to right.

    Parameters
    ----------
    grid : ndarray, shape (first number, second number, ...)
        The views, or what `read` makes them of, as their numbers count.
    read : callable, optional
        Makes a view of an entry of the grid.

    Returns
    -------
    FoundOrder
        ``row,col`` if the views are too few, too small, too alike or too different to tell.
    """
    if min(grid.shape[:2]) < 2:
        return FoundOrder("row,col", "as the numbers stand: there is one row or column only")
    block, scales, times = _middle_views(grid, read)
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
    """Put views that one running number counts in rows and columns.

    Parameters
    ----------
    views : ndarray, shape (number, ...)
        The views in their order, or what `read` makes them of.
    source : str or Path
        Where they are from, for the message.
    shape : (int, int), optional
        Rows and columns. Default: a square, if the parallax of the four views in its middle shows
        rows and columns.
    read : callable, optional

    Returns
    -------
    ndarray, shape (rows, columns, ...)

    Raises
    ------
    InputError
        If the shape holds another number of views, or none is stated and no square is shown.
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


def as_grid(grid: Grid | str | None) -> Grid | None:
    """Take rows and columns of views as two numbers, or as text such as ``1x9``.

    Raises
    ------
    InputError
        If they are no two whole numbers above 0.
    """
    if grid is None:
        return None
    words = grid.lower().split("x") if isinstance(grid, str) else list(grid)
    try:
        rows, columns = (int(word) for word in words)
    except (TypeError, ValueError):
        rows = columns = 0
    if rows < 1 or columns < 1:
        raise InputError(
            f"grid must be rows x columns of views, such as 1x9 or (1, 9), got {grid!r}."
        )
    return rows, columns


def _middle_views(grid: np.ndarray, read: Callable) -> tuple[np.ndarray, list[int], int]:
    """Read the four views in the middle, and tell at which scales their parallax may show.

    At no scale, if they differ in shape or are not finite. The last number returned is that of the
    pixels along an axis that are averaged to one of the block.
    """
    v, u = ((n - 1) // 2 for n in grid.shape[:2])
    block = [_grey(read(view)) for row in grid[v : v + 2, u : u + 2] for view in row]
    shapes = {view.shape if np.isfinite(view).all() else None for view, _ in block}
    if len(shapes) != 1 or None in shapes:
        return np.empty((2, 2, 0, 0)), [], 1
    views, times = np.array([view for view, _ in block]), block[0][1]
    scales = [n for n in SCALES if min(views.shape[1:]) // n >= PATCH + 2 * BORDER]
    return views.reshape(2, 2, *views.shape[1:]), scales, times


def _grey(view: np.ndarray) -> tuple[np.ndarray, int]:
    """Average the colours, and the pixels of a large view, so many to one along each axis."""
    times = ceil(sqrt(prod(view.shape[:2]) / MOST_PIXELS))
    grey = view.mean(axis=2, dtype=np.float64) if view.ndim == 3 else view.astype(np.float64)
    return skimage.transform.downscale_local_mean(
        grey, (times, times)
    ) if times > 1 else grey, times


def order_memory(shape: tuple[int, ...]) -> int:
    """Bytes that `find_order` takes for views of a shape (rows, columns, ...)."""
    rows, columns = shape[:2]
    return ORDER_BYTES * min(rows * columns, MOST_PIXELS) + 8 * rows * columns


def _explain(block: np.ndarray, scale: int) -> tuple[float, float, str, tuple[float, float]]:
    """Explained share of the change by the best and the second-best order, at one scale."""
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
    """Change from row to row and from column to column, and the gradients down and right."""
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
    """Fit one slope to each patch; the share of the change that they explain, and the slopes."""
    product = _patches(first * with_first + second * with_second)
    texture = _patches(with_first**2 + with_second**2)
    slopes = -np.divide(product, texture, out=np.zeros_like(product), where=texture > 0)
    change = max(_patches(first**2 + second**2).sum(), np.finfo(float).tiny)
    return float(-np.sum(slopes * product) / change), slopes


def _patches(field: np.ndarray) -> np.ndarray:
    """Sum over the whole patches."""
    rows, columns = (n // PATCH for n in field.shape)
    whole = field[: rows * PATCH, : columns * PATCH]
    return whole.reshape(rows, PATCH, columns, PATCH).sum(axis=(1, 3))
