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

Views that are darker or brighter than the middle one, as towards the rim of a lens, are brought to
its level first (`lf_flame.refocus.view_levels`): else that counts as a mismatch at every slope.

Views are read by the cubic B-spline, without the filter that would make it interpolate: it blurs
alike at all fractions of a lenslet, where linear interpolation softens whole shifts less than
others, and draws slopes to them.
"""

from collections.abc import Iterator

import numpy as np
from scipy.ndimage import gaussian_filter, gaussian_filter1d

from lf_flame._common import progress
from lf_flame._common.arrays import centred
from lf_flame.refocus import _matching_kernels
from lf_flame.refocus.view_levels import even_levels, find_levels

HALF, QUARTER = 0.05, 0.1
"""By how much half the views, and a quarter, must match better than all, from 0 to 1."""

SCALE = 0.35
"""Squared difference that counts half, in those that noise makes."""

TOLERATED = 0.07
"""Error of a slope whose differences are small, too: views never match better in strong texture."""

FLOOR = 1e-3
"""Difference, in brightest pixels, that is called noise at least: 8 bits round by as much."""

LEAST_SIDE = 0.125
"""Share of what all views beside the middle count, below which a half or a quarter is not asked."""

LEVEL_TURNS, SETTLED = 6, 1e-3
"""Times at most that the levels of uneven views are found, each time by the slopes found last, and
change of a level that is called none: slopes that unevenness spoilt become better with it."""

LEAST_READ = 500
"""Pixels in the rows that are read, below which chance makes levels: they stay as they are."""

LEAST_KNOWN = 0.05
"""Share of the pixels whose slopes are known, below which levels are left as they are."""

SLOPE_WINDOW = 3.0
"""Standard deviation, in pixels of a row, of the Gaussian over which its slopes are found."""

SAMPLED_ROWS = 32
"""Rows, about, from which noise and levels are taken."""


def match_views(
    views: np.ndarray, slopes: np.ndarray, window: float, weights: np.ndarray | None = None
) -> np.ndarray:
    """Tell how badly the views match around each pixel at each slope: `ComparedViews.costs`."""
    weights = np.ones(views.shape[:2]) if weights is None else weights
    return ComparedViews(views, slopes, weights).costs(window)


def _sides(parts: np.ndarray, counts: np.ndarray) -> Iterator[tuple[np.ndarray, np.float32]]:
    """Mean square over all views, over each half and each quarter, and what that is worth less.

    Halves and quarters hold the middle row or column, too. One with hardly more than the middle,
    as beside an aperture that is off it, is left out: it would match at every slope.
    """
    spans = (slice(0, 3), slice(0, 2), slice(1, 3))
    needed = LEAST_SIDE * (counts.sum() - counts[1, 1])
    for i, down in enumerate(spans):
        for j, across in enumerate(spans):
            count = counts[down, across].sum()
            if count - counts[1, 1] >= needed:
                total = parts[down, across].sum(axis=(0, 1)) / np.float32(count)
                yield total, np.float32((0.0, HALF, QUARTER)[(i > 0) + (j > 0)])


class ComparedViews:
    """Views, what each counts, and by what it is brought to the level of the middle one.

    Parameters
    ----------
    views : ndarray, shape (v, u, t, s)
        Grey and finite, of a type that kernels read.
    slopes : ndarray of float64, shape (n,)
    weights : ndarray of float64, shape (v, u)
        How much each view counts. All are compared with the middle one, whatever it counts.

    Attributes
    ----------
    counts : ndarray of float64, shape (3, 3)
        What the views in each of the nine parts of the aperture count, 1 in the mean.
    even : bool
        Whether all views are as bright as the middle one.
    """

    def __init__(self, views: np.ndarray, slopes: np.ndarray, weights: np.ndarray):
        self.views, self.slopes = views, slopes
        self._weights = weights / weights[weights > 0].mean()
        self._parts = [_part_of_view(n) for n in views.shape[:2]]
        middle = np.outer(*(part == 1 for part in self._parts))
        chosen = np.where(middle, self._weights, 0)
        self._middle = (chosen if chosen.any() else middle).astype(np.float32)
        self.counts = np.zeros((3, 3))
        np.add.at(self.counts, np.ix_(*self._parts), self._weights)
        # Lest squares leave the range of float32, the brightest pixel is 1.
        brightest = max(float(np.abs(row).max()) for row in views)
        self._unit = 1.0 / brightest if brightest > np.finfo(np.float32).tiny else 1.0
        self._levels = even_levels(views.shape[:2])
        self.even = True
        height = views.shape[2]
        self._rows = np.arange(height)[:: max(height // SAMPLED_ROWS, 1)]
        read = self._rows.size * views.shape[3]
        for _ in range(LEVEL_TURNS if read >= LEAST_READ else 0):
            best = self._best()[1]
            if not self.find_levels(best, np.ones(best.shape, bool)):
                break

    def find_levels(self, slope: np.ndarray, known: np.ndarray) -> bool:
        """Find the levels of the views by the slopes of pixels in some rows, or in all.

        Returns
        -------
        bool
            Whether they have changed by more than `SETTLED`.
        """
        if len(slope) != len(self._rows):
            slope, known = slope[self._rows], known[self._rows]
        if np.count_nonzero(known) < LEAST_KNOWN * known.size:
            return False
        before, even = self._levels, even_levels(self.views.shape[:2])
        self._levels = find_levels(self.views, slope, self._rows, self._weights, known)
        self.even = bool(np.array_equal(self._levels, even))
        return bool(np.abs(self._levels - before).max() > SETTLED)

    def costs(self, window: float) -> np.ndarray:
        """Tell how badly the views match around each pixel at each slope.

        Parameters
        ----------
        window : float
            Standard deviation of the Gaussian under which pixels count, in lenslets.

        Returns
        -------
        ndarray of float32, shape (n, t, s)
            From 0, all alike, to about 1.
        """
        views, slopes = self.views, self.slopes
        noise = float(np.median(self._best()[0])) + FLOOR**2
        misfit = max(TOLERATED**2, (slopes[1] - slopes[0]) ** 2 / 12)
        down, across = (np.square(centred(n)) for n in views.shape[:2])
        moved = misfit * np.average(down[:, None] + across, weights=self._weights) / 2
        costs = np.empty((len(slopes), *views.shape[2:]), np.float32)
        rows = np.arange(views.shape[2])
        each = zip(costs, slopes, strict=True)
        for cost, slope in progress.steps(each, "matching views", len(slopes), "slope"):
            parts, middle = self._squares(float(slope), rows)
            scale = np.float32(SCALE * noise) + np.float32(moved) * _steepness(middle)
            cost[...] = 1.0 + QUARTER
            for side, handicap in _sides(parts, self.counts):
                saturated = side / (side + scale)
                smooth = gaussian_filter(saturated, window, mode="nearest")
                np.minimum(cost, smooth + handicap, out=cost)
        return costs

    def _best(self) -> tuple[np.ndarray, np.ndarray]:
        """Least squared difference in some rows, and about the slope at which it is."""
        least = np.full((self._rows.size, self.views.shape[3]), np.inf, np.float32)
        smoothest, best = least.copy(), np.zeros(least.shape)
        for slope in self.slopes:
            total = self._squares(float(slope), self._rows)[0].sum(axis=(0, 1))
            total /= np.float32(self.counts.sum())
            np.minimum(least, total, out=least)
            smooth = gaussian_filter1d(total, SLOPE_WINDOW, axis=1, mode="nearest")
            best[smooth < smoothest] = slope
            np.minimum(smoothest, smooth, out=smoothest)
        return least, best

    def _squares(self, slope: float, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Squared differences from the middle in nine parts, (3, 3, rows, s), and the middle."""
        views = self.views
        middle = np.empty((rows.size, views.shape[3]), np.float32)
        out = np.empty((rows.size, 9, views.shape[3]), np.float32)
        down, down_weights = _taps(slope, *views.shape[::2])
        across, across_weights = _taps(slope, *views.shape[1::2])
        shifts = (slope * centred(n) for n in views.shape[:2])
        _matching_kernels.compare_views(
            views, rows, down, (self._unit * down_weights).astype(np.float32), across,
            across_weights.astype(np.float32), *self._parts, self._weights.astype(np.float32),
            self._middle, *shifts, self.even, self._levels, middle, out,
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
