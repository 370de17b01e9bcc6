"""The compiled loops of the exact integrator: bands of weights, along x and then along y.

All loops gather: each output element is summed by one thread in a fixed order, so the bits do not
depend on the number of threads. Sums run in float64. Images are ``[v, u, t, s]``.
"""

import math

import numpy as np
from numba import njit

from lf_flame._common.threads import parallel
from lf_flame.simulation._falloff_kernels import shade

TINY = np.finfo(float).tiny
"""Divides where a width may be 0."""


@njit
def trapezoid_cdf(x, wide, narrow):
    """`lf_flame.optics.ray_bundle.trapezoid_cdf` of one number, for widths in order."""
    distance, half = abs(x), 0.5
    if wide > 0.0:
        rest = (wide + narrow) / 2 - distance
        if rest < narrow:
            ramp = max(rest, 0.0)
            half = 0.5 - ramp / wide * (ramp / max(narrow, TINY)) / 2
        else:
            half = min(distance / wide, 0.5)
    return 0.5 + half if x > 0.0 else 0.5 - half if x < 0.0 else 0.5


@parallel(lambda centres: len(centres))
def weigh_bands(v, edges, centres, lenslet, pixels, start, weights):
    """Shares of trapezoids in cells: weights[v, k, i] of cell start[v, k] + i for centres[v, k].

    edges[cell]: evenly spaced. lenslet, pixels[v, k]: widths of the boxes that make a trapezoid.
    """
    cells, cell_width = edges.size - 1, edges[1] - edges[0]
    band, border = weights.shape[2], edges[cells]
    for k in range(centres.shape[1]):
        centre, pixel = centres[v, k], pixels[v, k]
        wide, narrow, reach = max(lenslet, pixel), min(lenslet, pixel), (lenslet + pixel) / 2
        if centre + reach < edges[0] or centre - reach > border:  # as most do: in short
            start[v, k] = 0 if centre < border else cells - band
            weights[v, k] = 0.0
            continue
        first = math.floor((centre - reach - edges[0]) / cell_width)
        start[v, k] = min(max(first, 0), cells - band)
        near = trapezoid_cdf(edges[start[v, k]] - centre, wide, narrow)
        for i in range(band):
            far = trapezoid_cdf(edges[start[v, k] + i + 1] - centre, wide, narrow)
            weights[v, k, i] = far - near
            near = far


@parallel(lambda texture: len(texture))
def integrate_columns(row, texture, start, weight, first, last, out):
    """``texture @ Kx.T``, K banded: out[row, b, d].

    start[b, d], weight[b, d, j]: first cell and weights of the band.
    """
    cells = texture[row]
    for b in range(start.shape[0]):
        for d in range(first[b], last[b]):
            light, near, band = 0.0, start[b, d], weight[b, d]
            for j in range(band.size):
                light += band[j] * cells[near + j]
            out[row, b, d] = light


@parallel(lambda weight: weight.shape[1] * weight.shape[2])
def integrate_rows(k, columns, start, weight, falloff, seen, first, last, out):
    """Add ``Ky @ columns`` to each pixel, out[a, b, c, d], for a batch of planes.

    columns[row, b, d]: the planes' textures, integrated along x, one below the other.
    start[p, a, c], weight[p, a, c, i]: first row and weights of the band in plane p.
    seen[p, a, c], first[p, b], last[p, b]: the pixels along y and x that can see plane p.
    """
    planes, groups, lines, band = weight.shape
    a, c = k // lines, k % lines
    total = np.empty(columns.shape[2])
    for b in range(columns.shape[1]):
        low, high = total.size, 0
        for p in range(planes):
            if seen[p, a, c]:
                low, high = min(low, first[p, b]), max(high, last[p, b])
        total[low:high] = 0.0
        for p in range(planes):
            if not seen[p, a, c]:
                continue
            inside = total[first[p, b] : last[p, b]]
            for i in range(band):
                w = weight[p, a, c, i]
                if w != 0.0:
                    cells = columns[start[p, a, c] + i, b, first[p, b] : last[p, b]]
                    for d in range(inside.size):
                        inside[d] += w * cells[d]
        for d in range(low, high):
            out[a, b, c, d] += out.dtype.type(total[d] * shade(falloff, a, c, b, d))
