"""Noise of a series of heights: white noise of each frame, and correlated noise (wander).

The wander is an Ornstein-Uhlenbeck process, which at even times is the AR(1) noise of climate
series: its correlation falls as exp(-distance in time / memory). Times may be uneven. The inverse
of its covariance is tridiagonal (Rybicki and Press, Physical Review Letters 74, 1060, 1995), so
that all sums here take time in proportion to the number of frames.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import LinAlgError, cho_solve_banded, cholesky_banded
from scipy.optimize import minimize
from scipy.special import expit

SHORTEST_MEMORY = 0.3
"""Shortest memory that is tried, in median frame distances: neighbours then correlate by 0.04."""

MEMORIES, WHITE = 6, (-6.0, -2.0, 0.0, 2.0)
"""Start of the search: number of memories, and the logits of the fraction of white noise."""

IMPOSSIBLE = 1e300
"""Negative log-likelihood of noise with a covariance that cannot be inverted."""

MOST_STEPS = 80
"""Largest number of evaluations of the likelihood in the search, after those of its start."""


@dataclass(frozen=True)
class Wander:
    """Covariance of noise, in units of its variance.

    Attributes
    ----------
    memory_s : float
        Time in which the wander's correlation falls to 1 / e.
    white_share : float
        Fraction of the variance that is white noise, above 0, up to 1.
    """

    memory_s: float
    white_share: float

    def weigher(self, times: np.ndarray) -> "Weigher":
        """Prepare products with the covariance's inverse at these times, shape (n,), rising."""
        return Weigher(times, self)


class Weigher:
    """Products with the inverse of the covariance of `Wander` at given times.

    Attributes
    ----------
    log_determinant : float
        Logarithm of the covariance's determinant.
    """

    def __init__(self, times: np.ndarray, noise: Wander):
        steps = np.diff(times) / noise.memory_s
        kept = np.exp(-steps)
        gain = -1 / np.expm1(-2 * steps)
        # Inverse of the wander's covariance: its diagonal, and the diagonal beside it.
        self._diagonal = np.concatenate([[1.0], gain])
        self._diagonal[:-1] += kept**2 * gain
        self._beside = -kept * gain
        white = noise.white_share
        bands = np.zeros((2, len(times)))
        bands[0] = (1 - white) + white * self._diagonal
        bands[1, :-1] = white * self._beside
        self._factor = cholesky_banded(bands, lower=True)
        self.log_determinant = float(2 * np.log(self._factor[0]).sum() - np.log(gain).sum())

    def __call__(self, columns: np.ndarray) -> np.ndarray:
        """Multiply columns, shape (n, k), by the inverse of the covariance."""
        solved = cho_solve_banded((self._factor, True), columns)
        weighed = self._diagonal[:, None] * solved
        weighed[1:] += self._beside[:, None] * solved[:-1]
        weighed[:-1] += self._beside[:, None] * solved[1:]
        return weighed


def fit_wander(times: np.ndarray, values: np.ndarray, base: np.ndarray) -> Wander:
    """Find the noise with the highest likelihood for values about a base model.

    The likelihood is restricted (REML): fitting the base model does not make noise look whiter.

    Parameters
    ----------
    times, values : ndarray, shape (n,)
        Rising times, and values.
    base : ndarray, shape (n, k)
        Columns of the base model.
    """
    columns = np.column_stack([base, values])
    frame, duration = float(np.median(np.diff(times))), float(times[-1] - times[0])
    bounds = ((np.log(SHORTEST_MEMORY), np.log(duration / frame)), (-9.0, 9.0))

    def noise(point) -> Wander:
        return Wander(frame * float(np.exp(point[0])), float(expit(point[1])))

    def unlikely(point) -> float:
        return _minus_log_likelihood(noise(point).weigher(times), columns)

    starts = [(x, y) for x in np.linspace(*bounds[0], MEMORIES + 2)[1:-1] for y in WHITE]
    best = min(starts, key=unlikely)
    options = {"maxfev": MOST_STEPS, "xatol": 0.02, "fatol": 0.005}
    found = minimize(unlikely, best, method="Nelder-Mead", bounds=bounds, options=options)
    return noise(found.x)


def _minus_log_likelihood(weigh: Weigher, columns: np.ndarray) -> float:
    """Negative restricted log-likelihood of the last column about the others, at best variance."""
    count, known = columns.shape[0], columns.shape[1] - 1
    try:
        root = np.diag(np.linalg.cholesky(columns.T @ weigh(columns)))
    except LinAlgError:  # values without any noise
        return IMPOSSIBLE
    fitted = np.log(root[:known]).sum() + (count - known) * np.log(root[known])
    return float(weigh.log_determinant / 2 + fitted)
