"""Light field of an axisymmetric flame's half section as a linear operator; its Gram matrix."""

import numpy as np
from pylops import LinearOperator
from scipy import sparse

from lf_flame.tomography.axisymmetric.grid import AxisymmetricGrid
from lf_flame.tomography.projection_operator import as_raw, as_views


class AxisymmetricOperator(LinearOperator):
    """Linear operator from emission at nodes to views.

    It maps emission, flattened (height, radius), in radiance per mm of the line of sight, to views
    (v, u, t, s); float64.

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

    def __init__(self, grid: AxisymmetricGrid):
        super().__init__(dtype=np.dtype(float), dims=grid.shape, dimsd=grid.view_shape)
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


def gram_bands(grid: AxisymmetricGrid) -> np.ndarray:
    """Gram matrix A'A of the nodes' light fields.

    It is banded, because views mix heights only as far as the parallax within the flame reaches.

    Returns
    -------
    ndarray of float64, shape (band, heights * radii)
        Lower diagonals, as `scipy.linalg.cholesky_banded` takes them.
    """
    heights, radii = grid.shape
    slabs, (t, s) = len(grid.by_radius), grid.view_shape[2:]
    stacked = sparse.hstack(grid.by_height, format="csr")
    beside = np.concatenate(list(grid.by_radius), axis=1)
    products = []
    for rows, columns in grid.view_groups():
        down, across = stacked[_lines(rows, t)], beside[_lines(columns, s)]
        products.append((down.T @ down, across.T @ across))
    reach = max(_reach(down, heights) for down, _ in products)
    bands = np.zeros(((reach + 1) * radii, heights * radii))
    for down, across in products:
        down = down.toarray().reshape(slabs, heights, slabs, heights)
        down = down.transpose(1, 3, 0, 2)  # height, height, slab, slab
        across = across.reshape(slabs, radii, slabs, radii).transpose(0, 2, 1, 3)
        across = across.reshape(slabs**2, radii**2)
        for step in range(reach + 1):
            start = np.arange(heights - step)
            blocks = down[start + step, start].reshape(-1, slabs**2) @ across
            _add_blocks(bands, blocks.reshape(-1, radii, radii), step)
    return bands


def _lines(views: np.ndarray, pixels: int) -> np.ndarray:
    """Rows of a matrix (views * pixels, ...) that are of some views."""
    return (views[:, None] * pixels + np.arange(pixels)).ravel()


def _reach(down: sparse.csr_array, heights: int) -> int:
    """Find the largest distance in rows between two heights that one pixel sees."""
    seen = down.tocoo()
    return int(np.abs(seen.row % heights - seen.col % heights)[seen.data != 0].max())


def _add_blocks(bands: np.ndarray, blocks: np.ndarray, step: int) -> None:
    """Add the blocks `step` below the diagonal, (height, radius, radius), to lower diagonals."""
    radii = blocks.shape[1]
    for row in range(radii):
        for column in range(radii):
            below = step * radii + row - column
            if below >= 0:
                bands[below, column : column + len(blocks) * radii : radii] += blocks[
                    :, row, column
                ]
