"""Refocusing by formula, as systems beside the learned ones."""

from collections.abc import Callable
from functools import partial

import numpy as np

from lf_flame._common.arrays import area_average
from lf_flame.refocus import (
    align_views,
    fourier_slice,
    round_aperture,
    shift_and_sum,
    sparse_aperture,
)
from lf_flame.systems.base import RefocusingSystem, ViewIndices
from lf_flame.systems.view_selection import every_view


class ShiftAndSum(RefocusingSystem):
    """Shift-and-sum of all or selected views.

    Parameters
    ----------
    name : str
        Name in tables.
    selection : callable, optional
        Function of the number of rows and columns of views; returns row and column of each view to
        use (`lf_flame.systems.view_selection`). Default: all views.

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

    def view_indices(self, rows: int, columns: int) -> ViewIndices:
        """Choose the views to use."""
        return self._selection(rows, columns)

    def _refocus(self, views: np.ndarray, slopes: np.ndarray, block) -> np.ndarray:
        indices = self.view_indices(*views.shape[:2])
        if max(block) > 1 and len(indices) < views.shape[0] * views.shape[1]:
            # Aligned directly into blocks: for few views faster than averaging images afterwards.
            return align_views(views, slopes, indices, block=block).mean(axis=1)
        weights = sparse_aperture(views.shape[:2], indices)
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

    name = "Fourier slice"

    def view_indices(self, rows: int, columns: int) -> ViewIndices:
        """Choose all views."""
        return every_view(rows, columns)

    def _refocus(self, views: np.ndarray, slopes: np.ndarray, block) -> np.ndarray:
        return average(REFERENCES["Fourier slice"](views, slopes), block)


def _in_round_aperture(views: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    return shift_and_sum(views, slopes, weights=round_aperture(views.shape[:2]))


REFERENCES: dict[str, Callable[..., np.ndarray]] = {
    "shift-and-sum": shift_and_sum,
    "Fourier slice": partial(fourier_slice, edges="clamp"),
    "round aperture": _in_round_aperture,
}
"""Reference images from all views, or from those in a round aperture, for systems that use fewer.
Apertures of cameras are nearly round; a square one blurs points to squares."""


def average(stack: np.ndarray, block: tuple[int, int]) -> np.ndarray:
    """Average images [n, t, s] or [n, t, s, channels] over blocks."""
    height, width = (n // m for n, m in zip(stack.shape[1:3], block, strict=True))
    size = height, width
    if stack.ndim == 3:
        return area_average(stack, size)
    return np.stack([area_average(stack[..., c], size) for c in range(stack.shape[3])], axis=-1)
