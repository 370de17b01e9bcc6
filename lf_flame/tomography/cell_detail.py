"""Detail within cells: the error of a grid with constant emission over each cell.

A flame's emission varies within cells. Its light field therefore differs slightly from that of any
cells, and a fit responds with an error: at depths of fractional slope, a quarter of a per cent of
the peak. The difference is nearly that between the cells and a smooth function with the same light
in each cell, which can be computed.
"""

from functools import lru_cache

import numpy as np
from scipy import ndimage, sparse

from lf_flame.scenes.scene import Layer
from lf_flame.tomography.frustum_grid import FrustumGrid
from lf_flame.tomography.projection_operator import layer_bands

FINER = 3
"""Number of parts of a cell along each axis, for the smooth function."""


def smooth_course(plane: np.ndarray) -> np.ndarray:
    """Smooth function through the cells of a depth plane that keeps the light of each cell.

    It is a cubic spline along each axis with the means of the cells (a histospline; Boneva, Kendall
    and Stefanov, J. R. Stat. Soc. B 33, 1, 1971). Negative values are set to 0, and the light of
    the cell is then restored.

    Parameters
    ----------
    plane : ndarray, shape (rows, columns)
        Emission of the cells, 0 or above.

    Returns
    -------
    ndarray of float64, shape (FINER * rows, FINER * columns)
        Smooth emission, 0 or above.
    """
    down, across = (_histospline(count) for count in plane.shape)
    course = np.clip(down @ plane.astype(np.float64) @ across.T, 0, None)
    means = cell_means(course)
    share = np.divide(plane, means, out=np.zeros_like(means), where=means > 0)
    return course * share.repeat(FINER, axis=0).repeat(FINER, axis=1)


@lru_cache(maxsize=16)
def _histospline(count: int) -> np.ndarray:
    """Matrix from means of cells to means of their parts, shape (FINER * count, count)."""
    spline = ndimage.zoom(np.eye(count), (FINER, 1), order=3, mode="nearest", grid_mode=True)
    means = spline.reshape(count, FINER, count).mean(axis=1)
    return spline @ np.linalg.inv(means)


def cell_means(course: np.ndarray) -> np.ndarray:
    """Average the parts of each cell, shape (rows, columns)."""
    rows, columns = (count // FINER for count in course.shape)
    return course.reshape(rows, FINER, columns, FINER).mean(axis=(1, 3))


class SmoothStack:
    """Filtered focal stack A'y of the light field y of smooth functions through cells.

    No light field is formed: for each axis and pair of depth planes, views and pixels are summed
    beforehand.

    Parameters
    ----------
    grid : FrustumGrid
    """

    def __init__(self, grid: FrustumGrid):
        self._pairs = [
            [_pair_sums(grid, axis, views) for axis, views in enumerate(group)]
            for group in grid.view_groups()
        ]

    def __call__(self, cells: np.ndarray) -> np.ndarray:
        """Give the filtered focal stack of cells, float32, shape (planes, rows, columns)."""
        courses = [smooth_course(plane) for plane in cells]
        stack = [
            sum(
                (y @ np.ascontiguousarray((x @ course.T).T))
                for down, across in self._pairs
                for y, x, course in zip(down[plane], across[plane], courses, strict=True)
            )
            for plane in range(len(cells))
        ]
        return np.array(stack, np.float32)


def _pair_sums(grid: FrustumGrid, axis: int, views: np.ndarray) -> list[list[sparse.csr_array]]:
    """Sum over views and pixels the overlap of a line of cells in one plane with parts in another.

    Parameters
    ----------
    views : ndarray of int
        Indices of views along the axis.

    Returns
    -------
    list of list of csr_array, shape (cells, FINER * cells)
        Sums by the depth plane of the cells, then by that of the parts.
    """
    planes, pixels = range(len(grid.depths_mm)), grid.pixels[axis]
    rows = (views[:, None] * pixels + np.arange(pixels)).ravel()
    coarse, fine = [], []
    for plane in planes:
        layer = grid.empty_layer(plane)
        parts = Layer(
            np.zeros([FINER * count for count in layer.texture.shape]),
            layer.depth_mm,
            layer.size_mm,
        )
        coarse.append(layer_bands(layer, grid.camera, grid.block, axis)[rows].T.tocsr())
        fine.append(layer_bands(parts, grid.camera, grid.block, axis)[rows])
    return [[sparse.csr_array(coarse[p] @ fine[q]) for q in planes] for p in planes]
