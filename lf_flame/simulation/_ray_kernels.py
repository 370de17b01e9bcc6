"""The compiled loops over backward rays: tables in, image filled, nothing returned.

All loops gather: each output element is summed by one thread in a fixed order, so the bits do not
depend on the number of threads. Sums run in float64.
Images are ``[view_row, view_column, row, column]``, of which the raw image has one view; the tables
are those of `lf_flame.simulation.ray_tables`.

The table of an effect that is left out is None, for which Numba compiles a kernel without its code:
the types of the arguments select the kernel, and no ray meets a branch on a flag. Numba prunes a
branch on ``None`` only for an argument of the function, so a member that may be None is passed on
as an argument of its own.
"""

import math

import numpy as np
from numba import njit

from lf_flame._common.threads import parallel
from lf_flame.simulation._weight_kernels import (
    Lenslet,
    Pixel,
    Place,
    Ray,
    inside,
    on_array,
    passes,
    shade_ray,
    whole,
)


@njit
def radiance(planes, transmission, meet, rays, tables, lenslet, pixel, ray):
    """Radiance along one ray: the light of each plane, attenuated by the planes in front of it.

    meet: `hit`, whose tables are the weights, or `hit_shifted`, whose tables are the shifts.
    """
    # A single plane, which nothing attenuates.
    if transmission is None:
        gain, at, down, right = meet(planes, rays, tables, lenslet, 0, pixel, ray)
        return gain * box_mean(planes.emission, planes.stride[0], at, down, right)
    # Front to back: `clear` is the transmission of all planes passed so far, `before` that in
    # front of the plane, or of the sheet of which it is a strip.
    light, clear, before, sheet = 0.0, 1.0, 1.0, 0
    for p in range(planes.first.size):
        gain, at, down, right = meet(planes, rays, tables, lenslet, p, pixel, ray)
        if planes.sheet[p] == 0 or planes.sheet[p] != sheet:
            before, sheet = clear, planes.sheet[p]
        gain *= before
        light += gain * box_mean(planes.emission, planes.stride[p], at, down, right)
        # A ray may meet two strips of a sheet, or none. The mean over a pixel's rays is right, so
        # single rays are not clipped.
        stopped = 1.0 - box_mean(transmission, planes.stride[p], at, down, right)
        clear -= gain * stopped
    return light


@njit
def hit(planes, rays, weights, lenslet, p, pixel, ray):
    """Meet plane p: factor of its light, the cell, and the weights of the next cells."""
    row = rays.rows[p, pixel.view_row, pixel.row, ray.row]
    at = int(row + rays.columns[p, pixel.view_column, pixel.column, ray.column])
    down = weights.down[p, pixel.view_row, pixel.row, ray.row]
    right = weights.right[p, pixel.view_column, pixel.column, ray.column]
    return strip_gain(planes, p, pixel), at, down, right


@njit
def strip_gain(planes, p, pixel):
    """Factor of the light of a strip of a sheet that leans; 1 for other planes."""
    down = planes.down[p, pixel.view_row, pixel.row]
    return abs(down * planes.right[p, pixel.view_column, pixel.column])  # from either side


@njit
def hit_shifted(planes, rays, shifts, lenslet, p, pixel, ray):
    """Meet plane p as `hit` does, through any lenslet."""
    # The ray through the pixel's own lenslet, where the sensor is read; its shift by the lenslet's
    # displacement, and by the rotation of the lenslet's own square.
    row = rays.rows[p, pixel.view_row, pixel.row, ray.row]
    row += lenslet.aside_y * shifts.plane_rows[p] + shifts.turned_rows[p, ray.column]
    column = rays.columns[p, pixel.view_column, pixel.column, ray.column]
    column += lenslet.aside_x * shifts.plane_columns[p] + shifts.turned_columns[p, ray.row]
    y, down = cell(row, rays.heights[p], planes.height[p])
    x, right = cell(column, rays.widths[p], planes.width[p])
    gain = planes.down[p, pixel.view_row, pixel.row] + lenslet.aside_y * shifts.lean_rows[p]
    leaning = lenslet.aside_x * shifts.lean_columns[p]
    gain *= planes.right[p, pixel.view_column, pixel.column] + leaning
    return abs(gain), planes.first[p] + y * planes.stride[p] + x, down, right


@njit
def cell(position, breadth, cells):
    """Find the half-open cell in which a box begins, and the next cell's share of the box.

    Cells count from the border at 0; a box is at most 1 cell wide.
    """
    start = math.floor(position - breadth / 2)
    if start < -1 or start >= cells:
        return 0, 0.0
    weight = (position + breadth / 2 - (start + 1)) / max(breadth, 1e-12)
    return start + 1, min(max(weight, 0.0), 1.0)


@njit
def box_mean(values, stride, at, down, right):
    """Mean over a ray's box, which covers at most four cells."""
    upper = values[at] + right * (values[at + 1] - values[at])
    lower = values[at + stride] + right * (values[at + stride + 1] - values[at + stride])
    return upper + down * (lower - upper)


@njit
def bundle(
    planes, rays, shifts, stop, second, micro_images, squares, falloff, tilt, lenslet, place, pixel
):
    """Sum over the rays of a pixel through one lenslet."""
    light = 0.0
    for row in range(rays.rows.shape[3]):
        for column in range(rays.columns.shape[3]):
            ray = Ray(row, column)
            # Share of the ray's box inside the stops and inside the micro-image.
            weight = passes(stop, second, shifts, lenslet, pixel, ray)
            weight *= inside(squares, micro_images, place, ray)
            # Falloff and radiance are computed only for rays that pass.
            if weight != 0.0:
                weight *= shade_ray(falloff, tilt, lenslet, pixel, ray)
                light += weight * radiance(
                    planes, planes.transmission, hit_shifted, rays, shifts, lenslet, pixel, ray
                )
    return light


@njit
def through_lenslets(
    planes, rays, shifts, stop, second, micro_images, squares, falloff, tilt, pixel
):
    """Light of a pixel through every lenslet that can light it."""
    light = 0.0
    own = on_array(micro_images, pixel)
    reach, cosine, sine = micro_images.reach, micro_images.cosine, micro_images.sine
    turned_y = shifts.rows[pixel.view_column, pixel.column]
    turned_x = shifts.columns[pixel.view_row, pixel.row]
    # Rows and columns of the array, counted from the pixel's own lenslet.
    for k in range(math.ceil(own.down - reach), math.floor(own.down + reach) + 1):
        for h in range(math.ceil(own.right - reach), math.floor(own.right + reach) + 1):
            down, right = k * cosine + h * sine, h * cosine - k * sine
            aside_y, aside_x = turned_y + down * shifts.pitch, turned_x + right * shifts.pitch
            lenslet = Lenslet(down, right, aside_y, aside_x)
            place = Place(own.down - k, own.right - h)
            # No ray of a pixel that lies inside the micro-image needs a test for its border.
            if whole(squares, place):
                light += bundle(
                    planes, rays, shifts, stop, second, micro_images, None, falloff, tilt,
                    lenslet, place, pixel
                )  # fmt: skip
            else:
                light += bundle(
                    planes, rays, shifts, stop, second, micro_images, squares, falloff, tilt,
                    lenslet, place, pixel
                )  # fmt: skip
    return light


@parallel(lambda seen: seen.lines.size)
def trace_planes(k, planes, rays, weights, stop, second, falloff, seen, share, out):
    """Add the mean over a grid of backward rays to each pixel of an image.

    share: share of a pixel's light in one ray.
    """
    own, lines = Lenslet(0.0, 0.0, 0.0, 0.0), seen.lines
    # A piece is a line of pixels; lines that see nothing stay as they are.
    view_row, row = k // lines.shape[1], k % lines.shape[1]
    if not lines[view_row, row]:
        return
    for view_column in range(seen.first.size):
        for column in range(seen.first[view_column], seen.last[view_column]):
            pixel, light = Pixel(view_row, view_column, row, column), 0.0
            for i in range(rays.rows.shape[3]):
                for j in range(rays.columns.shape[3]):
                    ray = Ray(i, j)
                    # Share of the ray's box inside the stops, and cos^4.
                    weight = passes(stop, second, None, own, pixel, ray)
                    weight *= shade_ray(falloff, None, own, pixel, ray)
                    light += weight * radiance(
                        planes, planes.transmission, hit, rays, weights, own, pixel, ray
                    )
            out[view_row, view_column, row, column] += max(light, 0.0) * share


@parallel(lambda seen: seen.lines.size)
def trace_apart(k, planes, rays, weights, seen, share, out):
    """Trace one plane, without stops or falloff, in fewer operations than `trace_planes`.

    A ray's row on the plane depends on its number along y alone, its column on that along x. The
    sum over the rays along y is therefore taken once for all pixels of a line: the result has all
    rays of each pixel, at the cost of the rays along x.
    """
    lines = seen.lines
    view_row, row = k // lines.shape[1], k % lines.shape[1]
    if not lines[view_row, row]:
        return
    # Sum over the rays along y, for each column of cells.
    sums = np.zeros(planes.stride[0])
    for i in range(rays.rows.shape[3]):
        down = weights.down[0, view_row, row, i]
        add_rows(sums, planes.emission, rays.rows[0, view_row, row, i], down)
    # Sum over the rays along x, for each pixel.
    for view_column in range(seen.first.size):
        for column in range(seen.first[view_column], seen.last[view_column]):
            light = 0.0
            for j in range(rays.columns.shape[3]):
                x = rays.columns[0, view_column, column, j]
                right = weights.right[0, view_column, column, j]
                light += sums[x] + right * (sums[x + 1] - sums[x])
            light *= strip_gain(planes, 0, Pixel(view_row, view_column, row, column))
            out[view_row, view_column, row, column] += light * share


@njit
def add_rows(sums, values, first, down):
    """Add a row of cells and the next one to the sums, the next with weight `down`."""
    size = sums.size
    upper, lower = values[first : first + size], values[first + size : first + 2 * size]
    for x in range(size):
        sums[x] += upper[x] + down * (lower[x] - upper[x])


@parallel(lambda seen: seen.lines.size)
def trace_lenslets(k, tables, seen, share, out):
    """Trace rays through every lenslet that can light a pixel; tables: `LensletTables`."""
    # Taken from the tuple once: each time, Numba counts the references to all arrays.
    planes, rays, shifts, stop, second, micro_images, squares, falloff, tilt = tables
    lines = seen.lines
    view_row, row = k // lines.shape[1], k % lines.shape[1]
    if not lines[view_row, row]:
        return
    for view_column in range(seen.first.size):
        for column in range(seen.first[view_column], seen.last[view_column]):
            pixel = Pixel(view_row, view_column, row, column)
            light = through_lenslets(
                planes, rays, shifts, stop, second, micro_images, squares, falloff, tilt, pixel
            )
            out[view_row, view_column, row, column] += max(light, 0.0) * share


# Each function is compiled for the types of each call. Functions that are called for each ray have
# no loop and no early return where possible: Numba then need not count references to the tables'
# arrays, which would cost several times the work itself.
