"""Compiled loops that compare shifted views: arrays in, output arrays filled, nothing returned.

They gather in a fixed order, one thread per row: the bits do not depend on the number of threads.
"""

import math

import numpy as np

from lf_flame._common.compiling import compiled
from lf_flame._common.threads import pieces, shared

TAPS = 4
"""Number of lenslets along an axis from which a shifted view is interpolated."""

OWN, BESIDE = np.float32(0.787), np.float32(0.1065)
"""Gaussian of a standard deviation of 0.5 lenslets that averages differences, in three taps."""


def _shift_row(view, row, down_weight, start, across_weight, reach, line, out):
    """Shift a row of a view along both axes: out[s].

    row[a]: rows that are read, down_weight[a] their weights; start: lenslet that tap 0 reads for
    s = 0; line: room for a row with `reach` lenslets beyond both ends, where the edges repeat.
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


def _add_differences(row, reference, count, limit, total):
    """Add the absolute difference of two rows, at most `limit`, times a weight."""
    for s in range(np.uint64(total.size)):
        total[s] += count * min(abs(row[s] - reference[s]), limit)


def _bring_to_level(level, down, start, height, row):
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


def _compare_views(
    queue, some, rows, down, down_weights, across, across_weights, shifts_down, shifts_across,
    limit, middles, out,
):  # fmt: skip
    """Differences of shifted views from the central one: out[i, part, s] for row rows[i].

    The central view itself goes to middles[i, s].

    some: `lf_flame.refocus.matching.WeightedViews`.
    down[v], across[u]: shift of tap 0; down_weights[v, a], across_weights[u, b]: weights of taps.
    shifts_down[v], shifts_across[u]: whole shifts of the views.
    limit: largest absolute difference that counts.
    """
    views, height = some.views, some.height
    width = views.shape[3]
    reach = TAPS
    for start in across:
        reach = max(reach, abs(start) + TAPS)
    for i in pieces(queue, rows.size):
        line, shifted = np.empty(width + 2 * reach, np.float32), np.empty(width, np.float32)
        middle, row = middles[i], np.empty(TAPS, np.int64)
        middle[:] = 0.0
        count = np.float32(0.0)
        out[i] = 0.0
        for turn in range(2):
            for v in range(views.shape[0]):
                for a in range(TAPS):
                    row[a] = min(max(rows[i] + down[v] + a, 0), height - 1) - some.first
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
                            add_differences(shifted, middle, used, limit, out[i, part])
                        else:
                            for s in range(np.uint64(width)):
                                middle[s] += used * shifted[s]
                            count += used
            if turn == 0:
                for s in range(np.uint64(width)):
                    middle[s] /= count


def _place_taps(slopes, middle, first, step, length, index, weight, change):
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


def _read_view(view, y, y_weight, y_change, x, x_weight, x_change, value, along_t, along_s):
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


def _level_at(level, t, s, height, width):
    """Level of a view at a place of its own."""
    y = np.float32(2.0 * t / max(height - 1, 1) - 1.0)
    x = np.float32(2.0 * s / max(width - 1, 1) - 1.0)
    constant = level[0] + y * (level[1] + y * level[3])
    return constant + x * (level[2] + y * level[4] + x * level[5])


def _differentiate_views(queue, some, rows, slopes, unit, limit, differences, products, squares):
    """Differences of the views from the central one at each pixel's slope, and their derivatives.

    some: `lf_flame.refocus.matching.WeightedViews`. slopes[i, s]: slopes in row rows[i]; unit:
    factor of all views. Each output is [i, part, s], a sum over the views of a part: of absolute
    differences, at most `limit`; of the products of difference and derivative by the slope; and of
    the squares of the derivative. Views that differ by more than `limit` hardly count in these.
    """
    views, height = some.views, some.height
    width, above, beside = views.shape[3], (views.shape[0] - 1) / 2, (views.shape[1] - 1) / 2
    taps = TAPS, width
    for i in pieces(queue, rows.size):
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
                y -= some.first
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


def _add_fits(
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


def _choose_sides(queue, parts, shares, margins, out):
    """Least mismatch of all sides of the aperture: out[t, s], from parts[t, part, s].

    shares[side, part]: weights of a side's parts; margins[side] are added. Parts are averaged over
    3 x 3 lenslets first.
    """
    height, width = out.shape
    for t in pieces(queue, height):
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


def _mix_lines(before, own, after, out):
    """Weighted mean of three lines."""
    for s in range(np.uint64(out.size)):
        out[s] = OWN * own[s] + BESIDE * (before[s] + after[s])


shift_row = compiled(_shift_row)
bring_to_level = compiled(_bring_to_level)
mix_lines = compiled(_mix_lines)
add_differences = compiled(_add_differences)
place_taps = compiled(_place_taps)
read_view = compiled(_read_view)
level_at = compiled(_level_at)
add_fits = compiled(_add_fits)
compare_views = shared(_compare_views)
choose_sides = shared(_choose_sides)
differentiate_views = shared(_differentiate_views)
