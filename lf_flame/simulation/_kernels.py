"""The compiled loops of both integrators: arrays in, output array filled, nothing returned.

All loops gather: each output element is summed by one thread in a fixed order, so the bits do not
depend on the number of threads. Sums run in float64.
Light fields are ``[v, u, t, s]``.
"""

import math

import numpy as np
from numba import njit, prange


def _radiance(planes, transmission, rays, weights, skew, a, c, i, b, d, j):
    """Radiance along one ray: what each plane adds, front to back, through those before it."""
    if transmission is None:
        at, down, right = hit(planes, rays, weights, skew, 0, a, c, i, b, d, j)
        return mean(planes.emission, planes.stride[0], at, down, right)
    light, clear = 0.0, 1.0
    for p in range(planes.first.size):
        at, down, right = hit(planes, rays, weights, skew, p, a, c, i, b, d, j)
        light += clear * mean(planes.emission, planes.stride[p], at, down, right)
        clear *= mean(transmission, planes.stride[p], at, down, right)
    return light


def _hit(planes, rays, weights, skew, p, a, c, i, b, d, j):
    """Cell that a ray meets on plane p, and the weights of the next cells down and right.

    Without weights these are None: the ray takes all from the one cell.
    """
    if skew is None:
        at = int(rays.rows[p, a, c, i] + rays.columns[p, b, d, j])
        if weights is None:
            return at, None, None
        return at, weights.down[p, a, c, i], weights.right[p, b, d, j]
    row = rays.rows[p, a, c, i] + skew.rows[p, b, d]
    column = rays.columns[p, b, d, j] + skew.columns[p, a, c]
    y, down = cell(row, rays.heights[p], planes.height[p])
    x, right = cell(column, rays.widths[p], planes.width[p])
    return planes.first[p] + y * planes.stride[p] + x, down, right


def _cell(position, breadth, cells):
    """Find the half-open cell in which a box begins, and the weight of the next cell in it.

    Cells count from the border at 0; a box has a breadth of at most 1 cell.
    """
    start = math.floor(position - breadth / 2)
    if start < -1 or start >= cells:
        return 0, 0.0
    weight = (position + breadth / 2 - (start + 1)) / max(breadth, 1e-12)
    return start + 1, min(max(weight, 0.0), 1.0)


def _mean(values, stride, at, down, right):
    """Mean over a ray's box, which lies on at most four cells; without weights, of one cell."""
    if down is None:
        return values[at]
    upper = values[at] + right * (values[at + 1] - values[at])
    lower = values[at + stride] + right * (values[at + stride + 1] - values[at + stride])
    return upper + down * (lower - upper)


def _passes(stops, skew, a, c, i, b, d, j):
    """Share of a ray's box that passes the round stops: their edges, taken as straight in it."""
    if stops is None:
        return 1.0
    share = 1.0
    for k in range(stops.radii.size):
        y, x = stops.rows[k, a, c, i], stops.columns[k, b, d, j]
        if skew is not None:
            y += skew.stop_rows[k, b, d]
            x += skew.stop_columns[k, a, c]
        radius, tall, wide = stops.radii[k], stops.heights[k], stops.widths[k]
        squared, edge = y * y + x * x, tall + wide  # no box is broader than its edge
        if edge > radius:  # a stop within a box or two: as a square of the same area
            half = 0.5 * math.sqrt(math.pi) * radius
            share *= overlap(y, tall, half) * overlap(x, wide, half)
        elif squared > (radius + edge) * (radius + edge):
            return 0.0
        elif squared > (radius - edge) * (radius - edge):
            distance = math.sqrt(squared)
            breadth = (abs(y) * tall + abs(x) * wide) / distance
            share *= min(max((radius - distance) / max(breadth, 1e-300) + 0.5, 0.0), 1.0)
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
    cos2 = 1.0 / (1.0 + falloff.rows[a, c] + falloff.columns[b, d])
    return cos2 * cos2


def _both(shaded, a, c, b, d):
    """Whether a pixel is marked along y and along x; without marks, none is."""
    if shaded is None:
        return False
    rows, columns = shaded
    return rows[a, c] and columns[b, d]


def _trace_planes(planes, rays, weights, skew, stops, falloff, seen, share, out):
    """Add the mean over a grid of backward rays to each pixel, out[a, b, c, d].

    The pixel's place along y is (a, c), along x (b, d): (v, u, t, s) for views, and for the raw
    image (0, 0, row, column). The tables are those of `lf_flame.simulation.ray_tables`. A table
    that belongs to an effect that is left out is None, for which Numba compiles a kernel without
    its code: the types of the arguments select the kernel, and no ray meets a branch on a flag.
    (Numba prunes a branch on ``None`` only if that is an argument of the function, so a member of
    a table that may be None is handed on as an argument.)

    share: of a pixel's light in one ray.
    """
    rays_y, rays_x = rays.rows.shape[3], rays.columns.shape[3]
    lines = seen.lines
    for k in prange(lines.size):
        a, c = k // lines.shape[1], k % lines.shape[1]
        if not lines[a, c]:
            continue
        for b in range(seen.first.size):
            for d in range(seen.first[b], seen.last[b]):
                light = 0.0
                for i in range(rays_y):
                    for j in range(rays_x):
                        weight = passes(stops, skew, a, c, i, b, d, j)
                        light += weight * radiance(
                            planes, planes.transmission, rays, weights, skew, a, c, i, b, d, j
                        )
                out[a, b, c, d] += light * share * shade(falloff, a, c, b, d)


def _add_polygons(planes, rows, columns, falloff, out):
    """Add the sum over pairs of polygons to each pixel, out[a, b, c, d].

    The planes are those of `lf_flame.simulation.ray_tables`; rows and columns those of
    `lf_flame.simulation.polygons`, for (a, c) and (b, d).
    """
    count = planes.first.size
    for k in prange(rows.first.size - 1):
        a, c = k // out.shape[2], k % out.shape[2]
        if rows.first[k] == rows.first[k + 1]:
            continue
        for b in range(out.shape[1]):
            for d in range(out.shape[3]):
                m = b * out.shape[3] + d
                light = 0.0
                for i in range(rows.first[k], rows.first[k + 1]):
                    line = 0.0
                    for j in range(columns.first[m], columns.first[m + 1]):
                        radiance, clear = 0.0, columns.areas[j]
                        for p in range(count):
                            at = rows.cells[i, p] + columns.cells[j, p]
                            radiance += clear * planes.emission[at]
                            clear *= planes.transmission[at]
                        line += radiance
                    light += rows.areas[i] * line
                out[a, b, c, d] += light * shade(falloff, a, c, b, d)


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


def _integrate_rows(columns, start, weight, falloff, seen, first, last, shaded, out):
    """Add ``Ky @ columns`` to each pixel, out[a, b, c, d], for a batch of planes.

    columns[row, b, d]: the planes' textures, integrated along x, one below the other.
    start[p, a, c], weight[p, a, c, i]: first row and weights of the band in plane p.
    seen[p, a, c], first[p, b], last[p, b]: the pixels along y and x that can see plane p.
    shaded: None, or [a, c] and [b, d]; pixels for which both are true are left as they are.
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
                if not both(shaded, a, c, b, d):
                    out[a, b, c, d] += out.dtype.type(total[d] * shade(falloff, a, c, b, d))


# Each is compiled where it is called, for the types that it meets there.
shade = njit(_shade)
both = njit(_both)
overlap = njit(_overlap)
passes = njit(_passes)
cell = njit(_cell)
hit = njit(_hit)
mean = njit(_mean)
radiance = njit(_radiance)

trace_planes = njit(parallel=True, cache=True)(_trace_planes)
add_polygons = njit(parallel=True, cache=True)(_add_polygons)
integrate_columns = njit(parallel=True, cache=True)(_integrate_columns)
integrate_rows = njit(parallel=True, cache=True)(_integrate_rows)
