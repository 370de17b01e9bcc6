"""Light on the field's edges, where nothing should glow: a background, or blacks cut off at 0."""

from dataclasses import dataclass

import numpy as np

LEAST_SIGNIFICANT = 5.0
"""Standard errors of the edge's level from which a background is no accident."""

LEAST_LIGHT = 0.01
"""Share of all light that a background must add to be worth a word."""

HALF_NORMAL = 1.35
"""Ratio of mean square to squared mean of what is above 0, from which zeros are noise that was cut
off: 1.57 for a normal distribution cut in its middle; below 1.3 for counted photons."""

SOME_ZEROS, MOST_ZEROS = 0.2, 0.9
"""Shares of exact zeros between which blacks are taken to be cut off: all, where nothing is lit."""


@dataclass(frozen=True)
class Edge:
    """Level of the outermost pixels of all views.

    Attributes
    ----------
    level : float
        Median over the pixels of their mean over the views.
    error : float
        Standard error of the level, by the scatter of those means.
    adds : float
        Light that this level adds to the field, relative to the rest of its light.
    brightest : float
        Largest of those means.
    clipped : bool
        Whether noise below 0 was cut off.
    """

    level: float
    error: float
    adds: float
    brightest: float
    clipped: bool

    @property
    def is_background(self) -> bool:
        """Whether the level is no accident, and worth a word."""
        return abs(self.level) > LEAST_SIGNIFICANT * self.error and abs(self.adds) > LEAST_LIGHT


def measure_edge(views: np.ndarray) -> Edge:
    """Measure the level of the field's edge, by all of its pixels together.

    Medians keep out light that reaches a part of the edge.

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
    """Fit a constant to what a light field holds where no emission reaches.

    Parameters
    ----------
    residual : ndarray, shape (v, u, t, s)
        Light field less the emission's.
    dark : ndarray of bool, same shape
        Pixels that no cell lights which may glow.

    Returns
    -------
    Level
        The mean, without the tails beyond three standard deviations.
    """
    values = residual[dark].astype(np.float64)
    for _ in range(3):
        middle, scatter = float(np.mean(values)), float(np.std(values))
        kept = values[np.abs(values - middle) <= 3 * scatter]
        if kept.size == values.size:
            break
        values = kept
    return Level(float(np.mean(values)), float(np.std(values) / np.sqrt(values.size)))
