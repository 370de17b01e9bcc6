"""Light of soot in each colour as curves over 1 / T, which Newton's steps invert."""

import numpy as np
from scipy.interpolate import CubicSpline

from lf_flame.errors import InputError
from lf_flame.tomography.spectra import SpectralResponses

LEAST_K, MOST_K = 500.0, 5000.0
"""Range of temperatures in K of glowing soot; temperatures outside count as undetermined."""

LEAST_LEVER_K = 30.0
"""Smallest derivative of the logarithm of a ratio of colours by 1 / T, in K, with which there is a
temperature: at 1,800 K an error of 1 % in the ratio is then 1,080 K."""

NEWTON_STEPS = 6
"""Number of Gauss-Newton steps; they start within 1e-4 of the solution of two colours."""


class LogCurves:
    """Logarithm of soot's light in each colour as a function of 1 / T."""

    def __init__(self, responses: SpectralResponses, exponent: float):
        self.inverse = np.linspace(1 / (4 * MOST_K), 2 / LEAST_K, 1025)
        logs = np.log(responses.soot(1 / self.inverse, exponent))
        self._curves = [CubicSpline(self.inverse, one) for one in logs]
        # The two colours whose ratio changes most with temperature.
        ends = logs[:, -1] - logs[:, 0]
        self._outer = int(np.argmin(ends)), int(np.argmax(ends))
        self._ratio = logs[self._outer[0]] - logs[self._outer[1]]
        steps = -np.diff(self._ratio) / np.diff(self.inverse)
        if not steps.min() >= LEAST_LEVER_K:
            names = [responses.names[one] for one in self._outer]
            raise InputError(
                f"The ratio of {names[0]} to {names[1]} must tell the temperature, and it hardly "
                f"changes with it, or is the same at two temperatures: these colours see nearly "
                f"the same light."
            )

    def invert(self, wanted: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Find 1 / T and its standard deviation, if weights are those of inverse variances."""
        low, high = self.inverse[0], self.inverse[-1]
        ratio = wanted[self._outer[0]] - wanted[self._outer[1]]
        inverse = np.interp(ratio, self._ratio[::-1], self.inverse[::-1])
        for _ in range(NEWTON_STEPS):
            rest = centred(wanted - np.stack([one(inverse) for one in self._curves]), weights)
            slopes, curvature = self._slopes(inverse, weights)
            step = np.sum(weights * slopes * rest, axis=0) / curvature
            inverse = np.clip(inverse + step, low, high)
        return inverse, self._slopes(inverse, weights)[1] ** -0.5

    def _slopes(self, inverse: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Slopes of the curves less their weighted mean, and the sum of their weighted squares."""
        slopes = np.stack([one(inverse, 1) for one in self._curves])
        slopes = centred(slopes, weights)
        return slopes, np.sum(weights * slopes**2, axis=0)

    def compare(
        self, wanted: np.ndarray, inverse: np.ndarray, relative: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Chi-squared of soot at 1 / T, and its amount."""
        weights = relative**-2.0
        rest = wanted - np.stack([one(inverse) for one in self._curves])
        mean = np.sum(weights * rest, axis=0) / np.sum(weights, axis=0)
        return np.sum(weights * (rest - mean) ** 2, axis=0), np.exp(mean)


def centred(values: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Subtract the weighted mean over the colours: the amount of soot drops out."""
    return values - np.sum(weights * values, axis=0) / np.sum(weights, axis=0)
