"""Refocusing by formula followed by a denoiser: the reference for networks in low light.

Both denoisers are scikit-image's. They assume uniform noise, but the variance of shot noise is
proportional to the light. They are therefore applied to square roots (Anscombe 1948), whose noise
is uniform. Its strength is estimated from each refocused image alone, because a network does not
know the amount of light either.
"""

from collections.abc import Callable

import numpy as np
from scipy.ndimage import correlate, uniform_filter
from scipy.optimize import brentq
from skimage.restoration import denoise_nl_means, denoise_tv_chambolle

from lf_flame.systems.base import RefocusingSystem, ViewIndices
from lf_flame.systems.formulas import ShiftAndSum

LAPLACIANS = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]])
"""Difference of two Laplacians: it is 0 for planes and for straight edges along an axis."""

NON_LOCAL = {"patch_size": 5, "patch_distance": 6, "fast_mode": True}
FILTERING = 0.8
"""Filtering of non-local means, in standard deviations of the noise, as recommended by
scikit-image's example of its fast mode for known noise."""

WEIGHTS = 0.05, 50.0
"""Range of the weights of total variation, in standard deviations of the noise."""

LEAST = 1e-8
"""Light of an electron, in full scales, below which an image is not denoised: its noise is below
1e-4, and rounding to 8 bits has 1e-3."""


class Denoised(RefocusingSystem):
    """Shift-and-sum of selected views, followed by a denoiser.

    Parameters
    ----------
    system : ShiftAndSum
        System that refocuses.
    denoise : callable
        Function of a grey image and the standard deviation of its noise; returns the denoised
        image: `non_local_means` or `total_variation`.
    name : str
        Name in tables.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame.systems import Denoised, ShiftAndSum
    >>> from lf_flame.systems.denoised import total_variation
    >>> views = np.random.default_rng(1).uniform(size=(3, 3, 20, 30))
    >>> Denoised(ShiftAndSum(), total_variation, "denoised").refocus(views, [0.0]).shape
    (1, 20, 30)
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
        electron = estimate_electron(image)
        if electron < LEAST:
            return image
        roots = 2 * np.sqrt(image / electron + 3 / 8)  # with noise of standard deviation 1
        cleaned = self._denoise(roots, 1.0)
        return (electron * ((cleaned / 2) ** 2 - 1 / 8)).astype(np.float32)


def estimate_electron(image: np.ndarray) -> float:
    """Estimate the light of one electron from an image with shot noise.

    The variance of the noise is that number times the light. It comes from the median of the
    absolute differences of Laplacians, divided by the root of the surrounding light; Immerkaer
    (1996) takes the mean, for uniform noise, which edges would dominate. Pixels without light are
    left out.

    Parameters
    ----------
    image : ndarray, shape (h, w)
        Image in full scales.

    Returns
    -------
    float
        Light of one electron in full scales; 0 for a dark image.
    """
    around = uniform_filter(image.astype(float), 3, mode="mirror")
    lit = (image > 0) & (around > 0)
    if not lit.any():
        return 0.0
    differences = np.abs(correlate(image.astype(float), LAPLACIANS, mode="mirror"))[lit]
    spread = np.sqrt(np.sum(np.square(LAPLACIANS)))
    root = np.median(differences / np.sqrt(around[lit])) / 0.6745 / spread
    return float(root**2)  # 0.6745 is the median of |normal|


def non_local_means(image: np.ndarray, noise: float) -> np.ndarray:
    """Denoise by non-local means (Buades, Coll & Morel 2005; Darbon et al. 2008)."""
    return denoise_nl_means(image, h=FILTERING * noise, sigma=noise, **NON_LOCAL)


def total_variation(image: np.ndarray, noise: float) -> np.ndarray:
    """Denoise with total variation, with the strength at which the removed part equals the noise.

    Chambolle (2004), section 4: the root-mean-square difference from the image is the noise.
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
