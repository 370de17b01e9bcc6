"""Compiled loop of aligning views: arrays in, output array filled, nothing returned.

It gathers in a fixed order: the bits do not depend on the number of threads.
"""

import numpy as np
from numba import njit

from lf_flame._common.threads import pieces, shared


def _combine_rows(view, rows, weights, line):
    """Weighted sum of rows of a view[t, x]: line[x]."""
    line[:] = 0.0
    for j in range(rows.size):
        weight, row = weights[j], view[rows[j]]
        if weight != 0.0:
            for x in range(np.uint64(line.size)):
                line[x] += weight * row[x]


def _align_views(queue, images, at, rows, row_weights, columns, column_weights, channels, out):
    """Shift images[at[k], t, x], average them over blocks: out[n, k, i, j * channels + c].

    images: the channels of a lenslet are neighbours along x.
    rows[k, n, i, a], row_weights[k, n, a]: which rows make up row i of the output.
    columns[k, n, j, b], column_weights[k, n, b]: the same along x, for channel 0.
    """
    slopes, count, height = out.shape[:3]
    for m in pieces(queue, slopes * count * height):
        n, k, i = m // (count * height), m // height % count, m % height
        line = np.empty(images.shape[2], np.float32)
        combine_rows(images[at[k]], rows[k, n, i], row_weights[k, n], line)
        for j in range(columns.shape[2]):
            for c in range(channels):
                total = np.float32(0.0)
                for b in range(columns.shape[3]):
                    total += column_weights[k, n, b] * line[np.uint64(columns[k, n, j, b] + c)]
                out[n, k, i, j * channels + c] = total


combine_rows = njit(_combine_rows)
align_views = shared(_align_views)
