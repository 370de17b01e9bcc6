"""How far noise moves a reconstruction: light fields drawn anew, and the covariance."""

from collections.abc import Iterator

import numpy as np
from scipy import ndimage

from lf_flame.tomography.frequency_gram import RIDGE, FrequencyGram
from lf_flame.tomography.penalised_fit import RangeFit
from lf_flame.tomography.projection_operator import ProjectionOperator

NOISE_BLOCK = 5
"""Pixels along each axis over which the noise of a place is averaged."""

MOST_REDRAWS = 10_000
"""Draws beyond which a number is a mistake: error bars are then known to 0.7 %."""


def draw_noise(
    operator: ProjectionOperator, sd: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Draw a light field of noise alone, and filter it.

    Parameters
    ----------
    operator : ProjectionOperator
    sd : ndarray, shape (t, s)
        Standard deviation of each pixel.
    rng : numpy.random.Generator

    Returns
    -------
    ndarray of float32, shape (planes, rows, columns)
        The filtered focal stack A'y.
    """
    noise = sd.astype(np.float32) * rng.standard_normal(operator.dimsd, dtype=np.float32)
    return operator.rmatvec(noise.ravel()).reshape(operator.dims)


def redraw(
    operator: ProjectionOperator,
    gram: FrequencyGram,
    stack: np.ndarray,
    sd: np.ndarray,
    count: int,
    rng: np.random.Generator,
) -> Iterator[RangeFit]:
    """Draw light fields of one emission with noise anew.

    Parameters
    ----------
    operator, gram : ProjectionOperator, FrequencyGram
    stack : ndarray, shape (planes, rows, columns)
        Filtered focal stack of the emission.
    sd, rng
        As `draw_noise` takes them.
    count : int

    Yields
    ------
    RangeFit
        To be solved; it knows no misfit.
    """
    for _ in range(count):
        yield RangeFit(gram, stack + draw_noise(operator, sd, rng), 0.0, 0)


def noise_by_pixel(
    operator: ProjectionOperator, views: np.ndarray, cells: np.ndarray
) -> np.ndarray:
    """Measure the noise by place: bright pixels have more of it, as light comes in portions.

    Parameters
    ----------
    operator : ProjectionOperator
    views : ndarray, shape (v, u, t, s)
    cells : ndarray, shape (planes, rows, columns)
        That explain all of the light field which any can.

    Returns
    -------
    ndarray of float64, shape (t, s)
        Variance relative to its mean over the pixels.
    """
    rest = views - operator.matvec(cells.ravel()).reshape(views.shape)
    power = np.mean(np.square(rest, dtype=np.float64), axis=(0, 1))
    # A running sum may end just below 0 where there is no noise.
    smooth = np.clip(ndimage.uniform_filter(power, NOISE_BLOCK, mode="nearest"), 0, None)
    return smooth / smooth.mean() if smooth.any() else np.ones_like(smooth)


def standard_errors(gram: FrequencyGram, noise: float, strength: float, order: int) -> np.ndarray:
    """Estimate the standard deviation of each plane's cells in the linear fit, by its covariance.

    With H the inverse of the penalised matrix, the covariance is ``noise^2 H G H`` at each
    frequency; a cell's variance is its mean over the frequencies.

    Returns
    -------
    ndarray of float64, shape (planes,)
    """
    values, _ = gram.decomposition
    shrunk = gram.gains / (values + gram.penalty(strength, order) + RIDGE * gram.scale) ** 2
    diagonal = np.diagonal(gram.compose(shrunk), axis1=-2, axis2=-1)
    mean = np.sum(gram.multiplicity[..., None] * diagonal, axis=(0, 1)) / np.prod(gram.size)
    return noise * np.sqrt(np.clip(mean, 0, None))


def noise_variance(sd: float) -> float:
    """Variance of the noise, above 0 so that it may divide."""
    return max(sd**2, float(np.finfo(np.float32).tiny))
