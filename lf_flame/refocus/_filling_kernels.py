"""Compiled loops of edge-preserving smoothing: arrays in, changed in place, nothing returned.

Each line is worked on by itself, in a fixed order: the bits do not depend on the number of threads.
"""

import numpy as np

from lf_flame._common.threads import pieces, shared

BLOCK = 64
"""Columns that are worked on together."""


def _smooth_rows(queue, planes, links):
    """Smooth planes[k, t, s] along s, forth and back: links[t, s] ties s - 1 to s, from 0 to 1."""
    width = planes.shape[2]
    for t in pieces(queue, planes.shape[1]):
        for k in range(planes.shape[0]):
            line, link = planes[k, t], links[t]
            for s in range(1, width):
                line[s] += link[s] * (line[s - 1] - line[s])
            for s in range(width - 2, -1, -1):
                line[s] += link[s + 1] * (line[s + 1] - line[s])


def _smooth_columns(queue, planes, links):
    """Smooth planes[k, t, s] along t, forth and back: links[t, s] ties t - 1 to t, from 0 to 1."""
    height, width = planes.shape[1:]
    for block in pieces(queue, (width + BLOCK - 1) // BLOCK):
        first, last = np.uint64(block * BLOCK), np.uint64(min((block + 1) * BLOCK, width))
        for k in range(planes.shape[0]):
            plane = planes[k]
            for t in range(1, height):
                for s in range(first, last):
                    plane[t, s] += links[t, s] * (plane[t - 1, s] - plane[t, s])
            for t in range(height - 2, -1, -1):
                for s in range(first, last):
                    plane[t, s] += links[t + 1, s] * (plane[t + 1, s] - plane[t, s])


smooth_rows = shared(_smooth_rows)
smooth_columns = shared(_smooth_columns)
