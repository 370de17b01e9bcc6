"""Refocusing by formula, as systems next to the networks, and the views that systems select."""

from collections.abc import Callable

import numpy as np

from lf_flame.datasets.encodings import area_average, spread
from lf_flame.errors import InputError
from lf_flame.refocus import fourier_slice, shift_and_sum
from lf_flame.refocus._arguments import Views, as_views
from lf_flame.systems.base import RefocusingSystem, ViewIndices


def every_view(rows: int, columns: int) -> ViewIndices:
    """List all views."""
    return [(v, u) for v in range(rows) for u in range(columns)]


def square_of_views(rows: int, columns: int, side: int = 3) -> ViewIndices:
    """Choose the views at the centres of side x side equal parts of the aperture."""
    _check_count(side, rows, columns)
    down, across = (
        np.floor((np.arange(side) + 0.5) * count / side).astype(int).tolist()
        for count in (rows, columns)
    )
    return [(v, u) for v in down for u in across]


def outer_square_of_views(rows: int, columns: int, side: int = 7) -> ViewIndices:
    """Choose side x side views, spread from the first to the last."""
    _check_count(side, rows, columns)
    return [(v, u) for v in spread(rows, side) for u in spread(columns, side)]


def diamond_of_views(rows: int, columns: int) -> ViewIndices:
    """Choose four views half-way from the centre to the outermost ones, of a square of views.

    Where half-way is between two views, the outer one suits RefocusNet's weights better.
    """
    if rows != columns or rows < 3:
        raise InputError(f"A square of 3 x 3 views or more is needed, got {rows} x {columns}.")
    centre, low = (rows - 1) // 2, (rows - 1) // 4
    high = rows - 1 - low
    return [(centre, low), (low, centre), (centre, high), (high, centre)]


def cross_of_views(rows: int, columns: int) -> ViewIndices:
    """Choose the central row and the central column, nine views of each, spread evenly.

    These are 17 of 81 views (Samarakoon et al., arXiv 2502.19238); the fifth is the central one.
    """
    _check_count(9, rows, columns)
    down, across = spread(rows, 9), spread(columns, 9)
    return [(v, across[4]) for v in down] + [(down[4], u) for u in across if u != across[4]]


def only_views(shape: tuple[int, ...], indices: ViewIndices) -> np.ndarray:
    """Weights of views, (v, u), that select some: 1 for these, 0 for others."""
    weights = np.zeros(shape)
    weights[tuple(np.transpose(indices))] = 1
    return weights


def _check_count(side: int, rows: int, columns: int) -> None:
    if min(rows, columns) < side:
        raise InputError(f"{side} x {side} views are needed, got {rows} x {columns}.")


class ShiftAndSum(RefocusingSystem):
    """Shift-and-sum of all or selected views.

    Parameters
    ----------
    name : str
        Name in tables.
    selection : callable, optional
        Function of the number of rows and columns of views that lists row and column of each view
        to use, such as `lf_flame.systems.formulas.square_of_views`. Default: all views.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame.systems import ShiftAndSum
    >>> ShiftAndSum().refocus(np.ones((5, 5, 24, 30)), [0.0, 0.5], (2, 2)).shape
    (2, 12, 15)
    """

    def __init__(
        self, name: str = "shift-and-sum", selection: Callable[..., ViewIndices] | None = None
    ):
        self.name, self._selection = name, selection or every_view
        self.by_weights = selection is None

    def view_indices(self, rows: int, columns: int) -> ViewIndices:
        """Choose the views to use."""
        return self._selection(rows, columns)

    def _refocus(self, views: Views, slopes: np.ndarray, block) -> np.ndarray:
        shape = as_views(views).shape[:2]
        weights = only_views(shape, self.view_indices(*shape))
        return average(shift_and_sum(views, slopes, weights=weights), block)


class FourierSlice(RefocusingSystem):
    """A slice through the spectrum of the light field (R. Ng, SIGGRAPH 2005).

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame.systems import FourierSlice
    >>> FourierSlice().refocus(np.ones((5, 5, 24, 30)), [0.0, 0.5], (2, 2)).shape
    (2, 12, 15)
    """

    name, by_weights = "Fourier slice", True

    def view_indices(self, rows: int, columns: int) -> ViewIndices:
        """Choose all views."""
        return every_view(rows, columns)

    def _refocus(self, views: Views, slopes: np.ndarray, block) -> np.ndarray:
        return average(fourier_slice(views, slopes, edges="clamp"), block)


def average(stack: np.ndarray, block: tuple[int, int]) -> np.ndarray:
    """Average images [n, t, s] or [n, t, s, channels] over blocks."""
    size = stack.shape[1] // block[0], stack.shape[2] // block[1]
    if stack.ndim == 3:
        return area_average(stack, size)
    return np.stack([area_average(stack[..., c], size) for c in range(stack.shape[3])], axis=-1)
