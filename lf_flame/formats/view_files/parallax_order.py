"""Order of the views: as stated, or as the parallax shows.

An order names the meaning of the two numbers of a view, the slower one first: ``row,col`` is row by
row. A minus turns an axis: ``-row`` counts rows from the bottom, ``-col`` columns from the right.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from itertools import product
from math import ceil, prod, sqrt

import numpy as np
import skimage  # its parts load when they are used
from scipy.ndimage import gaussian_filter

from lf_flame.formats.view_files.orders import SNAKE, arranged, turned_round

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
"""Smallest ratio to the next order that tells more than the views' own numbers do, such as that one
running number counts a square.

For a single row of n * n views the best order explains at most 1.96 times as much as the next,
whatever the texture: a step down in the square would be n steps along the row.
"""

INSET = 1 / 6
"""Distance of the outer blocks of four views from the edge of the grid, as a fraction of its side:
the corners of a square that fits into a round aperture."""

LEAST_NEXT = 1e-6
"""Explained fraction below which the next order counts as this much."""

GreyView = tuple[np.ndarray, int]
"""View in grey, and the number of pixels along an axis that were averaged to one."""


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
    half_turn : bool, optional
        Whether nothing but the parallax shows the order, so that its half-turn fits as well.
    """

    order: str
    reason: str
    slopes: tuple[float, float] | None = None
    lead: float = 0.0
    half_turn: bool = False

    def describe(self) -> list[str]:
        """Describe the order, and what no parallax shows, in a line or two."""
        lines = [f"order {self.order}, {self.reason}"]
        ahead = self.order == "row,col" and self.slopes is not None and self.slopes[0] > 0
        if self.half_turn or ahead:
            turned = turned_round(self.order)
            why = (
                "most slopes are above 0, those of parallel cameras below"
                if ahead
                else f"order {turned} fits as well, and reverses all slopes"
            )
            lines.append(
                f"{why}: state --order={turned} if nearer objects have the higher slopes here"
            )
        return lines


UNKNOWN = FoundOrder("row,col", "as the numbers stand: the parallax does not tell")
"""Order where the parallax shows none."""


def find_order(grid: np.ndarray, read: Callable = np.asarray) -> FoundOrder:
    """Find the order of the views from the parallax of four neighbours, in up to five places.

    In a static scene a patch of slope d changes by ``-d dL/dt`` from one view row to the next and
    by ``-d dL/ds`` from one column to the next, with the same d (Bolles et al. 1987; Adelson and
    Wang 1992). Each order pairs the changes with the gradients differently; the one that explains
    most of the change, with one d for each patch, is chosen. Turning both axes only changes the
    sign of all slopes, which no parallax shows. Where rows and columns disagree, either could be
    turned: the columns are then assumed to run from left to right. Four views alone agree
    with some order by chance, if they are shuffled: a patch must have the same slope in the centre
    and near the corners.

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
    return replace(snake, order=f"{SNAKE},{snake.order}", reason=reason, half_turn=True)


def _find_order(grid: np.ndarray, numbers: np.ndarray, read: Callable) -> FoundOrder:
    """Find the order of the views with these running numbers, row by row."""
    sums, times = _sum_changes(
        [_grey(read(grid[divmod(k, grid.shape[1])])) for k in chosen]
        for chosen in _chosen_blocks(grid, numbers)
    )
    explained, next_best, order, slopes = max(
        (_explain(parts, scale) for scale, parts in sums.items()),
        default=(0.0, 0.0, "row,col", (0.0, 0.0)),
    )
    if explained < max(LEAST_EXPLAINED, LEAST_RATIO * next_best):
        return UNKNOWN
    reason = f"by the parallax, of which it explains {explained:.0%}, the next one {next_best:.0%}"
    low, high = (slope * times for slope in slopes)
    lead = explained / max(next_best, LEAST_NEXT)
    return FoundOrder(order, reason, (low, high), lead, half_turn=order != "row,col")


def _chosen_blocks(grid: np.ndarray, numbers: np.ndarray) -> list[np.ndarray]:
    """Choose the numbers of four neighbouring views, in the centre and near the corners.

    They are the whole blocks nearest to these places, each once; none if there is none.
    """
    there = np.array([grid[divmod(k, grid.shape[1])] is not None for k in numbers.flat])
    there = there.reshape(numbers.shape)
    whole = there[:-1, :-1] & there[:-1, 1:] & there[1:, :-1] & there[1:, 1:]
    if not whole.any():
        return []
    rows, columns = np.nonzero(whole)
    last = np.array(whole.shape) - 1
    places = [(0.5, 0.5), *product((INSET, 1 - INSET), repeat=2)]
    nearest = [
        int(((rows - v * last[0]) ** 2 + (columns - u * last[1]) ** 2).argmin()) for v, u in places
    ]
    return [
        numbers[rows[k] : rows[k] + 2, columns[k] : columns[k] + 2].ravel()
        for k in dict.fromkeys(nearest)
    ]


def _sum_changes(blocks: Iterable[list[GreyView]]) -> tuple[dict[int, np.ndarray], int]:
    """Add the results of `_measure` for blocks of four views, scale by scale.

    A patch is summed over all blocks, as it has the same slope in each. Blocks of other shapes than
    the first usable one do not count. The second result is that of `_grey_block`.
    """
    sums: dict[int, np.ndarray] = {}
    shape, times = None, 1
    for grey in blocks:
        block, scales, reduced = _grey_block(grey)
        del grey  # as much memory as the block takes
        if not scales or shape not in (None, block.shape):
            continue
        shape, times = block.shape, reduced
        for scale in scales:
            sums[scale] = sums.get(scale, 0.0) + _measure(block, scale)
    return sums, times


def _grey_block(grey: list[GreyView]) -> tuple[np.ndarray, list[int], int]:
    """Four grey views as an array (2, 2, t, s), and the scales at which their parallax may show.

    There is no such scale if they are small, differ in shape or are not finite. The last result is
    the number of pixels along an axis that were averaged to one.
    """
    shapes = {view.shape if np.isfinite(view).all() else None for view, _ in grey}
    if len(shapes) != 1 or None in shapes:
        return np.empty((2, 2, 0, 0)), [], 1
    block, times = np.array([view for view, _ in grey]), grey[0][1]
    scales = [n for n in SCALES if min(block.shape[1:]) // n >= PATCH + 2 * BORDER]
    return block.reshape(2, 2, *block.shape[1:]), scales, times


def _grey(view: np.ndarray) -> GreyView:
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


def _measure(block: np.ndarray, scale: int) -> np.ndarray:
    """Sum over each patch, to an array of shape (6, patches).

    Summed are the products of the changes from row to row and from column to column with the
    gradients down and right, and the squares of the gradients and of the changes.
    """
    first, second, down, right = _changes(block, scale)
    pairs = (first, down), (first, right), (second, down), (second, right)
    products = [_patches(change * gradient) for change, gradient in pairs]
    squares = [_patches(one**2 + other**2) for one, other in ((down, right), (first, second))]
    return np.array([sums.ravel() for sums in (*products, *squares)])


def _explain(sums: np.ndarray, scale: int) -> tuple[float, float, str, tuple[float, float]]:
    """Fractions of the change that the best and the second-best order explain, at one scale."""
    first_down, first_right, second_down, second_right, texture, change = sums
    found = []
    for order, products in (
        ("row,col", first_down + second_right),
        ("-row,col", second_right - first_down),
        ("col,row", first_right + second_down),
        ("col,-row", first_right - second_down),
    ):
        # The slope that fits a patch best, by least squares.
        slopes = -np.divide(products, texture, out=np.zeros_like(products), where=texture > 0)
        share = -np.sum(slopes * products) / max(change.sum(), np.finfo(float).tiny)
        found.append((float(share), order, slopes * scale))
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


def _patches(field: np.ndarray) -> np.ndarray:
    """Sum over all whole patches."""
    rows, columns = (n // PATCH for n in field.shape)
    whole = field[: rows * PATCH, : columns * PATCH]
    return whole.reshape(rows, PATCH, columns, PATCH).sum(axis=(1, 3))
