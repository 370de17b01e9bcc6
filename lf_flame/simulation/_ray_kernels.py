"""The compiled loops over backward rays: tables in, image filled, nothing returned.

All loops gather: each output element is summed by one thread in a fixed order, so the bits do not
depend on the number of threads. Sums run in float64.
Images are ``[v, u, t, s]``; the tables are those of `lf_flame.simulation.ray_tables`.
"""

import math

import numpy as np
from numba import njit

from lf_flame._common.threads import pieces, shared
from lf_flame.simulation._falloff_kernels import shade_ray
from lf_flame.simulation._stop_kernels import inside, on_array, passes, whole


def _radiance(planes, transmission, rays, weights, a, c, i, b, d, j):
    """Radiance along one ray: what each plane adds, front to back, through those before it."""
    if transmission is None:
        at, down, right = hit(rays, weights, 0, a, c, i, b, d, j)
        return mean(planes.emission, planes.stride[0], at, down, right)
    light, clear = 0.0, 1.0
    for p in range(planes.first.size):
        at, down, right = hit(rays, weights, p, a, c, i, b, d, j)
        light += clear * mean(planes.emission, planes.stride[p], at, down, right)
        clear *= mean(transmission, planes.stride[p], at, down, right)
    return light


def _hit(rays, weights, p, a, c, i, b, d, j):
    """Cell that a ray meets on plane p, and the weights of the next cells down and right.

    Without weights these are None: the ray takes all from the one cell.
    """
    at = int(rays.rows[p, a, c, i] + rays.columns[p, b, d, j])
    if weights is None:
        return at, None, None
    return at, weights.down[p, a, c, i], weights.right[p, b, d, j]


def _radiance_shifted(planes, transmission, rays, shifts, m, n, a, c, i, b, d, j):
    """Radiance along one ray through a lenslet m and n pitches further on along y and x."""
    if transmission is None:
        at, down, right = hit_shifted(planes, rays, shifts, m, n, 0, a, c, i, b, d, j)
        return box_mean(planes.emission, planes.stride[0], at, down, right)
    light, clear = 0.0, 1.0
    for p in range(planes.first.size):
        at, down, right = hit_shifted(planes, rays, shifts, m, n, p, a, c, i, b, d, j)
        light += clear * box_mean(planes.emission, planes.stride[p], at, down, right)
        clear *= box_mean(transmission, planes.stride[p], at, down, right)
    return light


def _hit_shifted(planes, rays, shifts, m, n, p, a, c, i, b, d, j):
    """Cell that such a ray meets on plane p, and the weights of the next cells."""
    row = rays.rows[p, a, c, i] + shifts.rows[p, b, d] + shifts.turned_rows[p, j]
    column = rays.columns[p, b, d, j] + shifts.columns[p, a, c] + shifts.turned_columns[p, i]
    row, column = row + m * shifts.pitch_rows[p], column + n * shifts.pitch_columns[p]
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
    """Mean over a ray's box; without weights, of one cell."""
    if down is None:
        return values[at]
    return box_mean(values, stride, at, down, right)


def _box_mean(values, stride, at, down, right):
    """Mean over a ray's box, which lies on at most four cells."""
    upper = values[at] + right * (values[at + 1] - values[at])
    lower = values[at + stride] + right * (values[at + stride + 1] - values[at + stride])
    return upper + down * (lower - upper)


def _bundle(
    planes, transmission, rays, shifts, stop, second, squares, micro_images, falloff, tilt,
    m, n, down, right, a, c, b, d
):  # fmt: skip
    """Sum over the rays of a pixel through one lenslet."""
    light = 0.0
    for i in range(rays.rows.shape[3]):
        for j in range(rays.columns.shape[3]):
            weight = passes(stop, second, shifts, m, n, a, c, i, b, d, j)
            weight *= inside(squares, micro_images, down, right, i, j)
            if weight != 0.0:
                weight *= shade_ray(falloff, tilt, m, n, a, c, i, b, d, j)
                light += weight * radiance_shifted(
                    planes, transmission, rays, shifts, m, n, a, c, i, b, d, j
                )
    return light


def _through_lenslets(
    planes, transmission, rays, shifts, stop, second, micro_images, squares, falloff, tilt,
    a, c, b, d
):  # fmt: skip
    """Light of a pixel through every lenslet that can send it any."""
    light = 0.0
    down, right = on_array(micro_images, a, c, b, d)
    reach, cosine, sine = micro_images.reach, micro_images.cosine, micro_images.sine
    for k in range(math.ceil(down - reach), math.floor(down + reach) + 1):
        for h in range(math.ceil(right - reach), math.floor(right + reach) + 1):
            m, n = k * cosine + h * sine, h * cosine - k * sine
            if whole(squares, down - k, right - h):
                light += bundle(
                    planes, transmission, rays, shifts, stop, second, None, micro_images,
                    falloff, tilt, m, n, down - k, right - h, a, c, b, d
                )  # fmt: skip
            else:
                light += bundle(
                    planes, transmission, rays, shifts, stop, second, squares, micro_images,
                    falloff, tilt, m, n, down - k, right - h, a, c, b, d
                )  # fmt: skip
    return light


def _trace_planes(queue, planes, rays, weights, stop, second, falloff, seen, share, out):
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
    for k in pieces(queue, lines.size):
        a, c = k // lines.shape[1], k % lines.shape[1]
        if not lines[a, c]:
            continue
        for b in range(seen.first.size):
            for d in range(seen.first[b], seen.last[b]):
                light = 0.0
                for i in range(rays_y):
                    for j in range(rays_x):
                        weight = passes(stop, second, None, 0.0, 0.0, a, c, i, b, d, j)
                        weight *= shade_ray(falloff, None, 0.0, 0.0, a, c, i, b, d, j)
                        light += weight * radiance(
                            planes, planes.transmission, rays, weights, a, c, i, b, d, j
                        )
                out[a, b, c, d] += light * share


def _trace_apart(queue, planes, rays, weights, seen, share, out):
    """Do the same for one plane whose light nothing bounds, in fewer operations.

    The place of ray (i, j) depends on i along y and on j along x alone. So the sum over i, of what
    the rays of a line (a, c) see of each column of cells, is taken once for all pixels of the line:
    the same rays x rays for each pixel, at the price of its rays along x.
    """
    cells = planes.stride[0]
    lines = seen.lines
    for k in pieces(queue, lines.size):
        a, c = k // lines.shape[1], k % lines.shape[1]
        if not lines[a, c]:
            continue
        line = np.zeros(cells)
        for i in range(rays.rows.shape[3]):
            add_rows(line, planes.emission, rays.rows[0, a, c, i], weights.down[0, a, c, i])
        for b in range(seen.first.size):
            for d in range(seen.first[b], seen.last[b]):
                light = 0.0
                for j in range(rays.columns.shape[3]):
                    x = rays.columns[0, b, d, j]
                    light += line[x] + weights.right[0, b, d, j] * (line[x + 1] - line[x])
                out[a, b, c, d] += light * share


def _add_rows(line, values, first, down):
    """Add a row of cells and the next one to a line, the next with weight `down`."""
    size = line.size
    upper, lower = values[first : first + size], values[first + size : first + 2 * size]
    for x in range(size):
        line[x] += upper[x] + down * (lower[x] - upper[x])


def _trace_lenslets(
    queue,
    planes,
    rays,
    shifts,
    stop,
    second,
    micro_images,
    squares,
    falloff,
    tilt,
    seen,
    share,
    out,
):
    """Do the same for light through every lenslet that can send a pixel any."""
    lines = seen.lines
    for k in pieces(queue, lines.size):
        a, c = k // lines.shape[1], k % lines.shape[1]
        if not lines[a, c]:
            continue
        for b in range(seen.first.size):
            for d in range(seen.first[b], seen.last[b]):
                light = through_lenslets(
                    planes, planes.transmission, rays, shifts, stop, second, micro_images, squares,
                    falloff, tilt, a, c, b, d
                )  # fmt: skip
                out[a, b, c, d] += light * share


# Each is compiled where it is called, for the types that it meets there. What is called for each
# ray has no loop and no early return where it can do without: Numba then need not count references
# to the tables' arrays, which would cost several times the work itself.
cell = njit(_cell)
hit = njit(_hit)
box_mean = njit(_box_mean)
mean = njit(_mean)
hit_shifted = njit(_hit_shifted)
radiance_shifted = njit(_radiance_shifted)
radiance = njit(_radiance)
bundle = njit(_bundle)
through_lenslets = njit(_through_lenslets)

add_rows = njit(_add_rows)

trace_planes = shared(_trace_planes)
trace_apart = shared(_trace_apart)
trace_lenslets = shared(_trace_lenslets)
