"""The two geometries of a fit, planes and half section, and their operators."""

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from scipy import ndimage
from scipy.interpolate import CubicSpline

from lf_flame.tomography.axisymmetric_grid import AxisymmetricGrid
from lf_flame.tomography.frequency_gram import FrequencyGram
from lf_flame.tomography.frustum_grid import FrustumGrid
from lf_flame.tomography.plane_problem import PlaneProblem
from lf_flame.tomography.projection_operator import (
    AxisymmetricOperator,
    GridOperator,
    ProjectionOperator,
)
from lf_flame.tomography.section_problem import BandedGram, SectionProblem

PARTS, FINER = 3, 3
"""Number of parts of a cell along each axis, and of steps between two nodes, for the smooth flame
through cells or nodes. A flame's emission varies within cells, and a fit of even cells responds to
that with an error: at depths of fractional slope, a quarter of a per cent of the peak."""


@dataclass(frozen=True, eq=False)
class PlaneGeometry:
    """Cells on depth planes; see `SectionGeometry` for what the two have in common."""

    grid: FrustumGrid
    iterations = 80
    """Largest number of iterations for the solution, in two fits; each strength that is tried, and
    each draw, takes at most half, starting from the nearest solution."""
    model_error = 0.0

    @cached_property
    def operator(self) -> ProjectionOperator:
        """Light field of cells."""
        return ProjectionOperator(self.grid)

    @cached_property
    def gram(self) -> FrequencyGram:
        """Gram matrix of the operator by frequency."""
        return FrequencyGram(self.grid)

    @cached_property
    def _finer(self) -> ProjectionOperator:
        return ProjectionOperator(self.grid, finer=PARTS)

    def smooth_views(self, cells: np.ndarray) -> np.ndarray:
        """Light field of the smooth flame through cells."""
        courses = np.array([smooth_course(plane) for plane in cells], np.float32)
        return project(self._finer, courses)

    def problem(self, back: np.ndarray, squared: float = 0.0, rays: int = 0) -> PlaneProblem:
        """Problem of a backprojected light field."""
        return PlaneProblem(self.gram, back, squared, rays)

    def noise_by_cell(self, uneven: np.ndarray) -> np.ndarray:
        """Relative variance of the noise that cells see, in a shape that broadcasts to them."""
        by_place = uneven.mean(axis=(0, 1), dtype=np.float64)
        return np.pad(by_place, self.grid.reach, mode="edge")[None]


@dataclass(frozen=True, eq=False)
class SectionGeometry:
    """Nodes of an axisymmetric half section.

    iterations : number of iterations for the solution; a quarter of it for each strength and draw
    model_error : noise relative to the brightest pixel below which the grid limits a fit
    """

    grid: AxisymmetricGrid
    iterations = 200
    model_error = 1e-3

    @cached_property
    def operator(self) -> AxisymmetricOperator:
        """Light field of nodes."""
        return AxisymmetricOperator(self.grid)

    @cached_property
    def gram(self) -> BandedGram:
        """Gram matrix of the operator."""
        return BandedGram(self.grid)

    @cached_property
    def _finer(self) -> AxisymmetricOperator:
        return AxisymmetricOperator(replace(self.grid, finer=FINER * self.grid.finer))

    def problem(self, back: np.ndarray, squared: float = 0.0, rays: int = 0) -> SectionProblem:
        """Problem of a backprojected light field."""
        return SectionProblem(self.gram, back, squared, rays)

    def smooth_views(self, nodes: np.ndarray) -> np.ndarray:
        """Light field of the smooth flame through nodes (cubic splines)."""
        heights, radii = nodes.shape
        mirrored = np.concatenate([nodes[:, :0:-1], nodes, np.zeros((heights, 1))], axis=1)
        places = np.arange(1.0 - radii, radii + 1)
        fine = CubicSpline(places, mirrored, axis=1)(np.arange(radii * FINER) / FINER)
        rows = np.arange((heights - 1) * FINER + 1) / FINER
        course = np.clip(CubicSpline(np.arange(heights), fine, axis=0)(rows), 0, None)
        return project(self._finer, course)

    def noise_by_cell(self, uneven: np.ndarray) -> np.ndarray:
        """Relative variance of noise that nodes see; with photon noise, bright ones see more."""
        seen, ones = (self.operator.rmatvec(one.ravel()) for one in (uneven, np.ones(uneven.shape)))
        return (seen / np.maximum(ones, 1e-300)).reshape(self.grid.shape)


Geometry = PlaneGeometry | SectionGeometry


def geometry_of(grid: FrustumGrid | AxisymmetricGrid) -> Geometry:
    """Operators of a grid, made when they are needed."""
    return PlaneGeometry(grid) if isinstance(grid, FrustumGrid) else SectionGeometry(grid)


def backproject(operator: GridOperator, views: np.ndarray) -> np.ndarray:
    """Backprojected light field A'y, in the shape of the grid."""
    flat = views.ravel().astype(operator.dtype, copy=False)
    return operator.rmatvec(flat).reshape(operator.dims)


def project(operator: GridOperator, cells: np.ndarray) -> np.ndarray:
    """Light field of cells, shape (v, u, t, s)."""
    flat = cells.ravel().astype(operator.dtype, copy=False)
    return operator.matvec(flat).reshape(operator.dimsd)


def smooth_course(plane: np.ndarray) -> np.ndarray:
    """Smooth function through the cells of a depth plane that keeps the light of each cell.

    It is a cubic spline along each axis with the means of the cells (a histospline; Boneva, Kendall
    and Stefanov, J. R. Stat. Soc. B 33, 1, 1971). Negative values are set to 0, and the light of
    the cell is then restored.
    """
    down, across = (_histospline(count).astype(plane.dtype) for count in plane.shape)
    course = down @ plane @ across.T
    np.maximum(course, 0, out=course)
    means = cell_means(course)
    share = np.divide(plane, means, out=np.zeros_like(means), where=means > 0)
    course.reshape(len(plane), PARTS, -1)[...] *= share.repeat(PARTS, axis=1)[:, None]
    return course


@lru_cache(maxsize=16)
def _histospline(count: int) -> np.ndarray:
    """Matrix from means of cells to means of their parts, shape (PARTS * count, count)."""
    spline = ndimage.zoom(np.eye(count), (PARTS, 1), order=3, mode="nearest", grid_mode=True)
    means = spline.reshape(count, PARTS, count).mean(axis=1)
    return spline @ np.linalg.inv(means)


def cell_means(course: np.ndarray) -> np.ndarray:
    """Average the parts of each cell, shape (rows, columns)."""
    means = course.reshape(len(course) // PARTS, PARTS, -1).mean(axis=1)
    return means.reshape(len(means), -1, PARTS).mean(axis=2)
