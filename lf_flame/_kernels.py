"""Every compiled loop: arrays in, output array filled, nothing returned.

All loops gather: each output element is summed by one thread in a fixed order, so the bits do not
depend on the number of threads. Sums run in float64. Light fields are ``[v, u, t, s]``.
"""

import numpy as np
from numba import njit, prange


def _trace_layer(texture, rows, columns, first, last, out):
    """Add the mean over a grid of backward rays to each pixel.

    texture: cells with a border of zeros, so that index 0 is "missed the layer".
    rows[v, t, a], columns[u, s, b]: cell index that ray (a, b) of a pixel hits.
    first[u], last[u]: the lenslet columns that can see the layer at all.
    """
    views, lenslet_rows, rays_y = rows.shape
    rays_x = columns.shape[2]
    share = 1.0 / (rays_y * rays_x)
    for k in prange(views * lenslet_rows):
        v, t = k // lenslet_rows, k % lenslet_rows
        if rows[v, t].max() == 0:
            continue
        for u in range(columns.shape[0]):
            for s in range(first[u], last[u]):
                light = 0.0
                for a in range(rays_y):
                    y = rows[v, t, a]
                    for b in range(rays_x):
                        light += texture[y, columns[u, s, b]]
                out[v, u, t, s] += np.float32(light * share)


def _integrate_layer(texture, row_start, row_weight, column_start, column_weight, first, last, out):
    """Add ``Ky @ texture @ Kx.T`` to the light field, K banded.

    row_start[v, t], row_weight[v, t, i]: first cell and weights of the band, likewise columns.
    """
    views, lenslet_rows, band_y = row_weight.shape
    band_x = column_weight.shape[2]
    width = texture.shape[1]
    for k in prange(views * lenslet_rows):
        v, t = k // lenslet_rows, k % lenslet_rows
        if not row_weight[v, t].any():
            continue
        line = np.zeros(width)
        for i in range(band_y):
            weight = row_weight[v, t, i]
            y = row_start[v, t] + i
            for x in range(width):
                line[x] += weight * texture[y, x]
        for u in range(column_weight.shape[0]):
            for s in range(first[u], last[u]):
                start = column_start[u, s]
                light, cells, weight = 0.0, line[start : start + band_x], column_weight[u, s]
                for j in range(band_x):
                    light += weight[j] * cells[j]
                out[v, u, t, s] += np.float32(light)


def _shift_columns(views, whole, fraction, out):
    """Sum the views of each row of views, shifted along s: out[v, t, s].

    whole[u], fraction[u]: the shift of view column u as whole lenslets and the rest in [0, 1).
    """
    rows, columns, height, width = views.shape
    for k in prange(rows * height):
        v, t = k // height, k % height
        total = np.zeros(width)
        for u in range(columns):
            line = views[v, u, t]
            i, f = whole[u], fraction[u]
            # Inside [low, high) both neighbours exist; outside, coordinates clamp to the edge.
            low = min(max(-i, 0), width)
            high = max(min(width - 1 - i, width), low)
            for s in range(low):
                total[s] += line[0]
            near, far = line[low + i : high + i], line[low + i + 1 : high + i + 1]
            inside = total[low:high]
            for s in range(high - low):  # from 0, so that no index can be negative: vectorises
                inside[s] += (1.0 - f) * near[s] + f * far[s]
            for s in range(high, width):
                total[s] += line[width - 1]
        out[v, t] = total


def _shift_rows(row_sums, whole, fraction, share, out):
    """Sum row sums [v, t, s] over v, shifted along t, times share: out[t, s]."""
    rows, height, width = row_sums.shape
    for t in prange(height):
        total = np.zeros(width)
        for v in range(rows):
            i, f = t + whole[v], fraction[v]
            upper = row_sums[v, min(max(i, 0), height - 1)]
            lower = row_sums[v, min(max(i + 1, 0), height - 1)]
            for s in range(width):
                total[s] += (1.0 - f) * upper[s] + f * lower[s]
        for s in range(width):
            out[t, s] = total[s] * share


trace_layer = njit(parallel=True, cache=True)(_trace_layer)
integrate_layer = njit(parallel=True, cache=True)(_integrate_layer)
shift_columns = njit(parallel=True, cache=True)(_shift_columns)
shift_rows = njit(parallel=True, cache=True)(_shift_rows)
