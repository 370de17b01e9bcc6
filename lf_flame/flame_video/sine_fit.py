"""Fit of sines of any frequency to a series, with a base model and correlated noise.

It is the generalised Lomb-Scargle periodogram (Zechmeister and Kuerster 2009) with more than a
mean, weighted by the covariance of the noise.
"""

from math import exp, lgamma, pi, sqrt

import numpy as np
from scipy.optimize import minimize_scalar

from lf_flame.flame_video.wander import Wander

WHITE_NOISE = Wander(1.0, 1.0)

CONSTANT = 1e-9
"""Scatter of values, relative to the largest, up to which it is only rounding."""

TAKEN_UP = 0.1
"""Smallest fraction of a sine's square outside the base model; below it, it is left out."""

AT_ONCE = 1 << 18
"""Largest number of values times frequencies processed together, to bound the memory."""


def sines(times: np.ndarray, frequency_hz: float) -> np.ndarray:
    """Make cosine and sine of a frequency, shape (n, 2)."""
    angle = 2 * pi * frequency_hz * times
    return np.column_stack([np.cos(angle), np.sin(angle)])


class SineFit:
    """A series relative to its base model.

    Parameters
    ----------
    times, values : ndarray, shape (n,)
        Times, relative to their mean, and values.
    base : ndarray, shape (n, k)
        Columns of the base model.
    noise : Wander, optional
        Covariance of the noise. Default: white.

    Attributes
    ----------
    scatter : float
        Sum of the squares about the base model, weighted by the noise; 0 if it is only rounding.
    """

    def __init__(
        self, times: np.ndarray, values: np.ndarray, base: np.ndarray, noise: Wander = WHITE_NOISE
    ):
        self.times = times
        self._weigh = noise.weigher(times)
        self._base = np.linalg.qr(base)[0]
        self._weighed_base = self._weigh(self._base)
        self._gram = self._base.T @ self._weighed_base
        self._rest = self._without_base(values[:, None])
        self._weighed_rest = self._weigh(self._rest)
        self.scatter = float((self._rest * self._weighed_rest).sum())
        if np.sum(self._rest**2) <= len(values) * (CONSTANT * np.abs(values).max()) ** 2:
            self.scatter = 0.0

    def _without_base(self, columns: np.ndarray) -> np.ndarray:
        return columns - self._base @ np.linalg.solve(self._gram, self._weighed_base.T @ columns)

    def power(self, frequencies: np.ndarray) -> np.ndarray:
        """Fraction of the scatter about the base model that a sine of each frequency explains."""
        some = max(1, AT_ONCE // len(self.times))
        parts = [
            self.explained(frequencies[first : first + some])
            for first in range(0, len(frequencies), some)
        ]
        return np.concatenate(parts)

    def explained(self, frequencies: np.ndarray) -> np.ndarray:
        """Compute `power` for all frequencies at once."""
        if self.scatter == 0:
            return np.zeros(len(frequencies))
        angles = 2 * pi * np.outer(self.times, frequencies)
        cosine, sine = self._without_base(np.cos(angles)), self._without_base(np.sin(angles))
        weighed = self._weigh(cosine)
        cc, cs = (cosine * weighed).sum(axis=0), (sine * weighed).sum(axis=0)
        ss = (sine * self._weigh(sine)).sum(axis=0)
        cy, sy = ((one.T @ self._weighed_rest)[:, 0] for one in (cosine, sine))
        determinant = cc * ss - cs**2
        # Where cosine and sine are equal at all times, a frequency cannot be determined.
        told = determinant > 1e-9 * (cc + ss) ** 2
        # Neither can it where the base model contains nearly all of both.
        told &= (cosine**2 + sine**2).sum(axis=0) > TAKEN_UP * len(self.times)
        determinant = np.where(told, determinant, np.inf)
        a, b = (ss * cy - cs * sy) / determinant, (cc * sy - cs * cy) / determinant
        return np.clip((a * cy + b * sy) / self.scatter, 0, 1)

    def refined(self, frequencies: np.ndarray, top: int) -> float:
        """Find the frequency of highest power between the neighbours of one frequency."""
        ends = frequencies[max(top - 1, 0)], frequencies[min(top + 1, len(frequencies) - 1)]
        found = minimize_scalar(
            lambda frequency: -self.explained(np.array([frequency]))[0],
            bounds=ends, method="bounded", options={"xatol": 1e-4 * (ends[1] - ends[0])},
        )  # fmt: skip
        return float(found.x)

    def false_alarm(self, frequency_hz: float, band_hz: float) -> float:
        """Bound the probability that noise has a peak as high as this one anywhere in a band.

        Baluev, MNRAS 385, 1279 (2008), for a power relative to the scatter about a base model.
        """
        explained = float(self.explained(np.array([frequency_hz]))[0])
        left, free = 1 - explained, len(self.times) - self._base.shape[1]
        single = left ** ((free - 2) / 2)
        width = band_hz * sqrt(4 * pi * float(np.mean(self.times**2)))
        gamma = sqrt(2 / free) * exp(lgamma(free / 2) - lgamma((free - 1) / 2))
        crossings = gamma * width * left ** ((free - 3) / 2) * sqrt(free * explained / 2)
        # Written so that tiny probabilities are not lost in rounding.
        return float(single - (1 - single) * np.expm1(-crossings))
