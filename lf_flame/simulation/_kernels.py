"""The compiled loops of both integrators: arrays in, output array filled, nothing returned.

All loops gather: each output element is summed by one thread in a fixed order, so the bits do not
depend on the number of threads. Sums run in float64.
Light fields are ``[v, u, t, s]``.
"""

import math

import numpy as np
from numba import njit

from lf_flame._common.threads import pieces, shared

TINY = np.finfo(float).tiny
"""Divides where a width may be 0."""


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


def _crossing(stop, shifts, m, n, k, a, c, i, b, d, j):
    """Where a ray crosses a round stop, in mm from its middle. k: of the stop."""
    y, x = stop.rows[a, c, i], stop.columns[b, d, j]
    if shifts is not None:
        y += shifts.stop_rows[k, b, d] + m * shifts.stop_pitch[k]
        x += shifts.stop_columns[k, a, c] + n * shifts.stop_pitch[k]
    return y, x


def _passes(stop, second, shifts, m, n, a, c, i, b, d, j):
    """Share of a ray's box that the edges of two round stops leave, taken as straight in it.

    Both have one axis. Where they cut a box from the same side they leave the smaller share of it;
    from opposite sides, what is left of both.
    """
    if stop is None:
        return 1.0
    y, x = crossing(stop, shifts, m, n, 0, a, c, i, b, d, j)
    share = left_by_edge(stop.radius, y, x, abs(stop.height), abs(stop.width))
    if second is None:
        return share
    then_y, then_x = crossing(second, shifts, m, n, 1, a, c, i, b, d, j)
    other = left_by_edge(second.radius, then_y, then_x, abs(second.height), abs(second.width))
    # The sides from which they cut, as the box lies on the pixel.
    along = y * stop.height * then_y * second.height + x * stop.width * then_x * second.width
    return left_by_both(share, other, along)


def _left_by_both(share, other, along):
    """Share of a box that two straight edges leave; along: below 0 for opposite sides."""
    if along < 0.0:
        return max(share + other - 1.0, 0.0)
    return min(share, other)


def _left_by_edge(radius, y, x, tall, wide):
    """Share of a box that lies inside a circle about the axis."""
    squared, edge = y * y + x * x, tall + wide  # no box is broader than its edge
    if edge > radius:  # a stop within a box or two: as a square of the same area
        half = 0.5 * math.sqrt(math.pi) * radius
        return overlap(y, tall, half) * overlap(x, wide, half)
    if squared > (radius + edge) * (radius + edge):
        return 0.0
    if squared > (radius - edge) * (radius - edge):
        distance = math.sqrt(squared)
        breadth = (abs(y) * tall + abs(x) * wide) / distance
        return min(max((radius - distance) / max(breadth, 1e-300) + 0.5, 0.0), 1.0)
    return 1.0


def _on_array(micro_images, a, c, b, d):
    """Place of a pixel from the middle of its lenslet's micro-image, along the array's own axes.

    In the pitch of the micro-images, so that those of other lenslets are whole numbers apart.
    """
    y = micro_images.rows[a, c] + micro_images.shift_rows[b, d]
    x = micro_images.columns[b, d] + micro_images.shift_columns[a, c]
    cosine, sine = micro_images.cosine, micro_images.sine
    return cosine * y - sine * x, cosine * x + sine * y


def _inside(squares, micro_images, down, right, i, j):
    """Share of a ray's box on the sensor that lies in a square micro-image.

    down, right: of the pixel from the middle of the micro-image, in its sides.
    """
    if squares is None:
        return 1.0
    y, x = squares.down[i], squares.right[j]
    cosine, sine = micro_images.cosine, micro_images.sine
    along = overlap(down + cosine * y - sine * x, squares.height, 0.5)
    return along * overlap(right + cosine * x + sine * y, squares.width, 0.5)


def _overlap(position, breadth, half):
    """Share of a box that lies between -half and half."""
    if breadth <= 0.0:
        return 1.0 if abs(position) <= half else 0.0
    low, high = max(position - breadth / 2, -half), min(position + breadth / 2, half)
    return max(high - low, 0.0) / breadth


def _whole(squares, down, right):
    """Whether all of a pixel lies in a square micro-image, however it is turned."""
    return squares is not None and max(abs(down), abs(right)) < 0.5 - 0.75 * squares.pixel


def _shade(falloff, a, c, b, d):
    """Mean of cos^4 over the angles at which a pixel's rays leave the main lens."""
    if falloff is None:
        return 1.0
    return cos4(falloff.rows[a, c] + falloff.columns[b, d], falloff.patch)


def _shade_ray(falloff, tilt, m, n, a, c, i, b, d, j):
    """Mean of cos^4 over a ray's box, through a lenslet m and n pitches further on."""
    if falloff is None:
        return 1.0
    down = falloff.rows[a, c] + falloff.down[i]
    right = falloff.columns[b, d] + falloff.right[j]
    if tilt is not None:
        down += tilt.rows[b, d] + m * tilt.pitch
        right += tilt.columns[a, c] + n * tilt.pitch
    return cos4(down * down + right * right, falloff.patch)


def _both(shaded, a, c, b, d):
    """Whether a pixel is marked along y and along x; without marks, none is."""
    if shaded is None:
        return False
    rows, columns = shaded
    return rows[a, c] and columns[b, d]


def _cos4(squared, patch):
    """Mean of cos^4 over a patch of the main lens about a place of such a squared tangent.

    By the mean and the variance of the squared tangents over the patch, of a width w along both
    axes: ``w^2 / 6`` more than in its middle, which is `patch`, and ``r w^2 / 3 + w^4 / 90``.
    """
    cos2 = 1.0 / (1.0 + squared + patch)
    variance = patch * (2.0 * squared + 0.4 * patch)
    return cos2 * cos2 * (1.0 + 3.0 * variance * cos2 * cos2)


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


def _add_polygons(queue, planes, rows, columns, falloff, out):
    """Add the sum over pairs of polygons to each pixel, out[a, b, c, d].

    The planes are those of `lf_flame.simulation.ray_tables`; rows and columns those of
    `lf_flame.simulation.polygons`, for (a, c) and (b, d).
    """
    count = planes.first.size
    for k in pieces(queue, rows.first.size - 1):
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


def _trapezoid_cdf(x, wide, narrow):
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


def _weigh_bands(edges, centres, lenslet, pixels, start, weights):
    """Shares of trapezoids in cells: weights[k, i] of cell start[k] + i for centres[k].

    edges[cell]: evenly spaced. lenslet, pixels[k]: widths of the boxes that make a trapezoid.
    """
    cells, cell_width = edges.size - 1, edges[1] - edges[0]
    band, border = weights.shape[1], edges[cells]
    for k in range(centres.size):
        centre, wide, narrow = centres[k], max(lenslet, pixels[k]), min(lenslet, pixels[k])
        reach = (lenslet + pixels[k]) / 2
        if centre + reach < edges[0] or centre - reach > border:  # as most do: in short
            start[k] = 0 if centre < border else cells - band
            weights[k] = 0.0
            continue
        first = math.floor((centre - reach - edges[0]) / cell_width)
        start[k] = min(max(first, 0), cells - band)
        near = trapezoid_cdf(edges[start[k]] - centre, wide, narrow)
        for i in range(band):
            far = trapezoid_cdf(edges[start[k] + i + 1] - centre, wide, narrow)
            weights[k, i] = far - near
            near = far


def _integrate_columns(queue, texture, start, weight, first, last, out):
    """``texture @ Kx.T``, K banded: out[row, b, d].

    start[b, d], weight[b, d, j]: first cell and weights of the band.
    """
    for row in pieces(queue, texture.shape[0]):
        cells = texture[row]
        for b in range(start.shape[0]):
            for d in range(first[b], last[b]):
                light, near, band = 0.0, start[b, d], weight[b, d]
                for j in range(band.size):
                    light += band[j] * cells[near + j]
                out[row, b, d] = light


def _integrate_rows(queue, columns, start, weight, falloff, seen, first, last, shaded, out):
    """Add ``Ky @ columns`` to each pixel, out[a, b, c, d], for a batch of planes.

    columns[row, b, d]: the planes' textures, integrated along x, one below the other.
    start[p, a, c], weight[p, a, c, i]: first row and weights of the band in plane p.
    seen[p, a, c], first[p, b], last[p, b]: the pixels along y and x that can see plane p.
    shaded: None, or [a, c] and [b, d]; pixels for which both are true are left as they are.
    """
    planes, groups, lines, band = weight.shape
    for k in pieces(queue, groups * lines):
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


# Each is compiled where it is called, for the types that it meets there. What is called for each
# ray has no loop and no early return where it can do without: Numba then need not count references
# to the tables' arrays, which would cost several times the work itself.
whole = njit(_whole)
cos4 = njit(_cos4)
shade = njit(_shade)
shade_ray = njit(_shade_ray)
both = njit(_both)
overlap = njit(_overlap)
crossing = njit(_crossing)
left_by_edge = njit(_left_by_edge)
left_by_both = njit(_left_by_both)
passes = njit(_passes)
on_array = njit(_on_array)
inside = njit(_inside)
cell = njit(_cell)
hit = njit(_hit)
trapezoid_cdf = njit(_trapezoid_cdf)
box_mean = njit(_box_mean)
mean = njit(_mean)
hit_shifted = njit(_hit_shifted)
radiance_shifted = njit(_radiance_shifted)
radiance = njit(_radiance)
bundle = njit(_bundle)
through_lenslets = njit(_through_lenslets)

trace_planes = shared(_trace_planes)
trace_lenslets = shared(_trace_lenslets)
add_polygons = shared(_add_polygons)
weigh_bands = njit(cache=True)(_weigh_bands)
integrate_columns = shared(_integrate_columns)
integrate_rows = shared(_integrate_rows)
