"""Light field of cells or nodes in space as a linear operator, with its exact adjoint.

A pixel's weights of the cells are the closed-form integral with which scenes are rendered
(`lf_flame.simulation.exact`), so that operator and simulation agree. Along each axis the weights
are a banded matrix K for each depth plane. The light field is the sum of ``Ky X Kx'`` over the
planes; the adjoint uses the transposed bands. An axisymmetric flame is cut into slabs, which are
seen as planes are.
"""

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import LinearOperator

from lf_flame._common.arrays import centred
from lf_flame.optics.camera import PlenopticCamera
from lf_flame.optics.lens import Lens
from lf_flame.optics.ray_bundle import trace_footprint
from lf_flame.scenes.scene import Layer
from lf_flame.simulation.exact import band_weights
from lf_flame.tomography.frustum_grid import FrustumGrid


class GridOperator(LinearOperator):
    """SciPy's linear operator, flat, with the shapes of its cells and of its views.

    `dims` is the shape of the grid, `dimsd` that of the data (v, u, t, s).
    """

    def __init__(self, dtype: str | np.dtype, dims: tuple[int, ...], dimsd: tuple[int, ...]):
        super().__init__(np.dtype(dtype), (int(np.prod(dimsd)), int(np.prod(dims))))
        self.dims, self.dimsd = dims, dimsd


class ProjectionOperator(GridOperator):
    """Linear operator from emission of cells, (plane, row, column), to the views that are fitted.

    Both are flattened for products.

    Parameters
    ----------
    grid : FrustumGrid
        Cells at the depth planes.
    dtype : {"float32", "float64"}, optional
        Type for storage and sums.
    finer : int, optional
        Number of parts along each axis into which the cells are divided.

    Examples
    --------
    >>> from dataclasses import replace
    >>> import numpy as np
    >>> from lf_flame import PAPER_CAMERA, render
    >>> from lf_flame.tomography import FrustumGrid
    >>> camera = replace(PAPER_CAMERA, views=5, lenslets=(32, 40))
    >>> grid = FrustumGrid(camera, [6.0, -6.0])

    >>> from lf_flame.tomography import ProjectionOperator
    >>> operator = ProjectionOperator(grid)
    >>> operator.dimsd, operator.dims == grid.shape
    ((5, 5, 32, 40), True)
    """

    def __init__(self, grid: FrustumGrid, dtype: str = "float32", *, finer: int = 1):
        planes, rows, columns = grid.shape
        dims = planes, finer * rows, finer * columns
        super().__init__(dtype, dims, grid.data_shape)
        self.grid = grid
        layers = [grid.empty_layer(plane, finer) for plane in range(planes)]
        down, self._across = (
            [layer_bands(one, grid.camera, grid.block, axis).astype(dtype) for one in layers]
            for axis in (0, 1)
        )
        self._down = sparse.hstack(down, format="csr")
        self._up = self._down.T.tocsr()
        self._back = [bands.T.tocsr() for bands in self._across]

    def _matvec(self, x: np.ndarray) -> np.ndarray:
        cells = x.reshape(self.dims).astype(self.dtype, copy=False)
        lines = [(bands @ plane.T).T for bands, plane in zip(self._across, cells, strict=True)]
        raw = self._down @ np.ascontiguousarray(np.concatenate(lines))
        return self.grid.pick(as_views(raw, self.grid.pixels)).ravel()

    def _rmatvec(self, y: np.ndarray) -> np.ndarray:
        raw = as_raw(self.grid.place(y.reshape(self.dimsd).astype(self.dtype, copy=False)))
        planes, rows, _ = self.dims
        lines = (self._up @ raw).reshape(planes, rows, -1)
        cells = [
            (bands @ np.ascontiguousarray(line.T)).T
            for bands, line in zip(self._back, lines, strict=True)
        ]
        return np.stack(cells).ravel()


class AxisymmetricOperator(GridOperator):
    """Linear operator from an axisymmetric flame's emission at nodes to views, float64.

    It maps emission, flattened (height, radius), in radiance per mm of the line of sight, to the
    views (v, u, t, s) that are fitted.

    Parameters
    ----------
    grid : AxisymmetricGrid

    Examples
    --------
    >>> from dataclasses import replace
    >>> from lf_flame import PAPER_CAMERA
    >>> from lf_flame.tomography import AxisymmetricGrid
    >>> camera = replace(PAPER_CAMERA, views=3, lenslets=(24, 40))
    >>> grid = AxisymmetricGrid(camera, axis_mm=0.0, depth_mm=0.0, radius_mm=1.5)

    >>> from lf_flame.tomography import AxisymmetricOperator
    >>> AxisymmetricOperator(grid).dims == grid.shape
    True
    """

    def __init__(self, grid):
        super().__init__("float64", grid.shape, grid.data_shape)
        self.grid = grid
        self._down = sparse.vstack([one.T for one in grid.by_height], format="csr")
        self._across = np.concatenate(list(grid.by_radius), axis=1)

    def _matvec(self, x: np.ndarray) -> np.ndarray:
        section = x.reshape(self.dims)
        lines = np.concatenate([one @ section for one in self.grid.by_height], axis=1)
        return self.grid.pick(as_views(lines @ self._across.T, self.dimsd[2:])).ravel()

    def _rmatvec(self, y: np.ndarray) -> np.ndarray:
        raw = as_raw(self.grid.place(y.reshape(self.dimsd)))
        heights, radii = self.dims
        slabs = len(self.grid.by_radius)
        lines = (self._down @ (raw @ self._across)).reshape(slabs, heights, slabs, radii)
        return np.einsum("khkr->hr", lines).ravel()


def as_raw(views: np.ndarray) -> np.ndarray:
    """Lay views (v, u, t, s) beside each other: one array with rows (v, t) and columns (u, s)."""
    v, u, t, s = views.shape
    return views.transpose(0, 2, 1, 3).reshape(v * t, u * s)


def as_views(raw: np.ndarray, pixels: tuple[int, ...]) -> np.ndarray:
    """Take the views (v, u, t, s) of such an array; `pixels` is (t, s)."""
    t, s = pixels
    return raw.reshape(-1, t, raw.shape[1] // s, s).transpose(0, 2, 1, 3)


def layer_bands(layer: Layer, camera: Lens, block: int, axis: int) -> sparse.csr_array:
    """Weight of each line of a layer's cells in each pixel's ray bundles, along one axis.

    float64, shape (views * pixels, cells), rows ``view * pixels + pixel``: means over lenslets.
    """
    start, weight = band_weights(layer.cell_edges_mm(axis), *_bundles(camera, layer, axis))
    views, lenslets, band = weight.shape
    pixels = lenslets // block
    rows = np.repeat(np.arange(views * pixels), block * band)
    columns = (start[..., None] + np.arange(band)).ravel()
    shape = (views * pixels, layer.texture.shape[axis])
    bands = sparse.coo_array((weight.ravel() / block, (rows, columns)), shape=shape)
    bands.sum_duplicates()
    bands.eliminate_zeros()
    return bands.tocsr()


def _bundles(camera: Lens, layer: Layer, axis: int) -> tuple[np.ndarray, float, float]:
    """Centres of all pixels' ray bundles on a layer, (views, lenslets), and widths of their boxes.

    Where only slope and scale are measured, the boxes are those of a lenslet and of a view's step:
    a pixel gathers light through the whole lenslet and a whole step of the pupil. A thin lens
    differs from that by the size of a lenslet beside the pupil.
    """
    if isinstance(camera, PlenopticCamera):
        traced = trace_footprint(camera, layer.depth_mm, axis)
        return traced.centres_mm, abs(traced.lenslet_width_mm), abs(traced.pixel_width_mm)
    side = camera.field_mm(layer.depth_mm)[axis] / camera.lenslets[axis]
    slope = camera.depth_to_slope(layer.depth_mm)
    places = centred(camera.lenslets[axis]) - slope * centred(camera.views)[:, None]
    return side * places, side, side * abs(slope)
