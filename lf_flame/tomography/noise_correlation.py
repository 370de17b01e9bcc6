"""Correlation of the noise of neighbouring pixels and views, which decoding of a raw image makes.

Decoded views are interpolated, so neighbouring ones share pixels of the sensor. A sum over views,
as every cell of a fit is, then has more noise than its number of pixels says.
"""

import numpy as np

DARK = 0.02
"""Light relative to the brightest pixel below which a residual is noise alone, and not the model's
error too."""

FEWEST = 10_000
"""Smallest number of dark pixels with which correlation is measured: to about 5 %."""

LEAST_POWER = 0.01
"""Smallest mean square of the dark pixels' residual relative to that of all: below, there is no
noise to speak of in the dark."""

LEAST = 1.1
"""Smallest factor of the variance that counts as correlation."""

NEIGHBOURS = (0, 1), (1, -1), (1, 0), (1, 1)
"""One of each pair of opposite steps to a neighbour."""


def correlation_factor(residual: np.ndarray, light: np.ndarray, counted: np.ndarray) -> float:
    """Factor by which correlation raises the standard deviation of sums of a light field's noise.

    Parameters
    ----------
    residual, light : ndarray, shape (v, u, t, s)
        Part of the views that a fit does not explain, and the light that it does.
    counted : ndarray of bool, shape (v, u)
        Views that are fitted.

    Returns
    -------
    float
        1 or above; 1 where the field has too few dark pixels, or no noise in them.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame.tomography.noise_correlation import correlation_factor
    >>> noise = np.random.default_rng(1).standard_normal((6, 5, 40, 50))
    >>> nothing, every = np.zeros((5, 5, 40, 50)), np.ones((5, 5), bool)
    >>> correlation_factor(noise[1:], nothing, every)
    1.0
    >>> shared = (noise[1:] + noise[:-1]) / 2**0.5  # half of each view in the next one
    >>> 1.35 < correlation_factor(shared, nothing, every) < 1.45  # of sums along v: 2**0.5
    True
    """
    dark = (light <= DARK * float(light.max())) & counted[:, :, None, None]
    count = int(np.count_nonzero(dark))
    noise = np.where(dark, residual, 0).astype(np.float32)
    variance = float(np.sum(np.square(noise, dtype=np.float64))) / max(count, 1)
    fitted = max(int(np.count_nonzero(counted)) * int(np.prod(residual.shape[2:])), 1)
    whole = float(np.sum(np.square(residual, dtype=np.float64))) / fitted
    if count < FEWEST or not variance > LEAST_POWER * whole:
        return 1.0
    factor = 1.0
    for axis in (0, 2):  # neighbouring views, then neighbouring pixels
        shares = (_correlation(noise, dark, axis, lag) for lag in NEIGHBOURS)
        factor *= 1 + 2 * sum(shares) / variance
    return float(np.sqrt(factor)) if factor > LEAST else 1.0


def _correlation(noise: np.ndarray, dark: np.ndarray, axis: int, lag: tuple[int, int]) -> float:
    """Mean product of dark pixels that are a step apart along two axes from `axis` on."""
    here, there = [slice(None)] * 4, [slice(None)] * 4
    for at, step in zip((axis, axis + 1), lag, strict=True):
        size = noise.shape[at]
        here[at] = slice(max(step, 0), size + min(step, 0))
        there[at] = slice(max(-step, 0), size + min(-step, 0))
    one, other = tuple(here), tuple(there)
    pairs = np.count_nonzero(dark[one] & dark[other])
    total = np.einsum("vuts,vuts->", noise[one], noise[other], dtype=np.float64)
    return float(total) / pairs if pairs else 0.0
