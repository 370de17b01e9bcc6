"""Ways to a slope map that the library's is set beside."""

from collections.abc import Callable, Mapping

import numpy as np
from scipy.ndimage import gaussian_filter, median_filter

from lf_flame._common.arrays import centred
from lf_flame.refocus import all_in_focus, refocus, refocus_surface
from lf_flame.refocus.focus_map import TRUSTED

WINDOW = 3.0
"""Standard deviation, in lenslets, of the Gaussian under which every way sums."""

MEDIAN = 9
"""Lenslets along each side of the median's window."""

Found = tuple[np.ndarray, np.ndarray]
"""Slope of each pixel, and whether it is called certain."""


def library(views: np.ndarray, slopes: np.ndarray) -> Found:
    """Make the library's map."""
    found = all_in_focus(views, slopes)
    return found.slope, found.confidence >= TRUSTED


def all_views(views: np.ndarray, slopes: np.ndarray) -> Found:
    """Take the slope at which the views vary least around a pixel, and call every pixel certain.

    Mean square less squared mean, over all views, exactly shifted.
    """
    squares = (
        refocus(views**2, slopes, interpolation="sinc")
        - refocus(views, slopes, interpolation="sinc") ** 2
    )
    slope, inside = _peaks([-gaussian_filter(one.astype(float), WINDOW) for one in squares], slopes)
    return slope, inside


def median_of_all_views(views: np.ndarray, slopes: np.ndarray) -> Found:
    """Smooth that by a median."""
    slope, certain = all_views(views, slopes)
    return median_filter(slope, MEDIAN, mode="nearest"), certain


def sharpness(views: np.ndarray, slopes: np.ndarray) -> Found:
    """Make the map as the library did before: sharpest slice, filled by normalised convolution."""
    energies = [_energy(image) for image in refocus(views, slopes, interpolation="sinc")]
    slope, inside = _peaks(energies, slopes)
    peak, mean = np.max(energies, axis=0), np.mean(energies, axis=0)
    confidence = np.where(inside, (peak - mean) / (peak + 0.1 * peak.mean()), 0.0)
    disagreement = _disagreement(views, slope)
    confidence *= peak / np.maximum(peak + disagreement, np.finfo(float).tiny)
    return _convolved(slope, confidence), confidence >= TRUSTED


WAYS: Mapping[str, Callable[[np.ndarray, np.ndarray], Found]] = {
    "library": library,
    "sharpness, before": sharpness,
    "all views": all_views,
    "all views, median": median_of_all_views,
}


def _peaks(scores, slopes: np.ndarray) -> Found:
    """Slope of the highest score by a parabola through three, and whether it is not at an end."""
    scores = np.stack(scores)
    k = scores.argmax(axis=0)
    middle = np.clip(k, 1, len(slopes) - 2)
    before, top, after = (
        np.take_along_axis(scores, (middle + i)[None], axis=0)[0] for i in (-1, 0, 1)
    )
    bend = 2 * top - before - after
    inside = (k == middle) & (bend > 0)
    offset = np.where(inside, (after - before) / (2 * np.where(inside, bend, 1.0)), 0.0)
    return slopes[k] + (slopes[1] - slopes[0]) * offset, inside


def _energy(image: np.ndarray) -> np.ndarray:
    smooth = gaussian_filter(image.astype(float), 1.0, mode="nearest")
    energy = sum(np.gradient(smooth, axis=axis) ** 2 for axis in (0, 1))
    return gaussian_filter(energy, WINDOW, mode="nearest")


def _disagreement(views: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """Squared difference of all views from the middle ones, on the surface."""
    narrow = np.outer(*(np.abs(centred(n)) < 1 for n in views.shape[:2]))
    difference = refocus_surface(views, slope) - refocus_surface(views, slope, weights=narrow)
    smooth = gaussian_filter(difference.astype(float), 1.0, mode="nearest")
    return gaussian_filter(smooth**2, WINDOW, mode="nearest")


def _convolved(values: np.ndarray, confidence: np.ndarray) -> np.ndarray:
    """Fill by normalised convolution (Knutsson, Westin, CVPR 1993) at scales that double."""
    filled, missing = np.zeros(values.shape), np.ones(values.shape)
    for scale in (0.0, *2.0 ** np.arange(np.log2(max(values.shape)) - 1)):
        trust, trusted = (
            gaussian_filter(image, scale, mode="nearest", truncate=2.0)
            for image in (confidence, confidence * values)
        )
        weight = missing * np.minimum(trust / TRUSTED, 1.0)
        filled += weight * trusted / np.maximum(trust, np.finfo(float).tiny)
        missing -= weight
    return filled + missing * np.average(values, weights=confidence)
