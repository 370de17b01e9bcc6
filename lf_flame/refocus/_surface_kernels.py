"""Compiled loop of refocusing on a surface: arrays in, output array filled, nothing returned.

As in `lf_flame.simulation`, the loop gathers and all sums run in float64 in a fixed order: the bits
do not depend on the number of threads.
"""

import math

import numpy as np
from numba import njit

from lf_flame._common.threads import parallel


@njit
def refocus_row(views, line, t, weights, taps, out):
    """Refocus row t of an image with a slope for each of its pixels, line[s]: out[s, c].

    A pixel's shift along t depends only on the row of the view, its shift along s only on the
    column. Interpolation therefore needs rows + columns sets of taps, not rows * columns.
    """
    rows, columns, height, width, channels = views.shape
    right = np.empty((columns, taps, width), np.int64)
    right_weight = np.empty((columns, taps, width))
    down = np.empty((taps, width), np.int64)
    down_weight = np.empty((taps, width))
    total, part = np.zeros((channels, width)), np.empty((channels, width))
    for u in range(columns):
        middle = u - (columns - 1) / 2
        place_taps(line, middle, 0, 1, width, channels, right[u], right_weight[u])
    for v in range(rows):
        middle = v - (rows - 1) / 2
        place_taps(line, middle, t, 0, height, width * channels, down, down_weight)
        for a in range(taps):
            part[:] = 0.0
            for u in range(columns):
                if weights[v, u] != 0.0:
                    add_view(views[v, u].reshape(-1), down[a], right[u], right_weight[u],
                             weights[v, u], part)  # fmt: skip
            for c in range(channels):
                for s in range(width):
                    total[c, s] += down_weight[a, s] * part[c, s]
    for s in range(width):
        for c in range(channels):
            out[s, c] = total[c, s]


@njit
def place_taps(line, middle, start, step, length, stride, index, weight):
    """Find where a view is read for each pixel along one axis: index[tap, s], weight[tap, s].

    Pixel s is at start + s * step; taps outside the axis read its edge. One tap rounds the shift,
    two interpolate linearly, four use Keys' cubic convolution with a = -1/2 (IEEE Trans. Acoust.
    Speech Signal Process. 29, 1153, 1981).
    """
    taps = index.shape[0]
    for s in range(line.size):
        # Beyond these limits every tap reads the edge.
        shift = min(max(line[s] * middle, -length - 2.0), length + 2.0)
        whole = math.floor(shift + 0.5) if taps == 1 else math.floor(shift)
        f = shift - whole
        g = 1.0 - f
        if taps == 1:
            weight[0, s] = 1.0
        elif taps == 2:
            weight[0, s], weight[1, s] = g, f
        else:
            weight[0, s], weight[3, s] = -0.5 * f * g * g, -0.5 * g * f * f
            weight[1, s] = 1.0 + f * f * (1.5 * f - 2.5)
            weight[2, s] = 1.0 + g * g * (1.5 * g - 2.5)
        first = start + s * step + int(whole) - (taps - 1) // 2
        for a in range(taps):
            index[a, s] = min(max(first + a, 0), length - 1) * stride


@njit
def add_view(view, down, right, tap_weight, weight, part):
    """Add weight times a row of a flat view, starting at `down`, interpolated along s."""
    for b in range(right.shape[0]):
        for c in range(part.shape[0]):
            for s in range(down.size):
                # unsigned, so that no index can be negative
                at = np.uint64(down[s] + right[b, s] + c)
                part[c, s] += weight * tap_weight[b, s] * view[at]


@parallel(lambda slopes: slopes.shape[0] * slopes.shape[1])
def refocus_surface(k, views, slopes, weights, taps, out):
    """Weighted mean of views[v, u, t, s, c], shifted by slopes[n, t, s]: out[n, t, s, c].

    weights[v, u]: weights of the views, with sum 1; views of weight 0 are not read.
    """
    height = slopes.shape[1]
    n, t = k // height, k % height
    refocus_row(views, slopes[n, t], t, weights, taps, out[n, t])
