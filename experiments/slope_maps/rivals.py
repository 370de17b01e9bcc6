"""Plain methods for slope maps, beside which the library's is measured."""

from collections.abc import Callable, Mapping

import numpy as np
from scipy.ndimage import gaussian_filter, median_filter, shift

from lf_flame._common.arrays import centred
from lf_flame.refocus import all_in_focus, shift_and_sum
from lf_flame.refocus.focus_map import TRUSTED

Found = tuple[np.ndarray, np.ndarray]
"""Slope of each pixel, and whether it is certain."""


def library(views: np.ndarray, slopes: np.ndarray) -> Found:
    """Slope map of the library."""
    found = all_in_focus(views, slopes)
    return found.slope, found.confidence >= TRUSTED


def thirty_lines(views: np.ndarray, slopes: np.ndarray) -> Found:
    """Least mean absolute difference from the central view.

    Over a cross and both diagonals of views, under a Gaussian of 1.2 pixels; then a median of 5.
    """
    steps = centred(len(views))
    middle = views[len(views) // 2, len(views) // 2]
    down, across = np.meshgrid(steps, steps, indexing="ij")
    star = (down == 0) | (across == 0) | (np.abs(down) == np.abs(across))
    costs = []
    for slope in slopes:
        moved = (
            shift(views[v, u], (-slope * steps[v], -slope * steps[u]), order=1, mode="nearest")
            for v, u in np.argwhere(star)
        )
        cost = sum(np.abs(one - middle) for one in moved)
        costs.append(gaussian_filter(cost, 1.2))
    return _smoothed(_least(np.stack(costs), slopes))


def defocus_and_correspondence(views: np.ndarray, slopes: np.ndarray) -> Found:
    """Sharpest slope and slope of least variance, weighted by their confidence.

    Local part of Tao, Hadap, Malik, Ramamoorthi, ICCV 2013; the confidence of each cue is the ratio
    of its best cost to the next best that is apart.
    """
    blur, variance = [], []
    for slope in slopes:
        mean, square = (shift_and_sum(one, slope).astype(float) for one in (views, views**2))
        steep = sum(np.abs(np.gradient(gaussian_filter(mean, 0.7), axis=a)) for a in (0, 1))
        blur.append(-gaussian_filter(steep, 2.5))
        variance.append(gaussian_filter(np.maximum(square - mean**2, 0), 2.5) ** 0.5)
    cues = [np.stack(blur), np.stack(variance)]
    total, weights = 0.0, 0.0
    for cue in cues:
        span = cue - cue.min()
        best = span.argmin(axis=0)
        apart = np.abs(np.arange(len(slopes))[:, None, None] - best) > 2
        weight = 1 - span.min(axis=0) / np.where(apart, span, np.inf).min(axis=0).clip(1e-9)
        total, weights = total + weight * _least(cue, slopes), weights + weight
    return _smoothed(total / np.maximum(weights, 1e-9))


def structure_tensor(views: np.ndarray, slopes: np.ndarray) -> Found:
    """Orientation of lines in epipolar images, where it is most coherent.

    Wanner, Goldluecke, CVPR 2012, local part; larger slopes after shearing by whole pixels.
    """
    best, slope = np.full(views.shape[2:], -1.0), np.zeros(views.shape[2:])
    middle = len(views) // 2
    for shear in range(int(np.floor(slopes[0])), int(np.ceil(slopes[-1])) + 1):
        for axis, lines in ((1, views[middle]), (0, views[:, middle])):
            steps = np.arange(len(views)) - middle
            pairs = zip(lines, steps, strict=True)
            epi = np.stack([np.roll(one, -shear * n, axis=axis) for one, n in pairs])
            epi = gaussian_filter(epi.astype(float), (0.8, 0.8, 0.8), mode="nearest")
            along, over = np.gradient(epi, axis=(axis + 1, 0))
            pp, pn, nn = (
                gaussian_filter(one, (1.5, 1.5, 1.5), mode="nearest")[middle]
                for one in (along**2, along * over, over**2)
            )
            found = np.tan(0.5 * np.arctan2(-2 * pn, pp - nn))
            coherent = ((pp - nn) ** 2 + 4 * pn**2) / np.maximum((pp + nn) ** 2, 1e-15)
            coherent = np.where(np.abs(found) < 0.8, coherent, -1.0)
            better = coherent > best
            best[better], slope[better] = coherent[better], shear + found[better]
    return _smoothed(slope)


WAYS: Mapping[str, Callable[[np.ndarray, np.ndarray], Found]] = {
    "library": library,
    "thirty plain lines": thirty_lines,
    "defocus and correspondence": defocus_and_correspondence,
    "structure tensor": structure_tensor,
}


def _smoothed(slope: np.ndarray) -> Found:
    """Median of 5 x 5 pixels; all are called certain."""
    return median_filter(slope, 5, mode="nearest"), np.ones(slope.shape, bool)


def _least(costs: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    """Slope of the least of costs[n, t, s], by a parabola through three."""
    k = costs.argmin(axis=0)
    middle = np.clip(k, 1, len(slopes) - 2)
    before, least, after = (
        np.take_along_axis(costs, (middle + i)[None], axis=0)[0] for i in (-1, 0, 1)
    )
    bend = np.maximum(before + after - 2 * least, 1e-12)
    offset = np.where(k == middle, (before - after) / (2 * bend), 0.0)
    return slopes[k] + (slopes[1] - slopes[0]) * np.clip(offset, -0.5, 0.5)
