"""Which way the views of a light field are counted, as stated or as the parallax shows.

An order names what the two numbers of a view count, the slower one first: ``row,col`` is row by
row. A minus turns an axis: ``-row`` counts rows from the bottom, ``-col`` columns from the right.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter
from skimage.transform import downscale_local_mean

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

LEAST_EXPLAINED, LEAST_RATIO = 0.3, 2.0
"""Share of the change between views that an order must explain, and how far before the next."""


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
    """

    order: str
    reason: str
    slopes: tuple[float, float] | None = None


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
    v, u = ((n - 1) // 2 for n in grid.shape[:2])
    block = [[_grey(read(view)) for view in row] for row in grid[v : v + 2, u : u + 2]]
    shapes = {view.shape if np.isfinite(view).all() else None for row in block for view in row}
    smallest = min(block[0][0].shape) if len(shapes) == 1 and None not in shapes else 0
    scales = [scale for scale in SCALES if smallest // scale >= PATCH + 2 * BORDER]
    explained, next_best, order, slopes = max(
        (_explain(np.array(block), scale) for scale in scales), default=(0.0, 0.0, "row,col", None)
    )
    if explained < max(LEAST_EXPLAINED, LEAST_RATIO * next_best):
        return FoundOrder("row,col", "as the numbers stand: the parallax does not tell")
    reason = f"by the parallax, of which it explains {explained:.0%}, the next one {next_best:.0%}"
    return FoundOrder(order, reason, slopes)


def _grey(view: np.ndarray) -> np.ndarray:
    return view.mean(axis=2, dtype=np.float64) if view.ndim == 3 else view.astype(np.float64)


def _explain(block: np.ndarray, scale: int) -> tuple[float, float, str, tuple[float, float]]:
    """Explained share of the change by the best and the second-best order, at one scale."""
    reduced = downscale_local_mean(block, (1, 1, scale, scale))
    views = gaussian_filter(reduced, SMOOTHING, axes=(2, 3))
    first = np.diff(views, axis=0)[0].mean(0)
    second = np.diff(views, axis=1)[:, 0].mean(0)
    mean = reduced.mean((0, 1))
    down, right = (gaussian_filter(mean, SMOOTHING, order=order) for order in ((1, 0), (0, 1)))
    inner = np.s_[BORDER:-BORDER, BORDER:-BORDER]
    first, second, down, right = (field[inner] for field in (first, second, down, right))
    texture = _patches(down**2 + right**2)
    change = _patches(first**2 + second**2).sum()
    found = []
    for order, with_first, with_second in (
        ("row,col", down, right),
        ("-row,col", -down, right),
        ("col,row", right, down),
        ("col,-row", right, -down),
    ):
        product = _patches(first * with_first + second * with_second)
        slopes = -np.divide(product, texture, out=np.zeros_like(product), where=texture > 0)
        found.append((-np.sum(slopes * product), order, slopes * scale))
    found.sort(key=lambda one: one[0], reverse=True)
    (best, order, slopes), (next_best, *_) = found[:2]
    seen = slopes[texture >= texture.mean() / 4]  # others are mostly noise
    low, high = (float(x) for x in np.percentile(seen, (5, 95)))
    change = max(change, np.finfo(float).tiny)
    return best / change, next_best / change, order, (low, high)


def _patches(field: np.ndarray) -> np.ndarray:
    """Sum over the whole patches."""
    rows, columns = (n // PATCH for n in field.shape)
    whole = field[: rows * PATCH, : columns * PATCH]
    return whole.reshape(rows, PATCH, columns, PATCH).sum(axis=(1, 3))
