"""Light where nothing emits: a uniform background, measured in empty pixels."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from lf_flame.tomography.frustum_grid import FrustumGrid
from lf_flame.tomography.geometries import Geometry, backproject, project

LEAST_SIGNIFICANT = 5.0
"""Number of standard errors above which the edge's level is a background."""

LEAST_EMPTY = 0.02
"""Smallest fraction of empty pixels with which a background is measured."""

FITS, BRIGHT = 4, 3.0
"""Largest number of measurements, and standard errors by which a cell that may emit is brighter
than the background of the measurement before."""

WIDENED = np.ones((1, 5, 5))
"""Cells around a bright cell that may emit, too: their light is fainter than the noise."""


@dataclass(frozen=True)
class Edge:
    """Level of the outermost pixels of all views.

    level : median over the pixels of their mean over the views
    error : standard error of the level, from the scatter of those means
    adds : light that this level adds to the field, relative to the rest of its light
    brightest : largest of those means
    """

    level: float
    error: float
    adds: float
    brightest: float

    @property
    def is_significant(self) -> bool:
        """Whether the level is more than noise."""
        return abs(self.level) > LEAST_SIGNIFICANT * self.error


def measure_edge(views: np.ndarray) -> Edge:
    """Measure the level at the edge of the field, from all of its pixels together, (v, u, t, s).

    Medians exclude light that reaches only a part of the edge.
    """
    frame = np.ones(views.shape[2:], bool)
    frame[1:-1, 1:-1] = False
    pixels = views[..., frame]
    means = pixels.mean(axis=(0, 1), dtype=np.float64)
    level = float(np.median(means))
    # The standard error of a median is 1.2533 times that of a mean; 1.4826 scales the deviations.
    scatter = 1.4826 * float(np.median(np.abs(means - level)))
    error = 1.2533 * scatter / np.sqrt(means.size)
    light = float(views.mean(dtype=np.float64)) - level
    adds = level / light if light > 0 else (np.inf if level else 0.0)
    return Edge(level, error, float(adds), float(means.max()))


class Level(NamedTuple):
    """Level of a background, and its standard error."""

    mean: float = 0.0
    error: float = 0.0


def fit_background(
    views: np.ndarray, geometry: Geometry, valid: np.ndarray | None = None
) -> Level | None:
    """Measure a uniform background in the pixels that no emission reaches; None without any.

    Cells that may emit are those whose rays are brighter, in the mean, than the background: first
    that at the field's edge, then that of the measurement before. A half section may emit anywhere
    within its radius.
    """
    operator, grid = geometry.operator, geometry.grid
    on_planes = isinstance(grid, FrustumGrid)
    edge = measure_edge(views)
    level, before = Level(edge.level, edge.error), np.inf
    if on_planes:
        rays = np.maximum(backproject(operator, np.ones_like(views)), 1.0)
        means = backproject(operator, views) / rays
        means = ndimage.uniform_filter(means, (1, 3, 3))
        seen = rays > grid.view_count / 2
    for _ in range(FITS):
        lit = np.ones(operator.dims, bool)
        if on_planes:
            dark = means[seen & (means < level.mean)] - level.mean
            noise = np.sqrt(np.mean(np.square(dark))) if dark.size else 0.0
            lit = seen & (means > level.mean + BRIGHT * noise)
            lit = ndimage.binary_dilation(lit, WIDENED)
        empty = project(operator, lit.astype(operator.dtype)) <= 0
        if valid is not None:
            empty &= valid
        if np.mean(empty) < LEAST_EMPTY:
            return None
        level = _level(views[empty])
        if abs(level.mean - before) <= level.error / 2:
            break
        before = level.mean
    return level


def _level(pixels: np.ndarray) -> Level:
    """Mean of empty pixels, without the tails beyond three standard deviations, and its error."""
    values = pixels.astype(np.float64)
    for _ in range(3):
        middle, scatter = float(np.mean(values)), float(np.std(values))
        kept = values[np.abs(values - middle) <= 3 * scatter]
        if kept.size == values.size:
            break
        values = kept
    return Level(float(np.mean(values)), float(np.std(values) / np.sqrt(values.size)))
