"""What cells cannot hold: light that varies within them.

A grid's cells glow evenly, a flame does not. Its light field therefore differs a little from that
of any cells, and a fit answers with an error of its own: at depths of fractional slope a quarter of
a per cent of the peak. The difference is nearly that between cells and a smooth course through
them, which can be computed.
"""

from functools import lru_cache

import numpy as np
from scipy import ndimage, sparse

from lf_flame.scenes.scene import Layer
from lf_flame.tomography.frustum_grid import FrustumGrid
from lf_flame.tomography.projection_operator import layer_bands

FINER = 3
"""Parts of a cell along each axis, in which a smooth course is laid out."""


def smooth_course(plane: np.ndarray) -> np.ndarray:
    """Draw a smooth course of light through the cells of a plane, which keeps the light of each.

    A cubic spline along each axis whose means over the cells are theirs (a histospline; Boneva,
    Kendall and Stefanov, J. R. Stat. Soc. B 33, 1, 1971). Where it falls below 0 it is cut off, and
    the cell's light brought back to what it was.

    Parameters
    ----------
    plane : ndarray, shape (rows, columns)
        0 or above.

    Returns
    -------
    ndarray of float64, shape (FINER * rows, FINER * columns)
        0 or above.
    """
    down, across = (_histospline(count) for count in plane.shape)
    course = np.clip(down @ plane.astype(np.float64) @ across.T, 0, None)
    means = cell_means(course)
    share = np.divide(plane, means, out=np.zeros_like(means), where=means > 0)
    return course * share.repeat(FINER, axis=0).repeat(FINER, axis=1)


@lru_cache(maxsize=16)
def _histospline(count: int) -> np.ndarray:
    """Give the matrix from means of cells to means of their parts, shape (FINER * count, count)."""
    spline = ndimage.zoom(np.eye(count), (FINER, 1), order=3, mode="nearest", grid_mode=True)
    means = spline.reshape(count, FINER, count).mean(axis=1)
    return spline @ np.linalg.inv(means)


def cell_means(course: np.ndarray) -> np.ndarray:
    """Average the parts of each cell, shape (rows, columns)."""
    rows, columns = (count // FINER for count in course.shape)
    return course.reshape(rows, FINER, columns, FINER).mean(axis=(1, 3))


class SmoothStack:
    """The filtered focal stack A'y of the light field y of smooth courses through cells.

    No light field is formed: per axis and pair of planes, views and pixels are summed beforehand.

    Parameters
    ----------
    grid : FrustumGrid
    """

    def __init__(self, grid: FrustumGrid):
        self._pairs = [_pair_sums(grid, axis) for axis in (0, 1)]

    def __call__(self, cells: np.ndarray) -> np.ndarray:
        """Give the stack of some cells, float32, their shape (planes, rows, columns)."""
        courses = [smooth_course(plane) for plane in cells]
        down, across = self._pairs
        stack = [
            sum(
                (y @ np.ascontiguousarray((x @ course.T).T))
                for y, x, course in zip(down[plane], across[plane], courses, strict=True)
            )
            for plane in range(len(cells))
        ]
        return np.array(stack, np.float32)


def _pair_sums(grid: FrustumGrid, axis: int) -> list[list[sparse.csr_array]]:
    """Sum over views and pixels what a line of cells of one plane shares with fine ones of another.

    Returns
    -------
    list of list of csr_array, shape (cells, FINER * cells)
        By the plane of the cells, then by that of the light.
    """
    planes = range(len(grid.depths_mm))
    coarse, fine = [], []
    for plane in planes:
        layer = grid.empty_layer(plane)
        parts = Layer(
            np.zeros([FINER * count for count in layer.texture.shape]),
            layer.depth_mm,
            layer.size_mm,
        )
        coarse.append(layer_bands(layer, grid.camera, grid.block, axis).T.tocsr())
        fine.append(layer_bands(parts, grid.camera, grid.block, axis))
    return [[sparse.csr_array(coarse[p] @ fine[q]) for q in planes] for p in planes]
