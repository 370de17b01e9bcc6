"""Mismatch of the views at each slope, for those views that see a point.

Shifted by the right slope all views show the same as the central one, except where a nearer object
occludes the point. A straight outline occludes it on at most one side of the aperture. Therefore
all views, each half and each quarter of them are compared (Kang, Szeliski, Chai, CVPR 2001, choose
halves of a sequence; Wang, Efros, Ramamoorthi, ICCV 2015, the sides of an outline in the aperture),
and the best match is used. Because fewer views agree more easily by chance, they must match better
by a margin.

Absolute differences from the central view are clipped at a limit, which follows the contrast of the
image and the noise. Without it, one sharp outline outweighs the faint texture beside it, and its
slope spreads to its surroundings. They are averaged over little more than a pixel; what a single
pixel leaves open, its surroundings decide afterwards (`lf_flame.refocus.semi_global`).

Views that are darker or brighter than the central one, such as those near the rim of a lens, are
first brought to its level (`lf_flame.refocus.view_levels`); otherwise this is a mismatch at
every slope.

Views are read with the cubic B-spline, without the filter that would make it interpolate. It blurs
equally at all fractions of a lenslet. Linear interpolation softens whole shifts less than others,
which pulls slopes towards them.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from scipy.ndimage import gaussian_filter1d

from lf_flame._common import progress
from lf_flame._common.arrays import centred
from lf_flame._common.threads import parallel
from lf_flame.refocus.view_levels import even_levels, find_levels

MARGIN = 0.07
"""Margin, on a scale from 0 to 1, by which half of the views must match better than all; a quarter
must by twice as much."""

LIMIT = 0.07
"""Limit of differences, in standard deviations of the central view: with a small limit an
occluded view matters little, and so does a strong outline beside faint texture."""

NOISY = 2.5
"""Smallest limit, relative to the usual least difference, which is mostly noise."""

FLOOR = 1e-3
"""Smallest limit, relative to the brightest pixel; rounding to 8 bits is of this size."""

LEAST_SIDE = 0.125
"""Smallest weight of a half or quarter that is compared, relative to all views but the central."""

LEVEL_TURNS, SETTLED = 6, 1e-3
"""Largest number of times that the levels of uneven views are found, each time with the latest
slopes, and largest change of a level that ends this; with better levels, slopes become better."""

LEAST_READ = 500
"""Smallest number of pixels in the rows read; with fewer, levels would be chance, and are kept."""

LEAST_KNOWN = 0.05
"""Smallest fraction of pixels with known slopes; below it, levels are kept."""

SLOPE_WINDOW = 3.0
"""Standard deviation of the Gaussian along a row over which its slopes are found, in pixels."""

SAMPLED_ROWS = 16
"""Approximate number of rows from which noise and levels are estimated."""

TAPS = 4
"""Number of lenslets along an axis from which a shifted view is interpolated."""

OWN, BESIDE = np.float32(0.787), np.float32(0.1065)
"""Gaussian of a standard deviation of 0.5 lenslets that averages differences, in three taps."""


def sides(counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Shares of the nine parts in all views, each half and each quarter, and their margins.

    Halves and quarters include the central row or column. A side of little more than the
    central view, as in an off-centre aperture, is left out: it would match at every slope.
    """
    spans = (slice(0, 3), slice(0, 2), slice(1, 3))
    needed = LEAST_SIDE * (counts.sum() - counts[1, 1])
    shares, margins = [], []
    for i, down in enumerate(spans):
        for j, across in enumerate(spans):
            count = counts[down, across].sum()
            if count - counts[1, 1] >= needed:
                share = np.zeros((3, 3))
                share[down, across] = (counts[down, across] > 0) / count
                shares.append(share.ravel())
                margins.append(MARGIN * ((i > 0) + (j > 0)))
    return np.array(shares, np.float32), np.array(margins, np.float32)


class WeightedViews(NamedTuple):
    """Views with their weights and levels, for kernels."""

    views: np.ndarray
    """Grey views, shape (v, u, t, s)."""
    parts_down: np.ndarray
    """For each row of views: 0 before the centre, 1 in it, 2 after it."""
    parts_across: np.ndarray
    """For each column; the part of a view is ``3 parts_down + parts_across``."""
    weights: np.ndarray
    middle_weights: np.ndarray
    """Weights with which the views, (v, u), make the central view."""
    even: bool
    """Whether all views are as bright as the central one."""
    levels: np.ndarray
    """Factors of views that are not, (v, u, power), see `lf_flame.refocus.view_levels`."""


class ComparedViews:
    """Views with their weights, and levels that make them as bright as the central view.

    Parameters
    ----------
    views : ndarray, shape (v, u, t, s)
        Grey views, see `as_grey`.
    slopes : ndarray of float64, shape (n,)
        Slopes to compare at, in lenslets per view step.
    weights : ndarray of float64, shape (v, u)
        Weight of each view. All are compared with the central view, whatever its weight.

    Attributes
    ----------
    counts : ndarray of float64, shape (3, 3)
        Sum of the weights in each of the nine parts of the aperture; weights have mean 1.
    unit : float
        Factor that makes the brightest pixel 1, so that squares stay within float32.
    even : bool
        Whether all views are as bright as the central one.
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
        brightest = max(float(np.abs(row).max()) for row in views)
        self.unit = 1.0 / brightest if brightest > np.finfo(np.float32).tiny else 1.0
        self._levels = even_levels(views.shape[:2])
        self.even = True
        height = views.shape[2]
        self._rows = np.arange(0, height, max(height // SAMPLED_ROWS, 1))
        read = self._rows.size * views.shape[3]
        for _ in range(LEVEL_TURNS if read >= LEAST_READ else 0):
            best = self._best()[1]
            if not self.find_levels(best, np.ones(best.shape, bool)):
                break

    def find_levels(self, slope: np.ndarray, known: np.ndarray) -> bool:
        """Find the levels of the views from slopes in given or all rows; whether one changed."""
        if len(slope) != len(self._rows):
            slope, known = slope[self._rows], known[self._rows]
        if np.count_nonzero(known) < LEAST_KNOWN * known.size:
            return False
        before, even = self._levels, even_levels(self.views.shape[:2])
        self._levels = find_levels(self.views, slope, self._rows, self._weights, known)
        self.even = bool(np.array_equal(self._levels, even))
        return bool(np.abs(self._levels - before).max() > SETTLED)

    def limit(self) -> float:
        """Limit of differences, from the contrast and the noise of given rows."""
        least, _, contrast = self._best()
        return max(LIMIT * contrast, NOISY * float(np.median(least)), FLOOR)

    def costs(self, limit: float) -> np.ndarray:
        """Mismatch of the views at each pixel and slope, float32, shape (t, s, n).

        It is 0 for equal views, and about 1 where all differ by `limit` or more.
        """
        slopes, (height, width) = self.slopes, self.views.shape[2:]
        shares, margins = sides(self.counts)
        costs = np.empty((height, width, len(slopes)), np.float32)
        line = np.empty((height, width), np.float32)
        for n, slope in enumerate(progress.steps(slopes, "matching views", len(slopes), "slope")):
            parts = self._differences(float(slope), np.arange(height), limit)[0]
            choose_sides(parts, (shares / np.float32(limit)), margins, line)
            costs[..., n] = line
        return costs

    def _best(self) -> tuple[np.ndarray, np.ndarray, float]:
        """Least difference in given rows, about the slope where it occurs, and the contrast."""
        least = np.full((self._rows.size, self.views.shape[3]), np.inf, np.float32)
        smoothest, best = least.copy(), np.zeros(least.shape)
        for slope in self.slopes:
            parts, middle = self._differences(float(slope), self._rows, np.inf)
            total = parts[:, 9] / np.float32(self.counts.sum())
            np.minimum(least, total, out=least)
            smooth = gaussian_filter1d(total, SLOPE_WINDOW, axis=1, mode="nearest")
            best[smooth < smoothest] = slope
            np.minimum(smoothest, smooth, out=smoothest)
        return least, best, float(middle.std())

    def _differences(
        self, slope: float, rows: np.ndarray, limit: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Differences from the central view in nine parts and all, (rows, 10, s), and that view."""
        views = self.views
        middle = np.empty((rows.size, views.shape[3]), np.float32)
        out = np.empty((rows.size, 10, views.shape[3]), np.float32)
        down, down_weights = _taps(slope, *views.shape[::2])
        across, across_weights = _taps(slope, *views.shape[1::2])
        shifts = (slope * centred(n) for n in views.shape[:2])
        compare_views(
            self.weighted(), rows, down, (self.unit * down_weights).astype(np.float32),
            across, across_weights.astype(np.float32), int(np.abs(across).max()) + TAPS, *shifts,
            np.float32(limit), middle, out,
        )  # fmt: skip
        return out, middle

    def weighted(self) -> WeightedViews:
        """Bundle the views with their weights and levels, for kernels."""
        down, across = self._parts
        weights = self._weights.astype(np.float32)
        return WeightedViews(
            self.views, down, across, weights, self._middle, self.even, self._levels
        )


def _taps(slope: float, count: int, length: int) -> tuple[np.ndarray, np.ndarray]:
    """Find where `count` views are read along an axis: first tap [view], weights [view, tap]."""
    shifts = np.clip(slope * centred(count), -length, length)
    whole = np.floor(shifts)
    f = (shifts - whole)[:, None]
    g = 1 - f
    pieces = (g**3, 4 - 6 * f**2 + 3 * f**3, 4 - 6 * g**2 + 3 * g**3, f**3)
    return whole.astype(np.int64) - 1, np.concatenate(pieces, axis=1) / 6


def _part_of_view(count: int) -> np.ndarray:
    """Find 0 for views before the centre, 1 for those in it (one or two), 2 for those after it."""
    at = centred(count)
    return (1 + np.sign(at) * (np.abs(at) >= 1)).astype(np.int64)


@njit
def shift_row(view, row, down_weight, start, across_weight, reach, line, out):
    """Shift a row of a view along both axes: out[s].

    row[a]: rows that are read, down_weight[a] their weights; start: lenslet that tap 0 reads for
    s = 0; line: space for a row with `reach` lenslets beyond both ends, where the edges repeat.
    """
    width = out.size
    line[:] = 0.0
    for a in range(TAPS):
        lenslets, weight = view[row[a]], down_weight[a]
        for s in range(np.uint64(width)):
            line[np.uint64(reach) + s] += weight * lenslets[s]
    line[:reach] = line[reach]
    line[reach + width :] = line[reach + width - 1]
    out[:] = 0.0
    for b in range(TAPS):
        first, weight = np.uint64(reach + start + b), across_weight[b]
        for s in range(np.uint64(width)):
            out[s] += weight * line[first + s]


@njit
def add_differences(row, reference, count, limit, bounded, plain):
    """Add the absolute difference of two rows, times a weight; also bounded by `limit`."""
    for s in range(np.uint64(plain.size)):
        difference = abs(row[s] - reference[s])
        bounded[s] += count * min(difference, limit)
        plain[s] += count * difference


@njit
def bring_to_level(level, down, start, height, row):
    """Multiply a shifted row by a view's level, a polynomial in the view's own coordinates.

    down: row of the view that is shown; start: lenslet of the view shown at s = 0.
    """
    t = np.float32(2.0 * down / max(height - 1, 1) - 1.0)
    step = np.float32(2.0 / max(row.size - 1, 1))
    first = np.float32(start * step - 1.0)
    constant = level[0] + t * (level[1] + t * level[3])
    linear = level[2] + t * level[4]
    for s in range(np.uint64(row.size)):
        x = first + step * np.float32(s)
        row[s] *= constant + x * (linear + x * level[5])


@parallel(lambda rows: rows.size)
def compare_views(
    i, some, rows, down, down_weights, across, across_weights, reach, shifts_down,
    shifts_across, limit, middles, out,
):  # fmt: skip
    """Differences of shifted views from the central one: out[i, part, s] for row rows[i].

    Those of part 9 are the sum over all views, without a limit.
    The central view itself goes to middles[i, s].

    some: `WeightedViews`.
    down[v], across[u]: shift of tap 0; down_weights[v, a], across_weights[u, b]: weights of taps.
    reach: largest number of lenslets that any tap reads beyond a row.
    shifts_down[v], shifts_across[u]: whole shifts of the views.
    limit: of absolute differences.
    """
    views = some.views
    height, width = views.shape[2:]
    line, shifted = np.empty(width + 2 * reach, np.float32), np.empty(width, np.float32)
    middle, row = middles[i], np.empty(TAPS, np.int64)
    middle[:] = 0.0
    count = np.float32(0.0)
    out[i] = 0.0
    for turn in range(2):
        for v in range(views.shape[0]):
            for a in range(TAPS):
                row[a] = min(max(rows[i] + down[v] + a, 0), height - 1)
            for u in range(views.shape[1]):
                part = 3 * some.parts_down[v] + some.parts_across[u]
                used = some.weights[v, u] if turn == 1 else some.middle_weights[v, u]
                if used > 0.0:
                    shift_row(views[v, u], row, down_weights[v], across[u], across_weights[u],
                              reach, line, shifted)  # fmt: skip
                    if not some.even:
                        bring_to_level(some.levels[v, u], rows[i] + shifts_down[v],
                                       shifts_across[u], height, shifted)  # fmt: skip
                    if turn == 1:
                        add_differences(shifted, middle, used, limit, out[i, part], out[i, 9])
                    else:
                        for s in range(np.uint64(width)):
                            middle[s] += used * shifted[s]
                        count += used
        if turn == 0:
            for s in range(np.uint64(width)):
                middle[s] /= count


@parallel(lambda out: len(out))
def choose_sides(t, parts, shares, margins, out):
    """Least mismatch of all sides of the aperture: out[t, s], from parts[t, part, s].

    shares[side, part]: weights of a side's parts; margins[side] are added. Parts are averaged over
    3 x 3 lenslets first.
    """
    height, width = out.shape
    above, below = max(t - 1, 0), min(t + 1, height - 1)
    down, smooth = np.empty(width, np.float32), np.empty((9, width), np.float32)
    out[t, :] = np.inf
    for part in range(9):
        mix_lines(parts[above, part], parts[t, part], parts[below, part], down)
        smooth[part, 0] = OWN * down[0] + BESIDE * (down[0] + down[min(1, width - 1)])
        last = down[width - 1]
        smooth[part, width - 1] = OWN * last + BESIDE * (last + down[max(width - 2, 0)])
        mix_lines(down[:-2], down[1:-1], down[2:], smooth[part, 1:-1])
    for side in range(margins.size):
        down[:] = margins[side]
        for part in range(9):
            share = shares[side, part]
            if share > 0.0:
                for s in range(np.uint64(width)):
                    down[s] += share * smooth[part, s]
        for s in range(np.uint64(width)):
            out[t, s] = min(out[t, s], down[s])


@njit
def mix_lines(before, own, after, out):
    """Weighted mean of three lines."""
    for s in range(np.uint64(out.size)):
        out[s] = OWN * own[s] + BESIDE * (before[s] + after[s])
