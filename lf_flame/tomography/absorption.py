"""Absorption: depth planes attenuate their own light and light from behind them.

The optical thickness must be given, because a light field alone cannot separate emission from
absorption. The convention is that of scenes (`lf_flame.scenes.Layer`): emission is the light that
would leave a depth plane without absorption. A plane's own matter transmits ``(1 - exp(-tau)) /
tau`` of it, with emission and absorption evenly mixed (Modest, Radiative Heat Transfer, chapter on
the equation of transfer; for thin planes this is ``exp(-tau / 2)``, half the thickness). Each plane
nearer to the camera, at a smaller depth, transmits ``exp(-tau)`` of the rest.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, DTypeLike
from pylops import Diagonal, LinearOperator
from scipy import sparse

from lf_flame._common.memory import check_memory
from lf_flame.errors import InputError
from lf_flame.simulation.slabs import self_absorbed
from lf_flame.tomography.explanation import Explanation
from lf_flame.tomography.frustum_grid import FrustumGrid
from lf_flame.tomography.projection_operator import (
    ProjectionOperator,
    as_raw,
    as_views,
    plane_bands,
)

MOST_THICKNESS = 2.0
"""Largest total optical thickness along a ray of the central view. A seventh of the light from
behind remains; an error of 5 % in the thickness then changes that light by 10 %."""

SETTLED = 1e-4
"""Relative change of the correction, in light fields, at which the iteration ends: emission then
changes by about 1e-3. At a thickness of 0.5, each fit leaves about a tenth of the change."""

MOST_FITS = 12
"""Largest number of fits; if the correction still changes, there is a warning."""

SEARCHES = 2
"""Number of fits that choose the strength of the regularisation. The noise of the first fit still
contains the effect of absorption on single views; from the third on, a change of strength would
keep the rest from converging."""

Bands = tuple[sparse.csr_array, sparse.csr_array]
"""Bands of a depth plane, along y and along x: see `plane_bands`."""


class AbsorbingOperator(LinearOperator):
    """Linear operator from the emission of cells to attenuated views.

    It maps emission, flattened (plane, row, column), to views (v, u, t, s). A pixel's light from a
    depth plane is that of `ProjectionOperator`, times the mean transmission of each nearer plane
    over the pixel's ray bundle. This is exact if emission or absorption is constant across a
    bundle.

    Parameters
    ----------
    grid : FrustumGrid
        Cells at the depth planes.
    thickness : ndarray of float64, shape (planes, rows, columns)
        Optical thickness of the grid's cells, 0 or above: see `spread_thickness`.
    dtype : {"float32", "float64"}, optional
        Type for storage and sums; transmissions are multiplied in float64.

    Raises
    ------
    InputError
        If the type or the shape is another one, or the transmissions would exceed the memory
        limit.

    Examples
    --------
    >>> from dataclasses import replace
    >>> import numpy as np
    >>> from lf_flame import PAPER_CAMERA, render
    >>> from lf_flame.tomography import FrustumGrid
    >>> camera = replace(PAPER_CAMERA, views=5, lenslets=(32, 40))
    >>> grid = FrustumGrid(camera, [6.0, -6.0])

    >>> from lf_flame.tomography import AbsorbingOperator, ProjectionOperator
    >>> thickness = np.zeros(grid.shape)
    >>> dimmed = AbsorbingOperator(grid, thickness)
    >>> light = np.ones(grid.shape, np.float32).ravel()
    >>> bool(np.allclose(dimmed @ light, ProjectionOperator(grid) @ light, rtol=1e-5))
    True
    """

    def __init__(self, grid: FrustumGrid, thickness: np.ndarray, dtype: str = "float32"):
        if np.dtype(dtype) not in (np.float32, np.float64):
            raise InputError(f"dtype must be float32 or float64, got {dtype}.")
        if thickness.shape != grid.shape:
            raise InputError(
                f"The optical thickness must be of the grid's shape {grid.shape}, got "
                f"{thickness.shape}."
            )
        super().__init__(dtype=np.dtype(dtype), dims=grid.shape, dimsd=grid.data_shape)
        self._grid = grid
        planes, views = grid.shape[0], grid.camera.views
        one = views**2 * int(np.prod(grid.pixels)) * self.dtype.itemsize
        check_memory(planes * one, f"Transmissions of {planes} planes, as every view sees them,")
        exact = [(plane_bands(grid, p, 0), plane_bands(grid, p, 1)) for p in range(planes)]
        self._own = self_absorbed(thickness).astype(dtype)
        self._slabs = [Slab(bands, self.dtype) for bands in exact]
        through = np.ones(self._slabs[0].raw_shape)
        for plane in np.argsort(grid.depths_mm):  # nearest to the main lens first
            self._slabs[plane].seen = through.astype(dtype)
            through = through * _apply(exact[plane], np.exp(-thickness[plane]))

    def _matvec(self, x: np.ndarray) -> np.ndarray:
        glow = self._own * x.reshape(self.dims).astype(self.dtype, copy=False)
        raw = sum(
            slab.seen * slab.views(plane) for slab, plane in zip(self._slabs, glow, strict=True)
        )
        return self._grid.pick(as_views(np.asarray(raw), self._grid.pixels)).ravel()

    def _rmatvec(self, y: np.ndarray) -> np.ndarray:
        raw = self._raw(y)
        return (self._own * np.stack([slab.back(slab.seen * raw) for slab in self._slabs])).ravel()

    def _raw(self, y: np.ndarray) -> np.ndarray:
        """Fitted views beside each other, with 0 elsewhere."""
        return as_raw(self._grid.place(y.reshape(self.dimsd).astype(self.dtype, copy=False)))

    def mean_transmission(self) -> np.ndarray:
        """Fraction of each cell's light that leaves towards the camera, averaged over the views.

        Returns
        -------
        ndarray of float64, shape (planes, rows, columns)
            Mean transmission, above 0, at most 1; the plane's own factor where no view sees a cell.
        """
        means, counted = [], self._raw(np.ones(self.dimsd, self.dtype))
        for slab in self._slabs:
            weight = slab.back(counted).astype(np.float64)
            through = slab.back(slab.seen * counted)
            means.append(np.divide(through, weight, out=np.ones_like(weight), where=weight > 0))
        return self._own * np.stack(means)


class Slab:
    """Cells at one depth, and their light in all views beside each other (`as_raw`).

    Attributes
    ----------
    seen : ndarray, shape (views * rows, views * columns)
        Transmission of everything nearer to the camera, for each pixel of each view.
    """

    seen: np.ndarray

    def __init__(self, bands: Bands, dtype: DTypeLike):
        down, across = (one.astype(dtype) for one in bands)
        self._bands, self._back = (down, across), (down.T.tocsr(), across.T.tocsr())
        self.raw_shape = down.shape[0], across.shape[0]

    def views(self, cells: np.ndarray) -> np.ndarray:
        """Light of the cells, if nothing attenuates it."""
        return _apply(self._bands, cells)

    def back(self, raw: np.ndarray) -> np.ndarray:
        """Adjoint of `views`."""
        return _apply(self._back, raw)


def _apply(bands: Bands, plane: np.ndarray) -> np.ndarray:
    """Apply bands along both axes: ``down plane across'``."""
    down, across = bands
    return np.asarray(down @ np.ascontiguousarray((across @ plane.T).T))


def spread_thickness(grid: FrustumGrid, thickness: ArrayLike) -> np.ndarray:
    """Spread a given optical thickness over the cells of a grid.

    Parameters
    ----------
    grid : FrustumGrid
    thickness : float, or array_like of shape (planes,) or (planes, rows, columns)
        Optical thickness: a number is the total, spread evenly over the depth planes; an array has
        a value for each plane, or for each plane and pixel of the central view. Cells outside the
        central view get the value of its nearest pixel.

    Returns
    -------
    ndarray of float64, shape (planes, rows, columns)
        Optical thickness of all cells of the grid.

    Raises
    ------
    InputError
        If the shape is another one, or a value is not finite, below 0, or above `MOST_THICKNESS`
        in total.
    """
    given = np.asarray(thickness)
    planes, (rows, columns) = grid.shape[0], grid.pixels
    if given.dtype.kind not in "iuf" or given.shape not in ((), (planes,), (planes, rows, columns)):
        raise InputError(
            f"The optical thickness must be a number, or numbers for {planes} planes or for "
            f"{planes} planes of {rows} x {columns} pixels, got shape {given.shape} of type "
            f"{given.dtype}."
        )
    given = given.astype(np.float64)
    if not np.isfinite(given).all() or given.min() < 0:
        raise InputError(
            f"The optical thickness must be finite, 0 or above, got values from {given.min()} to "
            f"{given.max()}."
        )
    by_plane = np.full(planes, given / planes) if given.ndim == 0 else given
    total = float(by_plane.sum(axis=0).max())
    if total > MOST_THICKNESS:
        raise InputError(
            f"The optical thickness must be at most {MOST_THICKNESS:g} in total, got {total:.3g}: "
            f"of what lies behind, too little light is left."
        )
    cells = np.broadcast_to(
        by_plane.reshape(planes, *(by_plane.shape[1:] or (1, 1))), (planes, rows, columns)
    )
    margin = (grid.reach, grid.reach)
    return np.pad(cells, ((0, 0), margin, margin), mode="edge")


class Absorption:
    """Effect of absorption on a light field, as a correction to a fit without absorption.

    If every view saw the mean transmission over the views, a fit in which light only adds up would
    explain the light field by emission times that mean. Single views differ from this by their
    more or less absorption. The difference is small; it is subtracted from the light field before a
    fit, estimated again from that fit, and so on (deferred correction; Stetter, Numer. Math. 29,
    425, 1978).

    Parameters
    ----------
    operator : ProjectionOperator
        Operator without absorption, float32.
    grid : FrustumGrid
    thickness : ndarray of float64, shape (planes, rows, columns)
        Optical thickness of the grid's cells.

    Attributes
    ----------
    transmission : ndarray of float32, shape (planes, rows, columns)
        Fraction of each cell's emission that leaves towards the camera, averaged over the views.
    operator : LinearOperator
        Operator from the light that leaves each cell to the attenuated views, both flat.
    """

    def __init__(self, operator: ProjectionOperator, grid: FrustumGrid, thickness: np.ndarray):
        self._even = operator
        absorbing = AbsorbingOperator(grid, thickness)
        self.transmission = absorbing.mean_transmission().astype(np.float32)
        self.operator = absorbing @ Diagonal(1 / self.transmission.ravel(), dtype="float32")

    def excess(self, leaving: np.ndarray) -> np.ndarray:
        """Difference of the views from those with the mean transmission, shape (v, u, t, s)."""
        light = leaving.ravel()
        more = self.operator.matvec(light) - self._even.matvec(light)
        return more.reshape(self._even.dimsd)

    def settle(
        self,
        views: np.ndarray,
        fit: Callable[[np.ndarray, Explanation | None], Explanation],
        start: Explanation | None = None,
    ) -> tuple[Explanation, bool]:
        """Fit, correct the light field, and fit again until the correction converges.

        Parameters
        ----------
        views : ndarray of float32, shape (v, u, t, s)
        fit : callable
            Function from a light field without absorption to the light that leaves each cell. Its
            second argument is None, or the last fit, to keep its strength.
        start : Explanation, optional
            Fit of a similar light field, from which the first correction follows.

        Returns
        -------
        found : Explanation
            Result of the last fit.
        settled : bool
            Whether the correction converged.
        """
        correction = np.zeros_like(views) if start is None else self.excess(start.cells)
        found, fits = fit(views - correction, None), 1
        while True:
            excess = self.excess(found.cells)
            if _norm(excess - correction) <= SETTLED * _norm(views):
                return found, True
            if fits == MOST_FITS:
                return found, False
            correction = excess
            found, fits = fit(views - correction, found if fits >= SEARCHES else None), fits + 1


def _norm(values: np.ndarray) -> float:
    return float(np.sqrt(np.sum(np.square(values, dtype=np.float64))))
