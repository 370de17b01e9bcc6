"""Light field of cells or nodes in space as a linear operator, with its exact adjoint.

A pixel's weights of the cells are the closed-form integral with which scenes are rendered
(`lf_flame.simulation.integration`), so that operator and simulation agree. The cells of a plane
grow with their distance as pixels do, so that a view sees a plane by the same few weights at every
pixel: the light field is a sum of short convolutions along both axes, the adjoint with the same
weights. A round flame is cut into slabs; their weights are banded matrices K: ``Ky X Kx'`` each.
"""

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import LinearOperator

from lf_flame._common.arrays import centred
from lf_flame._common.threads import parallel, without_refcounts
from lf_flame.optics.camera import PlenopticCamera
from lf_flame.optics.lens import Lens
from lf_flame.optics.ray_bundle import trace_footprint
from lf_flame.scenes.scene import Layer
from lf_flame.simulation.integration import band_weights
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
        super().__init__(dtype, (planes, finer * rows, finer * columns), grid.data_shape)
        self.grid, self._finer = grid, finer
        self._down, self._across = (plane_taps(grid, axis, finer).astype(dtype) for axis in (0, 1))

    def _matvec(self, x: np.ndarray) -> np.ndarray:
        planes, rows, columns = self.dims
        cells = x.reshape(planes, rows, -1, self._finer).swapaxes(2, 3)
        cells = np.ascontiguousarray(cells, self.dtype).reshape(self.dims)
        views = np.empty((self.grid.camera.views,) * 2 + self.grid.pixels, self.dtype)
        _see_rows(cells, cells.ravel(), self._down, self._across, self._finer, views, views.ravel())
        return self.grid.pick(views).ravel()

    def _rmatvec(self, y: np.ndarray) -> np.ndarray:
        views = self.grid.place(y.reshape(self.dimsd).astype(self.dtype, copy=False))
        views, (planes, rows, columns) = np.ascontiguousarray(views), self.dims
        lines = np.zeros((views.shape[0] * views.shape[2], planes * columns), self.dtype)
        _gather_columns(views, views.ravel(), self._across, self._finer, lines, lines.ravel())
        cells = np.zeros(self.dims, self.dtype)
        _gather_rows(lines.ravel(), views.shape[2], self._down, self._finer, cells, cells.ravel())
        return cells.reshape(planes, rows, self._finer, -1).swapaxes(2, 3).ravel()


# In the loops below, every `finer`-th column of cells is side by side, so that weights of one
# position in a cell meet neighbours; arrays are flat and indices unsigned, for loops without
# checks.


@without_refcounts
def _add(target, at, weight, source, start, count):
    """Add a weight times a line of a flat array to a line of another."""
    at, start = np.uintp(at), np.uintp(start)
    for k in range(np.uintp(count)):
        target[at + k] += weight * source[start + k]


@parallel(lambda views: views.shape[0] * views.shape[2])
def _see_rows(k, cells, flat, down, across, finer, views, seen):
    """Light of cells[p, y, x] in row t of the views of row v; k counts both."""
    planes, rows, columns = cells.shape
    _, count, t_count, s_count = views.shape
    v, t = k // t_count, k % t_count
    lines = np.zeros(planes * columns, flat.dtype)
    for p in range(planes):
        for j in range(down.shape[2]):
            if down[p, v, j] != 0:
                start = (p * rows + finer * t + j) * columns
                _add(lines, p * columns, down[p, v, j], flat, start, columns)
    for u in range(count):
        place = ((v * count + u) * t_count + t) * s_count
        for s in range(s_count):
            seen[place + s] = 0
        for p in range(planes):
            for j in range(across.shape[2]):
                if across[p, u, j] != 0:
                    start = p * columns + j % finer * (columns // finer) + j // finer
                    _add(seen, place, across[p, u, j], lines, start, s_count)


@parallel(lambda views: views.shape[0] * views.shape[2])
def _gather_columns(k, views, seen, across, finer, lines, gathered):
    """Adjoint along rows: lines[k, (p, x)] of row t of the views of row v; k counts both."""
    _, count, t_count, s_count = views.shape
    planes, columns = across.shape[0], lines.shape[1] // across.shape[0]
    v, t = k // t_count, k % t_count
    for u in range(count):
        place = ((v * count + u) * t_count + t) * s_count
        for p in range(planes):
            for j in range(across.shape[2]):
                if across[p, u, j] != 0:
                    at = (k * planes + p) * columns + j % finer * (columns // finer) + j // finer
                    _add(gathered, at, across[p, u, j], seen, place, s_count)


@parallel(lambda cells: cells.shape[0] * cells.shape[1])
def _gather_rows(k, lines, t_count, down, finer, cells, gathered):
    """Adjoint along columns: cells[p, y]; k counts both."""
    planes, rows, columns = cells.shape
    p, y = k // rows, k % rows
    for v in range(down.shape[1]):
        for j in range(down.shape[2]):
            t = (y - j) // finer
            if down[p, v, j] != 0 and finer * t == y - j and 0 <= t < t_count:
                start = ((v * t_count + t) * planes + p) * columns
                _add(gathered, k * columns, down[p, v, j], lines, start, columns)


def plane_taps(grid: FrustumGrid, axis: int, finer: int = 1) -> np.ndarray:
    """Weights with which a pixel sees the cells of a plane along an axis, (planes, views, cells).

    Float64. The first weight is that of the grid's first cell for the first pixel, and of the
    `finer`-th cell after it for the next; a pixel's own cell is at the centre. They are those of a
    pixel at the centre of the field.
    """
    middle, block = grid.pixels[axis] // 2, grid.block
    taps = np.zeros((len(grid.depths_mm), grid.camera.views, finer * (2 * grid.reach + 1)))
    for plane, of_plane in enumerate(taps):
        layer = grid.empty_layer(plane, finer)
        centres, *widths = _bundles(grid.camera, layer, axis)
        centres = centres[:, middle * block : (middle + 1) * block]
        start, weight = band_weights(layer.cell_edges_mm[axis], centres, *widths)
        view, _, _ = lit = np.nonzero(weight)
        cell = start[..., None] + np.arange(weight.shape[-1]) - finer * middle
        np.add.at(of_plane, (view, cell[lit]), weight[lit] / block)
    return taps


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
    """Lay views (v, u, t, s) side by side: one array with rows (v, t) and columns (u, s)."""
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
    start, weight = band_weights(layer.cell_edges_mm[axis], *_bundles(camera, layer, axis))
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

    Where only slope and scale are measured, the boxes are those of a lenslet and of a view's step,
    which differ from a thin lens's by the size of a lenslet relative to the pupil's.
    """
    if isinstance(camera, PlenopticCamera):
        traced = trace_footprint(camera, layer.depth_mm, axis)
        return traced.centres_mm, abs(traced.lenslet_width_mm), abs(traced.pixel_width_mm)
    side = camera.field_mm(layer.depth_mm)[axis] / camera.lenslets[axis]
    slope = camera.depth_to_slope(layer.depth_mm)
    places = centred(camera.lenslets[axis]) - slope * centred(camera.views)[:, None]
    return side * places, side, side * abs(slope)
