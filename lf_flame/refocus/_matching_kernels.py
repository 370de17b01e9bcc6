"""Compiled loops that compare shifted views: arrays in, output arrays filled, nothing returned.

They gather in a fixed order, one thread per row: the bits do not depend on the number of threads.
"""

import numpy as np
from numba import njit

from lf_flame._common.threads import parallel

TAPS = 4
"""Number of lenslets along an axis from which a shifted view is interpolated."""

OWN, BESIDE = np.float32(0.787), np.float32(0.1065)
"""Gaussian of a standard deviation of 0.5 lenslets that averages differences, in three taps."""


@njit
def shift_row(view, row, down_weight, start, across_weight, reach, line, out):
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

    some: `lf_flame.refocus.matching.WeightedViews`.
    down[v], across[u]: shift of tap 0; down_weights[v, a], across_weights[u, b]: weights of taps.
    reach: largest number of lenslets that any tap reads beyond a row.
    shifts_down[v], shifts_across[u]: whole shifts of the views.
    limit: largest absolute difference that counts.
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
