"""Absorption by an axisymmetric flame: its slabs attenuate their own light and that from behind."""

import numpy as np
from pylops import LinearOperator

from lf_flame._common.memory import check_memory
from lf_flame.errors import InputError
from lf_flame.simulation.slabs import self_absorbed
from lf_flame.tomography.absorption import Slab
from lf_flame.tomography.axisymmetric.grid import AxisymmetricGrid
from lf_flame.tomography.projection_operator import as_raw, as_views


class AbsorbingSection(LinearOperator):
    """Linear operator from emission at nodes to attenuated views.

    It maps emission, flattened (height, radius), in radiance per mm of the line of sight, to views
    (v, u, t, s). The light of a slab is that of `AxisymmetricOperator`, times the mean transmission
    of each nearer slab over the pixel's ray bundle, as in
    `lf_flame.tomography.absorption.AbsorbingOperator`.

    Parameters
    ----------
    grid : AxisymmetricGrid
    absorption : ndarray, shape (heights, radii)
        Absorption coefficient at the nodes, per mm, 0 or above.

    Raises
    ------
    InputError
        If the absorption has another shape, is below 0 or not finite, or the transmissions would
        exceed the memory limit.

    Examples
    --------
    >>> from dataclasses import replace
    >>> import numpy as np
    >>> from lf_flame import PAPER_CAMERA
    >>> from lf_flame.tomography import AbsorbingSection, AxisymmetricGrid
    >>> camera = replace(PAPER_CAMERA, views=3, lenslets=(24, 40))
    >>> grid = AxisymmetricGrid(camera, axis_mm=0.0, depth_mm=0.0, radius_mm=1.5)
    >>> glow = np.ones(grid.shape)
    >>> clear, dim = AbsorbingSection(grid, 0 * glow), AbsorbingSection(grid, 0.3 * glow)
    >>> light = [(one @ glow.ravel()).reshape(3, 3, 24, 40)[1, 1, 12, 20] for one in (clear, dim)]
    >>> bool(0.6 < light[1] / light[0] < 0.7)  # (1 - exp(-tau)) / tau with tau = 0.9
    True
    """

    def __init__(self, grid: AxisymmetricGrid, absorption: np.ndarray):
        absorption = np.asarray(absorption, float)
        if absorption.shape != grid.shape:
            raise InputError(
                f"The absorption must be of the grid's shape {grid.shape}, got {absorption.shape}."
            )
        if not np.isfinite(absorption).all() or absorption.min() < 0:
            raise InputError(
                f"The absorption must be finite, 0 or above, got values from {absorption.min()} to "
                f"{absorption.max()} per mm."
            )
        super().__init__(dtype=np.dtype(float), dims=grid.shape, dimsd=grid.view_shape)
        self._grid = grid
        self._heights = grid.cells_by_height
        self._slabs = [_Slab(grid, depth) for depth in grid.slab_depths_mm]
        through = np.ones(self._slabs[0].raw_shape)
        count = len(self._slabs)
        check_memory(
            count * through.size * 4, f"Transmissions of {count} slabs, as every view sees them,"
        )
        for slab in reversed(self._slabs):  # nearest to the main lens first
            slab.seen = through.astype(np.float32)
            tau = self._spread(absorption, slab)
            slab.own = self_absorbed(tau)
            # Beside the cells nothing absorbs.
            through = through * (1 + slab.views(np.expm1(-tau)))

    def _spread(self, section: np.ndarray, slab: "_Slab") -> np.ndarray:
        """Integrate nodes over a slab, shape (rows, columns) of its cells."""
        return (self._heights @ section) @ slab.radii.T

    def _matvec(self, x: np.ndarray) -> np.ndarray:
        section = x.reshape(self.dims)
        raw = sum(
            slab.seen * slab.views(slab.own * self._spread(section, slab)) for slab in self._slabs
        )
        return self._grid.pick(as_views(np.asarray(raw), self.dimsd[2:])).ravel()

    def _rmatvec(self, y: np.ndarray) -> np.ndarray:
        raw = self._raw(y)
        section = np.zeros(self.dims)
        for slab in self._slabs:
            cells = slab.own * slab.back(slab.seen * raw)
            section += (self._heights.T @ cells) @ slab.radii
        return section.ravel()

    def _raw(self, y: np.ndarray) -> np.ndarray:
        """Fitted views beside each other, with 0 elsewhere."""
        return as_raw(self._grid.place(y.reshape(self.dimsd)))

    def mean_transmission(self) -> np.ndarray:
        """Fraction of each node's light that leaves towards the camera, averaged over its rays.

        Returns
        -------
        ndarray of float64, shape (heights, radii)
            Mean transmission, above 0, at most 1; 1 where no view sees a node.
        """
        ones = np.ones(self.dimsd)
        through = self.rmatvec(ones.ravel()).reshape(self.dims)
        thin, counted = np.zeros(self.dims), self._raw(ones)
        for slab in self._slabs:
            thin += (self._heights.T @ slab.back(counted)) @ slab.radii
        return np.divide(through, thin, out=np.ones(self.dims), where=thin > 0)


class _Slab(Slab):
    """Cells of a slab of a flame."""

    own: np.ndarray

    def __init__(self, grid: AxisymmetricGrid, depth: float):
        super().__init__((grid.bands(depth, 0), grid.bands(depth, 1)), float)
        self.radii = grid.cells_by_radius(depth)
