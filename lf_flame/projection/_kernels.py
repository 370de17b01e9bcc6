"""Compiled loops of projected images: arrays in, output array filled, nothing returned.

One thread computes each image in a fixed order: the bits do not depend on the number of threads.
All sums run in float64.
"""

import numpy as np
from numba import njit

from lf_flame._common.threads import parallel


@parallel(lambda low: low.size)
def find_seen(v, weight, low, high):
    """Find the first line of each view that is not 0, and one past the last; weight[v, t, i]."""
    low[v], high[v] = 0, weight.shape[1]
    while low[v] < high[v] and not np.any(weight[v, low[v]]):
        low[v] += 1
    while low[v] < high[v] and not np.any(weight[v, high[v] - 1]):
        high[v] -= 1


@njit
def sum_bands(bands, first, weights, block, sums, reach):
    """Sum lines of a banded matrix: sums[k, cell], 0 before cell reach[k, 0] and from reach[k, 1].

    bands: start[v, t] and weight[v, t, i] of the lines, and low[v], high[v]: lines outside are 0.
    first[v], weights[v, j]: lines that make up line k, and their weights; see `line_sums`.
    reach[k]: first cell that is not 0, and one past the last.
    """
    length = bands.start.shape[1]
    for k in range(sums.shape[0]):
        line = sums[k]
        line[:] = 0.0
        near, far = line.size, 0
        for v in range(weights.shape[0]):
            for j in range(weights.shape[1]):
                at, w = min(max(k * block + first[v] + j, 0), length - 1), weights[v, j]
                if w == 0.0 or at < bands.low[v] or at >= bands.high[v]:
                    continue
                start, band = bands.start[v, at], bands.weight[v, at]
                near, far = min(near, start), max(far, start + band.size)
                cells = line[start : start + band.size]
                for i in range(np.uint64(band.size)):
                    cells[i] += w * band[i]
        reach[k, 0], reach[k, 1] = near, far


@njit
def weigh_rows(rows, weights, low, high, total):
    """Add rows low to high, weighted: total[i] += sum over j of weights[j] * rows[j, i]."""
    j = low
    while j + 4 <= high:  # four rows at a time take fewer loads and stores per product
        a, b, c, d = weights[j], weights[j + 1], weights[j + 2], weights[j + 3]
        one, two, three, four = rows[j], rows[j + 1], rows[j + 2], rows[j + 3]
        for i in range(np.uint64(total.size)):
            total[i] += (a * one[i] + b * two[i]) + (c * three[i] + d * four[i])
        j += 4
    for k in range(j, high):
        w, row = weights[k], rows[k]
        for i in range(np.uint64(total.size)):
            total[i] += w * row[i]


@njit
def span(reach):
    """Find the first line, or cell, that is in reach, and one past the last."""
    near, far = np.int64(0), np.int64(0)
    for k in range(reach.shape[0]):
        if reach[k, 0] < reach[k, 1]:
            if far == 0:
                near = k
            far = k + 1
    return near, far


@njit
def add_product(cells, down, down_reach, across, across_reach, out):
    """Add ``down @ cells.T @ across.T`` to an image, out[t, s]; cells[j, i] is column by row."""
    left, right = span(across_reach)
    top, bottom = span(down_reach)
    if left == right or top == bottom:
        return
    lines = np.empty((cells.shape[1], right - left))
    total = np.empty(cells.shape[1])
    for s in range(left, right):
        total[:] = 0.0
        weigh_rows(cells, across[s], across_reach[s, 0], across_reach[s, 1], total)
        lines[:, s - left] = total
    for t in range(top, bottom):
        weigh_rows(lines, down[t], down_reach[t, 0], down_reach[t, 1], out[t, left:right])


@parallel(lambda out: len(out))
def add_images(n, cells, rows, columns, down, across, out):
    """Add a plane's light to images, out[n, t, s].

    cells[j, i]: radiance of the plane, column by row.
    rows, columns: bands of the bundles along y and x, see `Bands`.
    down, across: sums of lines along y and x, see `LineSums`.
    """
    count, height, width = out.shape
    tall, wide = np.empty((height, cells.shape[1])), np.empty((width, cells.shape[0]))
    tall_reach, wide_reach = np.empty((height, 2), np.int64), np.empty((width, 2), np.int64)
    for p in range(down.weights.shape[1]):
        sum_bands(rows, down.first[n], down.weights[n, p], down.block, tall, tall_reach)
        sum_bands(columns, across.first[n], across.weights[n, p], across.block, wide, wide_reach)
        add_product(cells, tall, tall_reach, wide, wide_reach, out[n])
