"""How well the views match at each slope, judged by those views that see a place.

Shifted by the right slope all views show what the middle one does, but for those before which
something stands nearer. At a straight outline that hides it from one side of the aperture at most:
so besides all views each half and each quarter of them is asked (Kang, Szeliski, Chai, CVPR 2001,
choose halves of a sequence; Wang, Efros, Ramamoorthi, ICCV 2015, the sides of an outline in the
aperture), and the best answer counts. As fewer views agree more easily by chance, they have to be
better by something.

Squared differences e from the middle become ``e / (e + scale)`` before they are averaged over a
window (Geman, McClure, Bull. Int. Stat. Inst. 52, 5, 1987), the scale being about the noise. Else
one sharp outline outweighs the faint texture beside it, and draws its surroundings to its own
slope.

Views are read by the cubic B-spline, without the filter that would make it interpolate: it blurs
alike at all fractions of a lenslet, where linear interpolation softens whole shifts less than
others, and draws slopes to them.
"""

from collections.abc import Iterator

import numpy as np
from scipy.ndimage import gaussian_filter

from lf_flame._common.arrays import centred
from lf_flame.refocus import _matching_kernels

HALF, QUARTER = 0.05, 0.1
"""By how much half the views, and a quarter, must match better than all, from 0 to 1."""

SCALE = 0.35
"""Squared difference that counts half, in those that noise makes."""

TOLERATED = 0.07
"""Error of a slope whose differences are small, too: views never match better in strong texture."""

FLOOR = 1e-3
"""Difference, in brightest pixels, that is called noise at least: 8 bits round by as much."""

SAMPLED_ROWS = 32
"""Rows, about, from which the noise is taken."""


def match_views(views: np.ndarray, slopes: np.ndarray, window: float) -> np.ndarray:
    """Tell how badly the views match around each pixel at each slope.

    Parameters
    ----------
    views : ndarray, shape (v, u, t, s)
        Grey and finite, of a type that kernels read.
    slopes : ndarray of float64, shape (n,)
    window : float
        Standard deviation of the Gaussian under which pixels count, in lenslets.

    Returns
    -------
    ndarray of float32, shape (n, t, s)
        From 0, all alike, to about 1.
    """
    brightest = max(float(np.abs(row).max()) for row in views)
    unit = 1.0 / brightest if brightest > np.finfo(np.float32).tiny else 1.0
    counts = _views_in_parts(views.shape[:2])
    noise = _noise(views, slopes, unit, counts)
    misfit = max(TOLERATED**2, (slopes[1] - slopes[0]) ** 2 / 12)
    moved = misfit * sum((n**2 - 1) / 12 for n in views.shape[:2]) / 2
    costs = np.empty((len(slopes), *views.shape[2:]), np.float32)
    rows = np.arange(views.shape[2])
    for cost, slope in zip(costs, slopes, strict=True):
        parts, middle = _squares(views, float(slope), unit, rows)
        scale = np.float32(SCALE * noise) + np.float32(moved) * _steepness(middle)
        cost[...] = 1.0 + QUARTER
        for side, handicap in _sides(parts, counts):
            saturated = side / (side + scale)
            smooth = gaussian_filter(saturated, window, mode="nearest")
            np.minimum(cost, smooth + handicap, out=cost)
    return costs


def _sides(parts: np.ndarray, counts: np.ndarray) -> Iterator[tuple[np.ndarray, np.float32]]:
    """Mean square over all views, over each half and each quarter, and what that is worth less.

    Halves and quarters hold the middle row or column, too.
    """
    spans = (slice(0, 3), slice(0, 2), slice(1, 3))
    for i, down in enumerate(spans):
        for j, across in enumerate(spans):
            total = parts[down, across].sum(axis=(0, 1)) / np.float32(counts[down, across].sum())
            yield total, np.float32((0.0, HALF, QUARTER)[(i > 0) + (j > 0)])


def _noise(views: np.ndarray, slopes: np.ndarray, unit: float, counts: np.ndarray) -> float:
    """Squared difference that is left at the best slope, the median over some rows."""
    rows = np.arange(views.shape[2])[:: max(views.shape[2] // SAMPLED_ROWS, 1)]
    least = np.full((rows.size, views.shape[3]), np.inf, np.float32)
    for slope in slopes:
        total = _squares(views, float(slope), unit, rows)[0].sum(axis=(0, 1))
        np.minimum(least, total / np.float32(counts.sum()), out=least)
    return float(np.median(least)) + FLOOR**2


def _squares(views: np.ndarray, slope: float, unit: float, rows: np.ndarray):
    """Squared differences from the middle in the nine parts, (3, 3, rows, s), and the middle."""
    middle = np.empty((rows.size, views.shape[3]), np.float32)
    out = np.empty((rows.size, 9, views.shape[3]), np.float32)
    down, down_weights = _taps(slope, *views.shape[::2])
    across, across_weights = _taps(slope, *views.shape[1::2])
    # Lest squares leave the range of float32, the brightest pixel is 1.
    _matching_kernels.compare_views(
        views, rows, down, (unit * down_weights).astype(np.float32), across,
        across_weights.astype(np.float32), *map(_part_of_view, views.shape[:2]), middle, out,
    )  # fmt: skip
    return out.transpose(1, 0, 2).reshape(3, 3, rows.size, -1), middle


def _steepness(image: np.ndarray) -> np.ndarray:
    """Squared gradient at each pixel."""
    axes = [axis for axis in (0, 1) if image.shape[axis] > 1]
    return sum((np.gradient(image, axis=axis) ** 2 for axis in axes), np.zeros_like(image))


def _taps(slope: float, count: int, length: int) -> tuple[np.ndarray, np.ndarray]:
    """Where `count` views are read along an axis: first tap, [view], and weights, [view, tap]."""
    shifts = np.clip(slope * centred(count), -length, length)
    whole = np.floor(shifts)
    f = (shifts - whole)[:, None]
    g = 1 - f
    pieces = (g**3, 4 - 6 * f**2 + 3 * f**3, 4 - 6 * g**2 + 3 * g**3, f**3)
    return whole.astype(np.int64) - 1, np.concatenate(pieces, axis=1) / 6


def _part_of_view(count: int) -> np.ndarray:
    """0 for views before the middle, 1 for those in it (one, or two), 2 for those behind it."""
    at = centred(count)
    return (1 + np.sign(at) * (np.abs(at) >= 1)).astype(np.int64)


def _views_in_parts(shape: tuple[int, ...]) -> np.ndarray:
    """How many views each of the nine parts of the aperture has, (3, 3)."""
    down, across = (np.bincount(_part_of_view(count), minlength=3) for count in shape)
    return np.outer(down, across)
