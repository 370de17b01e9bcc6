"""Light that is absorbed on its way: planes dim themselves and what lies behind them.

The optical thickness is given, for a light field alone does not tell emission from absorption. The
convention is that of scenes (`lf_flame.scenes.Layer`): emission is what would leave a plane if
nothing were absorbed. Of that a plane's own matter lets ``(1 - exp(-tau)) / tau`` out, emission and
absorption being evenly mixed within it (Modest, Radiative Heat Transfer, chapter on the equation of
transfer; for thin planes that is ``exp(-tau / 2)``, half of its thickness), and each plane nearer
to the camera, which is at a smaller depth, lets ``exp(-tau)`` of the rest through.
"""

from collections.abc import Callable
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import ArrayLike
from pylops import LinearOperator
from scipy import sparse

from lf_flame._common.memory import check_memory
from lf_flame.errors import InputError
from lf_flame.simulation.slabs import self_absorbed
from lf_flame.tomography.frustum_grid import FrustumGrid
from lf_flame.tomography.projection_operator import ProjectionOperator, plane_bands

MOST_THICKNESS = 2.0
"""Total along a ray of the central view. Of light from behind it a seventh is left; an error of the
thickness by a twentieth is then one of that light by a tenth."""

SETTLED = 1e-4
"""Change of the correction, relative to the light field, below which it stands: emission then
changes by some 1e-3. Each fit leaves about a tenth of the change at a thickness of 0.5."""

MOST_FITS = 12
"""Fits after which a correction that still changes is given up, with a warning."""

SEARCHES = 2
"""Fits that choose the strength of their penalty. The first one's noise still holds what
absorption does to single views; from the third on, a strength that changed would keep the rest from
settling."""

Bands = tuple[sparse.csr_array, sparse.csr_array]
"""Of a plane, along y and along x: see `plane_bands`."""


class AbsorbingOperator(LinearOperator):
    """From the emission of cells, flattened (plane, row, column), to views (v, u, t, s), dimmed.

    A pixel's light from a plane is that of `ProjectionOperator`, times the mean transmission of
    each nearer plane over the pixel's ray bundle. That is exact where what glows or what absorbs is
    even across a bundle.

    Parameters
    ----------
    grid : FrustumGrid
    thickness : ndarray of float64, shape (planes, rows, columns)
        Optical thickness of the grid's cells, 0 or above: see `spread_thickness`.
    dtype : {"float32", "float64"}, optional
        In which all is stored and summed; transmissions are multiplied in float64.

    Raises
    ------
    InputError
        If the type is another, the shape is not the grid's, or the transmissions would take more
        memory than is allowed.

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
        views = grid.camera.views
        super().__init__(dtype=np.dtype(dtype), dims=grid.shape, dimsd=(views, views, *grid.pixels))
        planes = grid.shape[0]
        one = int(np.prod(self.dimsd)) * self.dtype.itemsize
        check_memory(planes * one, f"Transmissions of {planes} planes, as every view sees them,")
        exact = [(plane_bands(grid, p, 0), plane_bands(grid, p, 1)) for p in range(planes)]
        self._seen = _seen_through(grid, exact, thickness, self.dtype)
        self._own = self_absorbed(thickness).astype(dtype)
        self._bands = [(down.astype(dtype), across.astype(dtype)) for down, across in exact]
        self._back = [(down.T.tocsr(), across.T.tocsr()) for down, across in self._bands]

    def _matvec(self, x: np.ndarray) -> np.ndarray:
        glow = self._own * x.reshape(self.dims).astype(self.dtype, copy=False)
        v, u, t, s = self.dimsd
        raw = np.zeros((v * t, u * s), self.dtype)
        for bands, plane, seen in zip(self._bands, glow, self._seen, strict=True):
            raw += seen * _apply(bands, plane)
        return raw.reshape(v, t, u, s).transpose(0, 2, 1, 3).ravel()

    def _rmatvec(self, y: np.ndarray) -> np.ndarray:
        views = y.reshape(self.dimsd).astype(self.dtype, copy=False)
        v, u, t, s = self.dimsd
        raw = views.transpose(0, 2, 1, 3).reshape(v * t, u * s)
        cells = [
            _apply(back, seen * raw) for back, seen in zip(self._back, self._seen, strict=True)
        ]
        return (self._own * np.stack(cells)).ravel()

    def mean_transmission(self) -> np.ndarray:
        """Share of each cell's light that leaves towards the camera, the mean over the views.

        Returns
        -------
        ndarray of float64, shape (planes, rows, columns)
            Above 0, at most 1; the plane's own share where no view sees a cell.
        """
        means = []
        for back, seen in zip(self._back, self._seen, strict=True):
            weight = _apply(back, np.ones_like(seen)).astype(np.float64)
            through = _apply(back, seen)
            means.append(np.divide(through, weight, out=np.ones_like(weight), where=weight > 0))
        return self._own * np.stack(means)


def _apply(bands: Bands, plane: np.ndarray) -> np.ndarray:
    """Apply bands along both axes: ``down plane across'``."""
    down, across = bands
    return np.asarray(down @ np.ascontiguousarray((across @ plane.T).T))


def _seen_through(
    grid: FrustumGrid, bands: list[Bands], thickness: np.ndarray, dtype: np.dtype
) -> list[np.ndarray]:
    """Transmission of all that is nearer than each plane, for each pixel of each view.

    Returns
    -------
    list of ndarray, shape (views * rows, views * columns)
        By plane, in the grid's order.
    """
    seen: dict[int, np.ndarray] = {}
    through = np.ones([pair.shape[0] for pair in bands[0]])
    for plane in np.argsort(grid.depths_mm):  # nearest to the main lens first
        seen[plane] = through.astype(dtype)
        through = through * _apply(bands[plane], np.exp(-thickness[plane]))
    return [seen[plane] for plane in range(len(bands))]


def spread_thickness(grid: FrustumGrid, thickness: ArrayLike) -> np.ndarray:
    """Lay a given optical thickness on the cells of a grid.

    Parameters
    ----------
    grid : FrustumGrid
    thickness : float, or array_like of shape (planes,) or (planes, rows, columns)
        A number is the total, spread evenly over the planes; else that of each plane, even across
        it, or by the central view's pixels. What the central view does not see is taken to be as
        the nearest pixel that it does.

    Returns
    -------
    ndarray of float64, shape (planes, rows, columns)
        On all of the grid's cells.

    Raises
    ------
    InputError
        If the shape is another, or a value is not finite, below 0, or above `MOST_THICKNESS` in
        total.
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


class Explained(Protocol):
    """What a fit found."""

    @property
    def cells(self) -> np.ndarray:
        """Of shape (planes, rows, columns)."""
        ...


Found = TypeVar("Found", bound=Explained)


class Absorption:
    """What absorption makes of a light field, as a correction to one without.

    Emission as it leaves towards the camera, dimmed by the mean over the views, explains the light
    field as if light only added up; views differ from it by what each sees absorbed more or less
    than their mean. That difference is small, and is taken off the light field before a fit; the
    fit tells it better, and so on (a deferred correction; Stetter, Numer. Math. 29, 425, 1978).

    Parameters
    ----------
    operator : ProjectionOperator
        Without absorption, of float32.
    grid : FrustumGrid
    thickness : ndarray of float64, shape (planes, rows, columns)
        Of the grid's cells.

    Attributes
    ----------
    transmission : ndarray of float32, shape (planes, rows, columns)
        Share of each cell's emission that leaves towards the camera, the mean over the views.
    """

    def __init__(self, operator: ProjectionOperator, grid: FrustumGrid, thickness: np.ndarray):
        self._even = operator
        self._absorbing = AbsorbingOperator(grid, thickness)
        self.transmission = self._absorbing.mean_transmission().astype(np.float32)

    def seen(self, leaving: np.ndarray) -> np.ndarray:
        """Give the light field of what leaves each cell, shape (v, u, t, s)."""
        emission = leaving / self.transmission
        return self._absorbing.matvec(emission.ravel()).reshape(self._absorbing.dimsd)

    def excess(self, leaving: np.ndarray) -> np.ndarray:
        """Give what the views hold beyond what they would if all saw the mean; (v, u, t, s)."""
        even = self._even.matvec(leaving.ravel())
        return self.seen(leaving) - even.reshape(self._absorbing.dimsd)

    def settle(
        self, views: np.ndarray, fit: Callable[[np.ndarray, Found | None], Found]
    ) -> tuple[Found, bool]:
        """Fit, correct the light field, and fit again until the correction stands.

        Parameters
        ----------
        views : ndarray of float32, shape (v, u, t, s)
        fit : callable
            From a light field without absorption to what leaves each cell. Its second argument is
            None, or the last fit, whose strength is to be kept.

        Returns
        -------
        found : object
            Of the last fit.
        settled : bool
        """
        correction = np.zeros_like(views)
        found, fits = fit(views, None), 1
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
