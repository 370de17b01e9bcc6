"""Absorption: slabs attenuate their own light and light from behind them.

The optical thickness must be given, because a light field alone cannot separate emission from
absorption. The convention is that of scenes (`lf_flame.scenes.Layer`): emission is the light that
would leave a slab without absorption. A slab's own matter transmits ``(1 - exp(-tau)) / tau`` of
it, with emission and absorption evenly mixed (Modest, Radiative Heat Transfer, chapter on the
equation of transfer; for thin slabs this is ``exp(-tau / 2)``, half the thickness). Each slab
nearer to the camera, at a smaller depth, transmits ``exp(-tau)`` of the rest.
"""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike, DTypeLike
from scipy import sparse

from lf_flame._common.arrays import as_numbers
from lf_flame._common.input_files import check_memory
from lf_flame.errors import InputError
from lf_flame.simulation.slabs import self_absorbed
from lf_flame.tomography.axisymmetric_grid import AxisymmetricGrid
from lf_flame.tomography.frustum_grid import FrustumGrid
from lf_flame.tomography.projection_operator import GridOperator, as_raw, as_views, layer_bands

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


class AbsorbingOperator(GridOperator):
    """Linear operator from emission, of cells or nodes, to attenuated views.

    A pixel's light from a slab is that of `ProjectionOperator` or `AxisymmetricOperator`, times the
    mean transmission of each nearer slab over the pixel's ray bundle. This is exact if emission or
    absorption is constant across a bundle.

    Parameters
    ----------
    grid : FrustumGrid or AxisymmetricGrid
    absorption : ndarray of float64, shape of the grid
        Optical thickness of cells, 0 or above (`spread_thickness`); absorption per mm at nodes.
    dtype : {"float32", "float64"}, optional
        Type for storage and sums; transmissions are multiplied in float64.
    """

    def __init__(
        self, grid: FrustumGrid | AxisymmetricGrid, absorption: np.ndarray, dtype: str = "float32"
    ):
        if absorption.shape != grid.shape or not np.all((absorption >= 0) & (absorption < np.inf)):
            raise InputError(
                f"The absorption must be finite, 0 or above, of the grid's shape {grid.shape}, got "
                f"shape {absorption.shape}, from {np.min(absorption)} to {np.max(absorption)}."
            )
        super().__init__(dtype, grid.shape, grid.data_shape)
        self._grid = grid
        self._slabs = _slabs(grid, self.dtype)  # nearest to the main lens first
        through = np.ones(self._slabs[0].raw_shape)
        one = through.size * self.dtype.itemsize
        count = len(self._slabs)
        check_memory(count * one, f"Transmissions of {count} slabs, as every view sees them,")
        for slab in self._slabs:
            slab.seen = through.astype(dtype)
            tau = slab.spread(absorption)
            slab.own = self_absorbed(tau).astype(dtype)
            # Outside the cells nothing absorbs.
            through = through * (1 + slab.views(np.expm1(-tau)))

    def _matvec(self, x: np.ndarray) -> np.ndarray:
        glow = x.reshape(self.dims).astype(self.dtype, copy=False)
        raw = sum(slab.seen * slab.views(slab.own * slab.spread(glow)) for slab in self._slabs)
        return self._grid.pick(as_views(np.asarray(raw, self.dtype), self.dimsd[2:])).ravel()

    def _rmatvec(self, y: np.ndarray) -> np.ndarray:
        raw = self._raw(y)
        return self._gather(lambda slab: slab.own * slab.back(slab.seen * raw)).ravel()

    def _raw(self, y: np.ndarray) -> np.ndarray:
        """Fitted views side by side, with 0 elsewhere."""
        return as_raw(self._grid.place(y.reshape(self.dimsd).astype(self.dtype, copy=False)))

    def _gather(self, light: Callable[["_Slab"], np.ndarray]) -> np.ndarray:
        gathered = np.zeros(self.dims, self.dtype)
        for slab in self._slabs:
            slab.gather(light(slab), gathered)
        return gathered

    def mean_transmission(self) -> np.ndarray:
        """Fraction of the light that leaves towards the camera, averaged over the views.

        It has the shape of the grid, and is 1 for cells or nodes that no view sees.
        """
        counted = self._raw(np.ones(self.dimsd, self.dtype))
        through = self._gather(lambda slab: slab.own * slab.back(slab.seen * counted))
        thin = self._gather(lambda slab: slab.back(counted))
        return np.divide(through, thin, out=np.ones(self.dims), where=thin > 0)


class _Slab:
    """Cells at one depth, and their light in all views side by side (`as_raw`)."""

    seen: np.ndarray  # transmission of everything nearer to the camera, for each pixel of each view
    own: np.ndarray  # fraction of the light of each cell that leaves the slab

    def __init__(
        self, bands: Sequence[sparse.csr_array], dtype: DTypeLike, plane: int = 0, section=None
    ):
        down, across = (one.astype(dtype) for one in bands)
        self._bands, self._back = (down, across), (down.T.tocsr(), across.T.tocsr())
        self.raw_shape = down.shape[0], across.shape[0]
        self._plane, self._section = plane, section

    def spread(self, values: np.ndarray) -> np.ndarray:
        """Values of a grid in the cells of this slab."""
        if self._section is None:
            return values[self._plane]
        heights, radii = self._section
        return (heights @ values) @ radii.T

    def gather(self, cells: np.ndarray, values: np.ndarray) -> None:
        """Add cells of this slab to the values of a grid: the adjoint of `spread`."""
        if self._section is None:
            values[self._plane] += cells
        else:
            heights, radii = self._section
            values += (heights.T @ cells) @ radii

    def views(self, cells: np.ndarray) -> np.ndarray:
        """Light of the cells, if nothing attenuates it."""
        return _apply(self._bands, cells)

    def back(self, raw: np.ndarray) -> np.ndarray:
        """Adjoint of `views`."""
        return _apply(self._back, raw)


def _apply(bands: Sequence[sparse.csr_array], plane: np.ndarray) -> np.ndarray:
    """Apply bands along both axes: ``down plane across'``."""
    down, across = bands
    return np.asarray(down @ np.ascontiguousarray((across @ plane.T).T))


def _slabs(grid: FrustumGrid | AxisymmetricGrid, dtype: DTypeLike) -> list[_Slab]:
    """Slabs of a grid, nearest to the main lens first."""
    if isinstance(grid, FrustumGrid):
        found = []
        for plane in np.argsort(grid.depths_mm):
            layer = grid.empty_layer(plane)
            down, across = (layer_bands(layer, grid.camera, grid.block, axis) for axis in (0, 1))
            found.append(_Slab((down, across), dtype, plane))
        return found
    return [
        _Slab(
            (grid.bands(depth, 0), grid.bands(depth, 1)),
            dtype,
            section=(grid.cells_by_height, grid.cells_by_radius(depth)),
        )
        for depth in sorted(grid.slab_depths_mm)
    ]


def spread_thickness(
    grid: FrustumGrid | AxisymmetricGrid, thickness: ArrayLike
) -> np.ndarray | None:
    """Spread a given absorption over the cells of a grid, or check it at nodes; None if 0.

    Cells outside the central view get the value of its nearest pixel.
    """
    given = as_numbers(thickness, "The optical thickness")
    shapes: tuple[tuple[int, ...], ...]
    if isinstance(grid, AxisymmetricGrid):
        shapes, names = (grid.shape,), f"numbers for {grid.shape[0]} x {grid.shape[1]} nodes"
    else:
        planes, (rows, columns) = grid.shape[0], grid.pixels
        shapes = (), (planes,), (planes, rows, columns)
        names = f"a number, or numbers for {planes} planes or their {rows} x {columns} pixels"
    if given.shape not in shapes:
        raise InputError(f"The optical thickness must be {names}, got shape {given.shape}.")
    if not np.isfinite(given).all() or given.min() < 0:
        raise InputError(
            f"The optical thickness must be finite, 0 or above, got {given.min()} to {given.max()}."
        )
    if isinstance(grid, AxisymmetricGrid):
        cells = given
    else:
        by_plane = np.full(planes, given / planes) if given.ndim == 0 else given
        shape = (planes, *(by_plane.shape[1:] or (1, 1)))
        cells = np.broadcast_to(by_plane.reshape(shape), (planes, rows, columns))
        cells = np.pad(cells, ((0, 0), (grid.reach,) * 2, (grid.reach,) * 2), mode="edge")
    total = total_thickness(grid, cells)
    if total > MOST_THICKNESS * (1 + 1e-9):
        raise InputError(
            f"The optical thickness must be at most {MOST_THICKNESS:g} in total, got {total:.3g}: "
            f"too little light from behind gets through."
        )
    return cells if total else None


def total_thickness(grid: FrustumGrid | AxisymmetricGrid, thickness: np.ndarray) -> float:
    """Largest total of an optical thickness along a ray, or along a diameter of a section."""
    if isinstance(grid, FrustumGrid):
        return float(thickness.sum(axis=0).max())
    # A diameter crosses all nodes twice but the one on the axis.
    return float((2 * thickness.sum(axis=1) - thickness[:, 0]).max() * grid.step_mm)


class Absorption:
    """Effect of absorption on a light field, as a correction to a fit without absorption.

    If every view saw the mean transmission over the views, a fit in which light only adds up would
    explain the light field by emission times that mean. Single views differ from this, because they
    see more or less absorption. The difference is small; it is subtracted from the light field
    before a fit, estimated again from that fit, and so on (deferred correction; Stetter, Numer.
    Math. 29, 425, 1978). `transmission` is the fraction of each cell's emission that leaves.
    """

    def __init__(self, even: GridOperator, grid, absorption: np.ndarray):
        self._even = even
        self._absorbing = AbsorbingOperator(grid, absorption, even.dtype)
        self.transmission = self._absorbing.mean_transmission().astype(even.dtype)

    def excess(self, leaving: np.ndarray) -> np.ndarray:
        """Difference of the views from those with the mean transmission, shape (v, u, t, s)."""
        light = leaving.ravel().astype(self._even.dtype, copy=False)
        emission = light / self.transmission.ravel()
        more = self._absorbing.matvec(emission) - self._even.matvec(light)
        return more.reshape(self._even.dimsd).astype(np.float32, copy=False)

    def settle(self, views: np.ndarray, fit: Callable, start=None, most: int = MOST_FITS):
        """Fit, correct the light field, and fit again until the correction converges.

        `fit` maps a light field without absorption, and None or the last fit, to keep its strength,
        to the light that leaves each cell. Returns the last fit, and whether the correction
        converged, or only one fit was allowed.
        """
        correction = np.zeros_like(views) if start is None else self.excess(start.cells)
        found, fits = fit(views - correction, None), 1
        while True:
            excess = self.excess(found.cells)
            if most == 1 or _norm(excess - correction) <= SETTLED * _norm(views):
                return found, True
            if fits == most:
                return found, False
            correction = excess
            found, fits = fit(views - correction, found if fits >= SEARCHES else None), fits + 1


def _norm(values: np.ndarray) -> float:
    return float(np.sqrt(np.sum(np.square(values, dtype=np.float64))))
