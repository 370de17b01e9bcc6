"""Effect of noise and penalty on a reconstruction: bootstrap redraws, and the covariance."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy import ndimage, special

from lf_flame.errors import InputError
from lf_flame.tomography.frequency_gram import RIDGE, FrequencyGram
from lf_flame.tomography.penalised_fit import RangeFit
from lf_flame.tomography.projection_operator import ProjectionOperator

NOISE_BLOCK = 9
"""Number of pixels along each axis over which noise is averaged beyond the photon noise."""

LEVEL = 0.95
"""Confidence level of an error bar."""

MOST_DRAWS = 10_000
"""Largest number of draws; error bars are then known to 0.7 %, and more is a mistake."""


class Prior(NamedTuple):
    """Prior on differences of neighbouring cells: normal, with the penalty as inverse covariance.

    Attributes
    ----------
    strength : float
        Strength of the penalty.
    noise : float
        Standard deviation of the noise inside the flame, in whose units the penalty is.
    """

    strength: float
    noise: float


class Expected(NamedTuple):
    """Expectation and scatter of a light field, from which others are drawn.

    Attributes
    ----------
    stack : ndarray, shape (planes, rows, columns)
        Filtered focal stack of the emission.
    sd : ndarray, shape (v, u, t, s)
        Standard deviation of each pixel's noise.
    level_error : float
        Standard deviation of a uniform background that was subtracted; 0 without.
    prior : Prior or None
        Prior on the emission; None if none is drawn.
    """

    stack: np.ndarray
    sd: np.ndarray
    level_error: float
    prior: Prior | None


def check_bootstrap(bootstrap: int) -> None:
    """Refuse a number of bootstrap draws that gives no scatter, or is unreasonably large.

    Raises
    ------
    InputError
        If it is not 0, or 2 to `MOST_DRAWS`.
    """
    if not 0 <= bootstrap <= MOST_DRAWS or bootstrap == 1:
        raise InputError(f"bootstrap must be 0, or 2 to {MOST_DRAWS}, got {bootstrap}.")


def draw_noise(
    operator: ProjectionOperator, sd: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Draw a light field of noise alone, and backproject it.

    Parameters
    ----------
    operator : ProjectionOperator
    sd : ndarray, shape (v, u, t, s)
        Standard deviation of each pixel.
    rng : numpy.random.Generator

    Returns
    -------
    ndarray of float32, shape (planes, rows, columns)
        Filtered focal stack A'y of the noise.
    """
    noise = sd.astype(np.float32) * rng.standard_normal(operator.dimsd, dtype=np.float32)
    return operator.rmatvec(noise.ravel()).reshape(operator.dims)


def redraw(
    operator: ProjectionOperator,
    gram: FrequencyGram,
    expected: Expected,
    count: int,
    rng: np.random.Generator,
    prior_rng: np.random.Generator,
) -> Iterator[RangeFit]:
    """Redraw the noise of a light field, and the prior that its penalty means (bootstrap).

    The penalty is a prior on differences of neighbouring cells. Noise of its scale is therefore
    added to the desired values of these differences. The scatter of the fits then includes the
    effect of the penalty on a flame (Bardsley and others, SIAM J. Sci. Comput. 36, A1895, 2014).

    Parameters
    ----------
    operator, gram : ProjectionOperator, FrequencyGram
    expected : Expected
    count : int
        Number of redraws.
    rng, prior_rng : numpy.random.Generator
        Generators of the noise and of the prior.

    Yields
    ------
    RangeFit
        Problem ready to be solved; its misfit is undefined.
    """
    even = np.ones(int(np.prod(operator.dimsd)), np.float32) if expected.level_error else None
    prior = expected.prior
    for _ in range(count):
        drawn = expected.stack + draw_noise(operator, expected.sd, rng)
        if even is not None:
            off = np.float32(expected.level_error * rng.standard_normal())
            drawn = drawn + off * operator.rmatvec(even).reshape(operator.dims)
        if prior is not None and prior.noise:
            drawn += np.float32(prior.noise) * gram.draw_penalty(prior.strength, prior_rng)
        yield RangeFit(gram, drawn, 0.0, 0)


def scatter(draws: np.ndarray, found: np.ndarray) -> np.ndarray:
    """Root-mean-square distance of draws from the result along axis 0; it includes their bias."""
    return np.sqrt(np.mean(np.square(draws - found), axis=0))


def bar_times(count: int) -> float:
    """Half-width of a bar of `LEVEL` in standard errors estimated from `count` draws (Student)."""
    return float(special.stdtrit(count, (1 + LEVEL) / 2))


def noise_by_pixel(
    operator: ProjectionOperator, views: np.ndarray, cells: np.ndarray
) -> np.ndarray:
    """Variance of each pixel's noise: from its light (photon noise), and from its position.

    The variance of a sensor's pixel rises in proportion to its light (the photon transfer curve;
    EMVA standard 1288). Other effects, such as a division by a white image, vary slowly over the
    field.

    Parameters
    ----------
    operator : ProjectionOperator
    views : ndarray, shape (v, u, t, s)
    cells : ndarray, shape (planes, rows, columns)
        Unpenalised fit, which explains as much of the light field as any cells.

    Returns
    -------
    ndarray of float32, shape (v, u, t, s)
        Variance relative to its mean.
    """
    seen = operator.matvec(cells.ravel()).reshape(views.shape)
    power = np.square(views - seen, dtype=np.float32)
    if not power.any():
        return np.ones_like(power)
    light = np.clip(seen, 0, None)
    by_light = _photon_transfer(power, light)
    place, wanted = (
        ndimage.uniform_filter(one.mean(axis=(0, 1), dtype=np.float64), NOISE_BLOCK, mode="nearest")
        for one in (power, by_light)
    )
    # A running sum may end slightly below 0 where there is no noise.
    least = 1e-6 * float(wanted.max())
    by_light *= (np.clip(place, 0, None) / np.maximum(wanted, least)).astype(np.float32)
    return by_light / by_light.mean(dtype=np.float64)


def _photon_transfer(power: np.ndarray, light: np.ndarray) -> np.ndarray:
    """Fit squared noise with a constant plus a multiple of the light, both 0 or above; float32."""
    mean_power, mean_light = (float(one.mean(dtype=np.float64)) for one in (power, light))
    bright = light - np.float32(mean_light)
    spread = float(np.mean(np.square(bright, dtype=np.float64)))
    slope = float(np.mean(bright * power, dtype=np.float64)) / spread if spread else 0.0
    steepest = mean_power / mean_light if mean_light else 0.0
    slope = min(max(slope, 0.0), steepest)
    line = mean_power + np.float32(slope) * (light - np.float32(mean_light))
    return np.maximum(line, np.float32(1e-6 * mean_power))


def standard_errors(gram: FrequencyGram, noise: float, strength: float) -> np.ndarray:
    """Find the standard deviation of the unconstrained linear fit, one number per depth plane.

    With H the inverse of the penalised matrix, the covariance is ``noise^2 H G H`` at each
    frequency; a cell's variance is its mean over the frequencies.

    Returns
    -------
    ndarray of float64, shape (planes,)
    """
    values, _ = gram.decomposition
    shrunk = gram.gains / (values + gram.penalty(strength) + RIDGE * gram.scale) ** 2
    diagonal = np.diagonal(gram.compose(shrunk), axis1=-2, axis2=-1)
    mean = np.sum(gram.multiplicity[..., None] * diagonal, axis=(0, 1)) / np.prod(gram.size)
    return noise * np.sqrt(np.clip(mean, 0, None))


def noise_variance(sd: float) -> float:
    """Variance of the noise, bounded above 0 so that one can divide by it."""
    return max(sd**2, float(np.finfo(np.float32).tiny))
