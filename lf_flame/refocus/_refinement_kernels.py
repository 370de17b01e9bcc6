"""Compiled loops that refine slopes: arrays in, output arrays filled, nothing returned.

They gather in a fixed order, one thread per row: the bits do not depend on the number of threads.
"""

import math

import numpy as np
from numba import njit

from lf_flame._common.threads import parallel

TAPS = 4
"""Number of lenslets along an axis from which a view is interpolated."""


@njit
def place_taps(slopes, middle, first, step, length, index, weight, change):
    """Place the taps of the cubic B-spline along one axis: each output is [tap, s].

    Pixel s is at first + s * step, and is read slopes[s] * middle further on; taps outside the
    axis read its edge. change: derivatives of the weights by the place.
    """
    for s in range(slopes.size):
        place = slopes[s] * middle
        whole = math.floor(place)
        f = np.float32(place - whole)
        g = np.float32(1.0) - f
        weight[0, s], weight[3, s] = g * g * g / 6, f * f * f / 6
        weight[1, s] = (4 - 6 * f * f + 3 * f * f * f) / 6
        weight[2, s] = (4 - 6 * g * g + 3 * g * g * g) / 6
        change[0, s], change[3, s] = -g * g / 2, f * f / 2
        change[1, s], change[2, s] = f * (f * 3 / 2 - 2), g * (2 - g * 3 / 2)
        start = first + s * step + int(whole) - 1
        for a in range(TAPS):
            index[a, s] = min(max(start + a, 0), length - 1)


@njit
def read_view(view, y, y_weight, y_change, x, x_weight, x_change, value, along_t, along_s):
    """Read a view between its lenslets: value[s], and its derivatives along both axes.

    y, x: rows and columns that are read, their weights and changes, [tap, s].
    """
    for s in range(np.uint64(value.size)):
        total, down, across = np.float32(0.0), np.float32(0.0), np.float32(0.0)
        for a in range(np.uint64(TAPS)):
            line = view[np.uint64(y[a, s])]
            here, change = np.float32(0.0), np.float32(0.0)
            for b in range(np.uint64(TAPS)):
                lenslet = line[np.uint64(x[b, s])]
                here += x_weight[b, s] * lenslet
                change += x_change[b, s] * lenslet
            total += y_weight[a, s] * here
            down += y_change[a, s] * here
            across += y_weight[a, s] * change
        value[s], along_t[s], along_s[s] = total, down, across


@njit
def level_at(level, t, s, height, width):
    """Level of a view at a place of its own."""
    y = np.float32(2.0 * t / max(height - 1, 1) - 1.0)
    x = np.float32(2.0 * s / max(width - 1, 1) - 1.0)
    constant = level[0] + y * (level[1] + y * level[3])
    return constant + x * (level[2] + y * level[4] + x * level[5])


@parallel(lambda rows: rows.size)
def differentiate_views(i, some, rows, slopes, unit, limit, differences, products, squares):
    """Differences of the views from the central one at each pixel's slope, and their derivatives.

    some: `lf_flame.refocus.matching.WeightedViews`. slopes[i, s]: slopes in row rows[i]; unit:
    factor of all views. Each output is [i, part, s], a sum over the views of a part: of absolute
    differences, at most `limit`; of the products of difference and derivative by the slope; and of
    the squares of the derivative. Views that differ by more than `limit` hardly count in these.
    """
    views, height = some.views, some.views.shape[2]
    width, above, beside = views.shape[3], (views.shape[0] - 1) / 2, (views.shape[1] - 1) / 2
    taps = TAPS, width
    y, (y_weight, y_change) = np.empty(taps, np.int64), np.empty((2, *taps), np.float32)
    x = np.empty((views.shape[1], *taps), np.int64)
    x_weight, x_change = np.empty((2, views.shape[1], *taps), np.float32)
    value, along_t, along_s = np.empty((3, width), np.float32)
    middle, count = np.zeros(width, np.float32), np.float32(0.0)
    differences[i], products[i], squares[i] = 0.0, 0.0, 0.0
    for u in range(views.shape[1]):
        place_taps(slopes[i], u - beside, 0, 1, width, x[u], x_weight[u], x_change[u])
    for turn in range(2):
        for v in range(views.shape[0]):
            place_taps(slopes[i], v - above, rows[i], 0, height, y, y_weight, y_change)
            for u in range(views.shape[1]):
                used = some.weights[v, u] if turn == 1 else some.middle_weights[v, u]
                if used == 0.0:
                    continue
                read_view(views[v, u], y, y_weight, y_change, x[u], x_weight[u], x_change[u],
                          value, along_t, along_s)  # fmt: skip
                if not some.even:
                    for s in range(width):
                        t = rows[i] + slopes[i, s] * (v - above)
                        across = s + slopes[i, s] * (u - beside)
                        level = level_at(some.levels[v, u], t, across, height, width)
                        value[s] *= level
                        along_t[s] *= level
                        along_s[s] *= level
                if turn == 0:
                    for s in range(width):
                        middle[s] += used * unit * value[s]
                    count += used
                    continue
                part = 3 * some.parts_down[v] + some.parts_across[u]
                add_fits(value, along_t, along_s, unit, np.float32(v - above),
                         np.float32(u - beside), middle, used, limit, differences[i, part],
                         products[i, part], squares[i, part])  # fmt: skip
        if turn == 0:
            middle /= count


@njit
def add_fits(
    value, along_t, along_s, unit, down, across, middle, used, limit, differences, products, squares
):
    """Add a view's differences and what a change of the slope would change in them, [s]."""
    for s in range(np.uint64(value.size)):
        off = unit * value[s] - middle[s]
        change = unit * (down * along_t[s] + across * along_s[s])
        fit = 1 / (1 + off * off / (limit * limit))
        differences[s] += used * min(abs(off), limit)
        products[s] += used * fit * fit * off * change
        squares[s] += used * fit * fit * change * change


@parallel(lambda slope: len(slope))
def fit(t, slope, numerator, denominator, guide, near, alike, same, least, change):
    """Ratio of the sums of numerators and denominators over pixels of about the same slope.

    near[distance]: weights along either axis; alike: difference of brightness at which a pixel
    counts half; same: largest difference of slopes; least is added to the denominator, so that a
    change to which nothing points is 0.
    """
    height, width = slope.shape
    reach = near.size - 1
    for s in range(width):
        above, below = 0.0, least
        for y in range(max(t - reach, 0), min(t + reach + 1, height)):
            for x in range(max(s - reach, 0), min(s + reach + 1, width)):
                if abs(slope[y, x] - slope[t, s]) <= same:
                    unlike = (guide[y, x] - guide[t, s]) / alike
                    weight = near[abs(y - t)] * near[abs(x - s)] / (1 + unlike * unlike)
                    above += weight * numerator[y, x]
                    below += weight * denominator[y, x]
        change[t, s] = above / below
