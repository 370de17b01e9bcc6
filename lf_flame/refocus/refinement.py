"""Slopes between those searched, by least squares over the views.

A change of the slope moves each view's picture of a point along its gradient (Adelson, Wang, IEEE
Trans. Pattern Anal. Mach. Intell. 14, 99, 1992). The costs of the search do not show it: their
limit makes them flat a step away. The gradient is that of the mean of the matching views, because
noise in the gradient of a single view would pass for texture, and pull faint slopes to those found.
Views that differ from the central one, as occluded ones do, have almost no weight.

A fit of one pixel is uncertain. Therefore the equations of the pixels around it are added, of
similar brightness and of about the same slope, each at its own: a tilted surface stays tilted.
"""

import math

import numpy as np
from numba import njit

from lf_flame._common.arrays import centred
from lf_flame._common.threads import parallel, without_refcounts
from lf_flame.refocus.matching import ComparedViews
from lf_flame.refocus.semi_global import ALIKE, SAME, in_deviations

WINDOW, REACH = 2.0, 3
"""Standard deviation, in lenslets, of the Gaussian under which equations are added, and largest
distance in these."""

OUTLYING = 1.5
"""Difference above which a view has little weight, relative to the limit of the search,
which leaves larger differences than chance."""

SCATTER = 3.0
"""Limit of differences in the search, relative to the usual difference at the right slope."""

MOST_CHANGE = 0.6
"""Largest change of a slope, in steps of the search; a larger one is an outlier, and is left out.
"""

MOST_SHIFT = 1.0
"""Largest shift of the outermost view by a change of the slope, in lenslets; gradients do not reach
further. It matters where the search is coarse."""


def refine_slopes(
    compared: ComparedViews, slope: np.ndarray, guide: np.ndarray, limit: float
) -> np.ndarray:
    """Change each pixel's slope by the small amount at which the views around it agree best.

    Pixels of other brightness of the guide have less weight; limit: see `ComparedViews.limit`.
    """
    step = compared.slopes[1] - compared.slopes[0]
    equations = set_up_equations(compared, slope, OUTLYING * limit)
    change = fit_changes(slope, equations, guide, step, limit / SCATTER)
    farthest = max(centred(n)[-1] for n in compared.views.shape[:2])
    return slope + np.where(farthest * np.abs(change) <= MOST_SHIFT, change, 0.0)


def set_up_equations(
    compared: ComparedViews, slope: np.ndarray, limit: float
) -> tuple[np.ndarray, np.ndarray]:
    """Numerator and denominator, at each pixel, of the least-squares change of its slope.

    Brightness, and its changes along the views' rows v and columns u, are fitted together: a view
    at (v, u) differs from their mean by the change times ``v down + u across``, (down, across)
    being the gradient. Beyond a difference of `limit` a view has little weight.
    """
    numerator, denominator = np.empty((2, *slope.shape))
    _fit_views(
        slope.astype(np.float32), compared.weighted(), np.float32(compared.unit),
        np.float32(limit), numerator, denominator,
    )  # fmt: skip
    return numerator, denominator


def fit_changes(
    slope: np.ndarray,
    equations: tuple[np.ndarray, np.ndarray],
    guide: np.ndarray,
    step: float,
    scatter: float,
) -> np.ndarray:
    """Fit the change of each pixel's slope to the equations around it.

    Where the usual difference of views at the right slope, `scatter`, exceeds what a change of half
    a step of the search makes, the change is nearly 0.
    """
    distances = np.arange(int(np.ceil(REACH * WINDOW)) + 1)
    near = np.exp(-((distances / WINDOW) ** 2) / 2)
    change, least = np.empty(slope.shape), (2 * scatter / step) ** 2
    _fit(slope, *equations, in_deviations(guide) / ALIKE, near, SAME * step, least, change)
    return np.where(np.abs(change) <= MOST_CHANGE * step, change, 0.0)


@parallel(lambda slope: len(slope))
def _fit_views(t, slope, some, unit, limit, numerator, denominator):
    """Equations of each pixel, see `set_up_equations`: numerator[t, s] and denominator[t, s].

    some: `lf_flame.refocus.matching.WeightedViews`; unit: factor of all views.
    """
    rows, columns, height, width = some.views.shape
    y, y_taps = np.empty((rows, 4), np.uint64), np.empty((rows, 8), np.float32)
    x, x_taps = np.empty((columns, 4), np.uint64), np.empty((columns, 8), np.float32)
    for s in range(width):
        for v in range(rows):
            _place_taps(t + slope[t, s] * (v - (rows - 1) / 2), height, y[v], y_taps[v])
        for u in range(columns):
            _place_taps(s + slope[t, s] * (u - (columns - 1) / 2), width, x[u], x_taps[u])
        middle, count = 0.0, 0.0
        for v in range(rows):
            for u in range(columns):
                if some.middle_weights[v, u] > 0:
                    read = _read_view(some, slope[t, s], v, u, t, s, y, y_taps, x, x_taps)
                    middle += some.middle_weights[v, u] * unit * read[0]
                    count += some.middle_weights[v, u]
        middle /= count
        total, off, along_t, along_s, by_v, by_u = 1e-30, 0.0, 0.0, 0.0, 0.0, 0.0
        vv, vu, uu, off_v, off_u = 0.0, 0.0, 0.0, 0.0, 0.0
        for v in range(rows):
            down = v - (rows - 1) / 2
            for u in range(columns):
                if some.weights[v, u] == 0:
                    continue
                across = u - (columns - 1) / 2
                read = _read_view(some, slope[t, s], v, u, t, s, y, y_taps, x, x_taps)
                apart = unit * read[0] - middle
                fit = 1 / (1 + (apart / limit) ** 2)
                fit *= fit * some.weights[v, u]
                total += fit
                off += fit * apart
                along_t += fit * unit * read[1]
                along_s += fit * unit * read[2]
                by_v += fit * down
                by_u += fit * across
                vv += fit * down * down
                vu += fit * down * across
                uu += fit * across * across
                off_v += fit * down * apart
                off_u += fit * across * apart
        along_t /= total
        along_s /= total
        above = along_t * (off_v - by_v * off / total) + along_s * (off_u - by_u * off / total)
        numerator[t, s] = -above
        denominator[t, s] = (
            along_t * along_t * (vv - by_v * by_v / total)
            + 2 * along_t * along_s * (vu - by_v * by_u / total)
            + along_s * along_s * (uu - by_u * by_u / total)
        )


@without_refcounts
def _read_view(some, slope, v, u, t, s, y, y_taps, x, x_taps):
    """Read view (v, u) where it shows pixel (t, s): value, and derivatives along t and s."""
    value, along_t, along_s = np.float32(0.0), np.float32(0.0), np.float32(0.0)
    for a in range(4):
        part, change = np.float32(0.0), np.float32(0.0)
        for b in range(4):
            light = some.views[v, u, y[v, a], x[u, b]]
            part += x_taps[u, b] * light
            change += x_taps[u, b + 4] * light
        value += y_taps[v, a] * part
        along_t += y_taps[v, a + 4] * part
        along_s += y_taps[v, a] * change
    if not some.even:
        rows, columns, height, width = some.views.shape
        p = 2 * (t + slope * (v - (rows - 1) / 2)) / max(height - 1, 1) - 1
        q = 2 * (s + slope * (u - (columns - 1) / 2)) / max(width - 1, 1) - 1
        own = some.levels[v, u]
        level = own[0] + p * (own[1] + p * own[3]) + q * (own[2] + p * own[4] + q * own[5])
        level = np.float32(level)
        value, along_t, along_s = level * value, level * along_t, level * along_s
    return value, along_t, along_s


@njit
def _place_taps(place, length, index, taps):
    """Lenslets that the cubic B-spline reads for a point, their weights, and their derivatives.

    Beyond the edges the edge is read.
    """
    whole = math.floor(place)
    f = place - whole
    g = 1.0 - f
    for a in range(4):
        index[a] = min(max(whole - 1 + a, 0), length - 1)
    taps[0], taps[3] = g * g * g / 6, f * f * f / 6
    taps[1] = (4 - 6 * f * f + 3 * f * f * f) / 6
    taps[2] = (4 - 6 * g * g + 3 * g * g * g) / 6
    taps[4], taps[7] = -g * g / 2, f * f / 2
    taps[5], taps[6] = f * (f * 1.5 - 2), g * (2 - g * 1.5)


@parallel(lambda slope: len(slope))
def _fit(t, slope, numerator, denominator, guide, near, same, least, change):
    """Ratio of the sums of numerators and denominators over pixels of about the same slope.

    near[distance]: weights along either axis; same: largest difference of slopes; least is added to
    the denominator, so that a change without evidence is 0.
    """
    height, width = slope.shape
    reach = near.size - 1
    for s in range(width):
        above, below = 0.0, least
        for y in range(max(t - reach, 0), min(t + reach + 1, height)):
            for x in range(max(s - reach, 0), min(s + reach + 1, width)):
                if abs(slope[y, x] - slope[t, s]) <= same:
                    unlike = guide[y, x] - guide[t, s]
                    weight = near[abs(y - t)] * near[abs(x - s)] / (1 + unlike * unlike)
                    above += weight * numerator[y, x]
                    below += weight * denominator[y, x]
        change[t, s] = above / below
