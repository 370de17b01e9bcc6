"""Refocusing by formula, and a denoiser behind it: what a network in low light has to beat.

Both denoisers are scikit-image's. Their strength follows from the noise of each refocused image,
which is estimated from the image alone: a network is not told how much light there was, either.
"""

from collections.abc import Callable

import numpy as np
from scipy.ndimage import correlate
from scipy.optimize import brentq
from skimage.restoration import denoise_nl_means, denoise_tv_chambolle

from lf_flame.systems.base import RefocusingSystem, ViewIndices
from lf_flame.systems.formulas import ShiftAndSum

LAPLACIANS = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]])
"""The difference of two Laplacians: blind to planes and to straight edges along an axis."""

NON_LOCAL = {"patch_size": 5, "patch_distance": 6, "fast_mode": True}
FILTERING = 0.8
"""Filtering of non-local means, in standard deviations of the noise: what scikit-image's example
recommends for its fast mode where the noise is known."""

WEIGHTS = 0.05, 50.0
"""Weights of total variation that are tried, in standard deviations of the noise."""

DARK = 1e-4
"""Noise below which an image is left as it is: a tenth of a level of 8 bits is 4e-4."""


class Denoised(RefocusingSystem):
    """Shift-and-sum of some views, each image denoised.

    Parameters
    ----------
    system : ShiftAndSum
    denoise : callable
        Takes a grey image and the standard deviation of its noise, gives the denoised one:
        `non_local_means` or `total_variation`.
    name : str
    """

    def __init__(self, system: ShiftAndSum, denoise: Callable[..., np.ndarray], name: str):
        self.name, self._system, self._denoise = name, system, denoise

    def view_indices(self, rows: int, columns: int) -> ViewIndices:
        """Choose the views of the system that is denoised."""
        return self._system.view_indices(rows, columns)

    def _refocus(self, views: np.ndarray, slopes: np.ndarray, block) -> np.ndarray:
        stack = self._system.refocus(views, slopes, block)
        if stack.ndim == 3:
            return np.stack([self._cleaned(image) for image in stack])
        channels = [[self._cleaned(x) for x in np.moveaxis(image, -1, 0)] for image in stack]
        return np.moveaxis(np.array(channels), 1, -1)

    def _cleaned(self, image: np.ndarray) -> np.ndarray:
        noise = estimate_noise(image)
        return self._denoise(image, noise).astype(np.float32) if noise > DARK else image


def estimate_noise(image: np.ndarray) -> float:
    """Estimate the standard deviation of white noise in an image.

    By the median of the absolute differences of Laplacians, where Immerkaer (1996) takes the mean:
    edges, and the many pixels of a flame's picture without light and so without noise, would
    decide that. Pixels without light are left out.

    Parameters
    ----------
    image : ndarray, shape (h, w)

    Returns
    -------
    float
        0 for an image that is dark.
    """
    lit = image > 0
    if not lit.any():
        return 0.0
    differences = np.abs(correlate(image.astype(float), LAPLACIANS, mode="mirror"))[lit]
    spread = np.sqrt(np.sum(np.square(LAPLACIANS)))
    return float(np.median(differences) / 0.6745 / spread)  # 0.6745: the median of |normal|


def non_local_means(image: np.ndarray, noise: float) -> np.ndarray:
    """Denoise by non-local means (Buades, Coll & Morel 2005; Darbon et al. 2008)."""
    return denoise_nl_means(image, h=FILTERING * noise, sigma=noise, **NON_LOCAL)


def total_variation(image: np.ndarray, noise: float) -> np.ndarray:
    """Denoise by total variation, so strongly that what goes is as much as the noise.

    Chambolle (2004), section 4: the root-mean-square difference to the image is the noise.
    """

    def excess(log_weight: float) -> float:
        cleaned = denoise_tv_chambolle(image, np.exp(log_weight))
        return float(np.sqrt(np.mean(np.square(cleaned - image, dtype=float)))) / noise - 1

    low, high = (np.log(weight * noise) for weight in WEIGHTS)
    if excess(low) > 0 or excess(high) < 0:
        found = low if excess(low) > 0 else high
    else:
        found = brentq(excess, low, high, xtol=0.02)
    return denoise_tv_chambolle(image, np.exp(found))
