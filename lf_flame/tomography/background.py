"""Light at the edges of the field, where nothing should emit: a background, or clipped blacks."""

from dataclasses import dataclass

import numpy as np

LEAST_SIGNIFICANT = 5.0
"""Number of standard errors above which the edge's level is a background."""

LEAST_LIGHT = 0.01
"""Smallest fraction of all light that a background must add for a warning."""

HALF_NORMAL = 1.35
"""Smallest ratio of mean square to squared mean of values above 0 that shows clipped noise: it is
1.57 for a normal distribution clipped at its centre, and below 1.3 for photon noise."""

SOME_ZEROS, MOST_ZEROS = 0.2, 0.9
"""Range of the fraction of exact zeros with which blacks count as clipped; 1 if nothing is lit."""


@dataclass(frozen=True)
class Edge:
    """Level of the outermost pixels of all views.

    Attributes
    ----------
    level : float
        Median over the pixels of their mean over the views.
    error : float
        Standard error of the level, from the scatter of those means.
    adds : float
        Light that this level adds to the field, relative to the rest of its light.
    brightest : float
        Largest of those means.
    clipped : bool
        Whether noise below 0 was clipped.
    """

    level: float
    error: float
    adds: float
    brightest: float
    clipped: bool

    @property
    def is_background(self) -> bool:
        """Whether the level is significant, and large enough for a warning."""
        return abs(self.level) > LEAST_SIGNIFICANT * self.error and abs(self.adds) > LEAST_LIGHT


def measure_edge(views: np.ndarray) -> Edge:
    """Measure the level at the edge of the field, from all of its pixels together.

    Medians exclude light that reaches only a part of the edge.

    Parameters
    ----------
    views : ndarray, shape (v, u, t, s)
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
    adds = level / light if light > 0 else np.inf * np.sign(level)
    zeros = float(np.mean(pixels == 0))
    above = pixels[pixels > 0].astype(np.float64)
    cut = SOME_ZEROS < zeros < MOST_ZEROS and pixels.min() >= 0
    clipped = cut and float(np.mean(above**2)) > HALF_NORMAL * float(np.mean(above)) ** 2
    return Edge(level, error, float(adds), float(means.max()), bool(clipped))


@dataclass(frozen=True)
class Level:
    """Level of a background, and its standard error."""

    mean: float
    error: float


def fit_background(residual: np.ndarray, dark: np.ndarray) -> Level:
    """Fit a constant to the part of a light field that no emission reaches.

    Parameters
    ----------
    residual : ndarray, shape (v, u, t, s)
        Light field minus that of the emission.
    dark : ndarray of bool, same shape
        Pixels that receive no light from cells with emission.

    Returns
    -------
    Level
        Mean, without the tails beyond three standard deviations.
    """
    values = residual[dark].astype(np.float64)
    for _ in range(3):
        middle, scatter = float(np.mean(values)), float(np.std(values))
        kept = values[np.abs(values - middle) <= 3 * scatter]
        if kept.size == values.size:
            break
        values = kept
    return Level(float(np.mean(values)), float(np.std(values) / np.sqrt(values.size)))
