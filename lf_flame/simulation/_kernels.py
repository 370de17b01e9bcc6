"""Every compiled loop: arrays in, output array filled, nothing returned.

All loops gather: each output element is summed by one thread in a fixed order, so the bits do not
depend on the number of threads. Sums run in float64, but for `sum_rows`, whose purpose is to read.
Light fields are ``[v, u, t, s]``.
"""

import math

import numpy as np
from numba import njit, prange

LANES = 64
"""Sums side by side: enough that memory, not the latency of an addition, sets the speed."""


def _sum_rows(rows, sums):
    """Sum each of the rows [row, element] in float32: what reading them once costs."""
    for k in prange(rows.shape[0]):
        lanes = np.zeros(LANES, np.float32)
        row = rows[k]
        whole = row.size // LANES * LANES
        for i in range(0, whole, LANES):
            for j in range(LANES):
                lanes[j] += row[i + j]
        sums[k] = lanes.sum() + row[whole:].sum()


def _radiance(
    emission, transmission, rows, columns, shares, planes, skew, a, c, i, b, d, j
):  # fmt: skip
    """Radiance along one ray: what each plane adds, front to back, through those before it."""
    if transmission is None:
        at, down, right = hit(rows, columns, shares, planes, skew, 0, a, c, i, b, d, j)
        return mean(emission, shares, planes, 0, at, down, right)
    light, clear = 0.0, 1.0
    for p in range(planes[0].size):
        at, down, right = hit(rows, columns, shares, planes, skew, p, a, c, i, b, d, j)
        light += clear * mean(emission, shares, planes, p, at, down, right)
        clear *= mean(transmission, shares, planes, p, at, down, right)
    return light


def _hit(rows, columns, shares, planes, skew, p, a, c, i, b, d, j):
    """Cell that a ray meets on plane p, and its shares in the next cells down and right."""
    if skew is None:
        at = int(rows[p, a, c, i] + columns[p, b, d, j])
        if shares is None:
            return at, 0.0, 0.0
        return at, shares[0][p, a, c, i], shares[1][p, b, d, j]
    first, stride, height, width, tall, wide = planes
    row_shift, column_shift = skew[0], skew[1]
    y, down = cell(rows[p, a, c, i] + row_shift[p, b, d], tall[p], height[p])
    x, right = cell(columns[p, b, d, j] + column_shift[p, a, c], wide[p], width[p])
    return first[p] + y * stride[p] + x, down, right


def _cell(position, breadth, cells):
    """Find the half-open cell in which a box begins, and the box's share in the next cell.

    Cells count from the border at 0; a box has a breadth of at most 1 cell.
    """
    start = math.floor(position - breadth / 2)
    if start < -1 or start >= cells:
        return 0, 0.0
    share = (position + breadth / 2 - (start + 1)) / max(breadth, 1e-12)
    return start + 1, min(max(share, 0.0), 1.0)


def _mean(values, shares, planes, p, at, down, right):
    """Mean over a ray's box, which at most four cells share; without shares, the cell's value."""
    if shares is None:
        return values[at]
    stride = planes[1][p]
    upper = values[at] + right * (values[at + 1] - values[at])
    lower = values[at + stride] + right * (values[at + stride + 1] - values[at + stride])
    return upper + down * (lower - upper)


def _passes(stops, skew, a, c, i, b, d, j):
    """Share of a ray's box that passes the round stops: their edges, taken as straight in it."""
    if stops is None:
        return 1.0
    stop_rows, stop_columns, radius, tall, wide = stops
    share = 1.0
    for k in range(radius.size):
        y, x = stop_rows[k, a, c, i], stop_columns[k, b, d, j]
        if skew is not None:
            y += skew[2][k, b, d]
            x += skew[3][k, a, c]
        squared, edge = y * y + x * x, tall[k] + wide[k]  # no box is broader than its edge
        if edge > radius[k]:  # a stop within a box or two: as a square of the same area
            half = 0.5 * math.sqrt(math.pi) * radius[k]
            share *= overlap(y, tall[k], half) * overlap(x, wide[k], half)
        elif squared > (radius[k] + edge) * (radius[k] + edge):
            return 0.0
        elif squared > (radius[k] - edge) * (radius[k] - edge):
            distance = math.sqrt(squared)
            breadth = (abs(y) * tall[k] + abs(x) * wide[k]) / distance
            share *= min(max((radius[k] - distance) / max(breadth, 1e-300) + 0.5, 0.0), 1.0)
    return share


def _overlap(position, breadth, half):
    """Share of a box that lies between -half and half."""
    if breadth <= 0.0:
        return 1.0 if abs(position) <= half else 0.0
    low, high = max(position - breadth / 2, -half), min(position + breadth / 2, half)
    return max(high - low, 0.0) / breadth


def _shade(falloff, a, c, b, d):
    """cos^4 of the angle at which a pixel's central ray leaves the main lens."""
    if falloff is None:
        return 1.0
    squared_rows, squared_columns = falloff
    cos2 = 1.0 / (1.0 + squared_rows[a, c] + squared_columns[b, d])
    return cos2 * cos2


def _trace_planes(
    emission,
    transmission,
    rows,
    columns,
    shares,
    planes,
    skew,
    stops,
    falloff,
    seen,
    first,
    last,
    share,
    out,
):
    """Add the mean over a grid of backward rays to each pixel, out[a, b, c, d].

    The pixel's place along y is (a, c), along x (b, d): (v, u, t, s) for views, and for the raw
    image (0, 0, row, column). An effect that is left out is None, for which Numba compiles a
    kernel without its code: the types of the arguments select the kernel, and no ray meets a
    branch on a flag.

    emission, transmission: cells of all planes, front to back, each plane with a border of
    nothing around it; transmission None: the light of one plane only adds.
    rows, columns: index[p, a, c, i] and [p, b, d, j] of the cell that ray (i, j) meets on plane
    p, to be added up; with a skew (a rotated array) positions in cells.
    shares: those of a ray's box in the next cell, of the same two shapes, or None for rays without
    breadth; with a skew they follow from the positions.
    planes: first cell, row stride, height, width and the box of a ray, tall and wide, of each.
    skew: row_shift[p, b, d], column_shift[p, a, c] in cells, and those of the stops in mm.
    stops: rows and columns like those of planes in mm, radii, and the boxes of rays.
    falloff: squared tangents[a, c] and [b, d].
    seen[a, c], first[b], last[b]: the pixels that can see anything at all.
    """
    rays_y, rays_x = rows.shape[3], columns.shape[3]
    for k in prange(seen.size):
        a, c = k // seen.shape[1], k % seen.shape[1]
        if not seen[a, c]:
            continue
        for b in range(first.size):
            for d in range(first[b], last[b]):
                light = 0.0
                for i in range(rays_y):
                    for j in range(rays_x):
                        weight = passes(stops, skew, a, c, i, b, d, j)
                        light += weight * radiance(
                            emission, transmission, rows, columns, shares, planes, skew,
                            a, c, i, b, d, j,
                        )  # fmt: skip
                out[a, b, c, d] += light * share * shade(falloff, a, c, b, d)


def _integrate_columns(texture, start, weight, first, last, out):
    """``texture @ Kx.T``, K banded: out[row, b, d].

    start[b, d], weight[b, d, j]: first cell and weights of the band.
    """
    for row in prange(texture.shape[0]):
        cells = texture[row]
        for b in range(start.shape[0]):
            for d in range(first[b], last[b]):
                light, near, band = 0.0, start[b, d], weight[b, d]
                for j in range(band.size):
                    light += band[j] * cells[near + j]
                out[row, b, d] = light


def _integrate_rows(columns, start, weight, falloff, seen, first, last, out):
    """Add ``Ky @ columns`` to each pixel, out[a, b, c, d], for a batch of planes.

    columns[row, b, d]: the planes' textures, integrated along x, one below the other.
    start[p, a, c], weight[p, a, c, i]: first row and weights of the band in plane p.
    seen[p, a, c], first[p, b], last[p, b]: the pixels along y and x that can see plane p.
    """
    planes, groups, lines, band = weight.shape
    for k in prange(groups * lines):
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


# Each is compiled where it is called, for the types that it meets there.
shade = njit(_shade)
overlap = njit(_overlap)
passes = njit(_passes)
cell = njit(_cell)
hit = njit(_hit)
mean = njit(_mean)
radiance = njit(_radiance)

sum_rows = njit(parallel=True, cache=True)(_sum_rows)
trace_planes = njit(parallel=True, cache=True)(_trace_planes)
integrate_columns = njit(parallel=True, cache=True)(_integrate_columns)
integrate_rows = njit(parallel=True, cache=True)(_integrate_rows)
