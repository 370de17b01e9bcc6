"""Cutting the unit square of a bundle into the polygons in which rays meet one cell of each plane.

Each bundle is cut by one thread in a fixed order, so the bits do not depend on their number.
"""

import math

import numpy as np
from numba import njit

from lf_flame._common.threads import parallel
from lf_flame.simulation._falloff_kernels import shade

SLIVER = 1e-14
"""Area of the unit square below which a polygon is rounding and is dropped."""

ROUNDING = 2.0**-48
"""Rounding of a place in cells, relative to a cell and to the image of the bundle."""

BELOW = -2
"""The strip before the first: one below the border."""


@njit
def cut(offsets, lenslet, pixel, counts, cells, areas):
    """Cut one bundle, front to back, and return the number of its polygons.

    Depth first: the strip of one cell is cut off what is left of a polygon, and is itself cut
    by the next plane, until all planes have cut it.

    offsets[p]: where the bundle's middle meets plane p, in cells from its first edge.
    lenslet[p], pixel[p]: images of both widths, in cells, signed.
    counts[p]: cells of the plane. Beside them there is nothing: the border at -1 and counts[p].
    cells[n, p], areas[n]: filled, as far as they reach, with cells counted from the border at 0.
    """
    planes = offsets.size
    most = 2 * planes + 6  # corners: a strip has at most two more than what it was cut from
    left, size = np.empty((planes + 1, most, 2)), np.zeros(planes + 1, np.int64)
    upper, heights = np.empty((most, 2)), np.empty(most)
    strip = np.full(planes + 1, BELOW)
    for k, corner in enumerate(((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5))):
        left[0, k] = corner
    size[0] = 4
    found, p = 0, 0
    while p >= 0:
        if size[p] == 0:
            p -= 1
        elif p == planes:
            found += keep(left[p], size[p], strip, counts, cells[found:], areas[found:])
            size[p] = 0
        else:
            # From a whole cell on, so that a place far down a plane costs no digit.
            base = math.floor(offsets[p])
            place = offsets[p] - base
            lowest, highest = measure(left[p], size[p], place, lenslet[p], pixel[p], heights)
            strip[p] = min(max(strip[p] + 1, math.floor(lowest) + base, -1), counts[p])
            edge, below, above = strip[p] + 1 - base, size[p], 0
            if strip[p] < counts[p] and highest > edge:
                round_off = ROUNDING * (1 + abs(lenslet[p]) + abs(pixel[p]))
                below, above = split(left[p], size[p], heights, edge, round_off, left[p + 1], upper)
                left[p, :above] = upper[:above]
            else:
                left[p + 1, :below] = left[p, :below]
            size[p] = above
            p += 1
            size[p] = below if area(left[p], below) > SLIVER else 0
            strip[p] = BELOW
    return found


@njit
def measure(polygon, size, place, lenslet, pixel, heights):
    """Fill in where the corners meet a plane, in cells, and return the lowest and the highest."""
    lowest, highest = math.inf, -math.inf
    for k in range(size):
        heights[k] = place + (lenslet * polygon[k, 0] + pixel * polygon[k, 1])
        lowest, highest = min(lowest, heights[k]), max(highest, heights[k])
    return lowest, highest


@njit
def split(polygon, size, heights, edge, round_off, lower, upper):
    """Split a convex polygon where its height is that of an edge, and return both sizes.

    A corner within `round_off` of the edge is on it: rounding must not bend a side about an edge,
    which would then be crossed more than twice.
    """
    below, above = 0, 0
    for k in range(size):
        nxt = (k + 1) % size
        here, there = heights[k] - edge, heights[nxt] - edge
        if here <= round_off:
            lower[below] = polygon[k]
            below += 1
        if here >= -round_off:
            upper[above] = polygon[k]
            above += 1
        if min(here, there) < -round_off and max(here, there) > round_off:
            # From the lower end, so that neighbours of a side find the same corner on it.
            low, high = (k, nxt) if here < there else (nxt, k)
            share = min(here, there) / (min(here, there) - max(here, there))
            for axis in range(2):
                corner = polygon[low, axis] + share * (polygon[high, axis] - polygon[low, axis])
                lower[below, axis] = corner
                upper[above, axis] = corner
            below += 1
            above += 1
    return below, above


@njit
def area(polygon, size):
    """Area of a convex polygon with its corners in order, as a fan about the first."""
    twice = 0.0
    for k in range(1, size - 1):
        a = polygon[k, 0] - polygon[0, 0]
        b = polygon[k, 1] - polygon[0, 1]
        c = polygon[k + 1, 0] - polygon[0, 0]
        d = polygon[k + 1, 1] - polygon[0, 1]
        twice += a * d - b * c
    return 0.5 * abs(twice)


@njit
def keep(polygon, size, strip, counts, cells, areas):
    """Note a polygon if there is room, and return whether it meets any plane."""
    planes, meets = counts.size, False
    for p in range(planes):
        meets = meets or 0 <= strip[p] < counts[p]
    if meets and areas.size:
        areas[0] = area(polygon, size)
        for p in range(planes):
            cells[0, p] = strip[p] + 1
    return 1 if meets else 0


@parallel(lambda found: found.size)
def count_polygons(n, offsets, lenslet, pixel, lit, counts, wanted, found):
    """Count the polygons of each bundle, found[n]; the other arguments as below."""
    no_cells, no_areas = np.empty((0, counts.size), np.int32), np.empty(0)
    found[n] = 0
    if wanted[n] and lit[n] > 0.0:
        found[n] = cut(offsets[n], lenslet, pixel * lit[n], counts, no_cells, no_areas)


@parallel(lambda offsets: len(offsets))
def cut_bundles(n, offsets, lenslet, pixel, lit, counts, first, cells, areas):
    """Cut all bundles into polygons.

    offsets[n, p], lenslet[p], pixel[p]: of bundle n on plane p, in cells of the plane.
    lit[n]: share of the pixel, about the bundle's middle, that light reaches.
    counts[p]: cells of the plane.
    first[n]: place of a bundle's first polygon in cells[:, p] and areas[:]; its last is before
    that of the next bundle.
    """
    mine = slice(first[n], first[n + 1])
    if first[n + 1] > first[n]:
        cut(offsets[n], lenslet, pixel * lit[n], counts, cells[mine], areas[mine])
        areas[mine] *= lit[n]


@parallel(lambda rows: rows.first.size - 1)
def add_polygons(k, planes, rows, columns, falloff, out):
    """Add the sum over pairs of polygons to each pixel, out[a, b, c, d].

    The planes are those of `lf_flame.simulation.ray_tables`; rows and columns those of
    `lf_flame.simulation.polygons`, for (a, c) and (b, d).
    """
    count = planes.first.size
    a, c = k // out.shape[2], k % out.shape[2]
    if rows.first[k] == rows.first[k + 1]:
        return
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
