"""Refocusing by formula, as systems beside the learned ones."""

from collections.abc import Callable
from functools import partial

import numpy as np

from lf_flame.encodings import area_average, spread
from lf_flame.errors import InputError
from lf_flame.refocus import align_views, fourier_slice, shift_and_sum, sparse_aperture
from lf_flame.systems.system import Places, RefocusingSystem


class ShiftAndSum(RefocusingSystem):
    """Shift-and-sum of all views, or of some.

    Parameters
    ----------
    name : str
    places : callable, optional
        Takes rows and columns of views, gives those that are used. Default: all.
    """

    def __init__(self, name: str = "shift-and-sum", places: Callable[..., Places] | None = None):
        self.name, self._places = name, places or every_view

    def chosen(self, rows: int, columns: int) -> Places:
        """Choose the views that are used."""
        return self._places(rows, columns)

    def _refocus(self, views: np.ndarray, slopes: np.ndarray, block) -> np.ndarray:
        places = self.chosen(*views.shape[:2])
        if max(block) > 1 and len(places) < views.shape[0] * views.shape[1]:
            # Aligned straight into blocks: for few views faster than to average images afterwards.
            return align_views(views, slopes, places, block).mean(axis=1)
        weights = sparse_aperture(views.shape[:2], places)
        return average(shift_and_sum(views, slopes, weights=weights), block)


class FourierSlice(RefocusingSystem):
    """A slice through the spectrum of the light field (R. Ng, SIGGRAPH 2005)."""

    name = "Fourier slice"

    def chosen(self, rows: int, columns: int) -> Places:
        """Choose all views."""
        return every_view(rows, columns)

    def _refocus(self, views: np.ndarray, slopes: np.ndarray, block) -> np.ndarray:
        return average(TRUTHS["Fourier slice"](views, slopes), block)


TRUTHS = {
    "shift-and-sum": shift_and_sum,
    "Fourier slice": partial(fourier_slice, edges="clamp"),
}
"""What all views together give: what is right, by two names."""


def average(stack: np.ndarray, block: tuple[int, int]) -> np.ndarray:
    """Average images [n, t, s] or [n, t, s, channels] over blocks."""
    size = [n // m for n, m in zip(stack.shape[1:3], block, strict=True)]
    if stack.ndim == 3:
        return area_average(stack, size)
    return np.stack([area_average(stack[..., c], size) for c in range(stack.shape[3])], axis=-1)


def every_view(rows: int, columns: int) -> Places:
    """List all views."""
    return [(v, u) for v in range(rows) for u in range(columns)]


def square_of_views(rows: int, columns: int, side: int = 3) -> Places:
    """Choose the views in the middles of side x side equal parts of the aperture."""
    _need_square(rows, columns, side)
    return [(v, u) for v in middles(rows, side) for u in middles(columns, side)]


def outer_square_of_views(rows: int, columns: int, side: int) -> Places:
    """Choose side x side views, spread from the first to the last."""
    _need_square(rows, columns, side)
    return [(v, u) for v in spread(rows, side) for u in spread(columns, side)]


def _need_square(rows: int, columns: int, side: int) -> None:
    if min(rows, columns) < side:
        raise InputError(f"{side} x {side} views are needed, got {rows} x {columns}.")


def cross_of_views(rows: int, columns: int, arm: int = 4) -> Places:
    """Choose the middle row and the middle column, 2 arm + 1 views of each, spread out.

    With arm 4 these are 17 of 81 views (Samarakoon et al., arXiv 2502.19238).
    """
    need = 2 * arm + 1
    if min(rows, columns) < need:
        raise InputError(f"A cross of {need} views each way is needed, got {rows} x {columns}.")
    down, across = spread(rows, need), spread(columns, need)
    middle = down[arm], across[arm]
    return [(v, middle[1]) for v in down] + [(middle[0], u) for u in across if u != middle[1]]


def lattice_of_views(rows: int, columns: int) -> Places:
    """Choose nine views of which no two share a row or a column, evenly over the aperture.

    They are the nodes of a rank-1 lattice, (k, 2k modulo 9) (I. H. Sloan, S. Joe, "Lattice Methods
    for Multiple Integration", Oxford 1994): seen along a row or along a column, there are nine
    places at which to sample the aperture, where 3 x 3 views have but three. The ghosts of an edge
    stand three times as close.
    """
    if min(rows, columns) < LATTICE:
        raise InputError(
            f"The lattice needs {LATTICE} x {LATTICE} views or more, got {rows} x {columns}."
        )
    down, across = (middles(n, LATTICE) for n in (rows, columns))
    half = LATTICE // 2
    return [(down[(2 * (k - half) + half) % LATTICE], across[k]) for k in range(LATTICE)]


LATTICE = 9


def middles(count: int, parts: int) -> list[int]:
    """Find the views nearest to the middles of equal parts of the aperture."""
    return np.floor((np.arange(parts) + 0.5) * count / parts).astype(int).tolist()
