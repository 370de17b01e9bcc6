"""Weight of a ray, compiled: what stops and micro-images let through of its box, and cos^4."""

import math
from typing import NamedTuple

from numba import njit


class Pixel(NamedTuple):
    """Indices of a pixel in an image ``[view_row, view_column, row, column]``."""

    view_row: int
    view_column: int
    row: int
    column: int


class Ray(NamedTuple):
    """Indices of a ray among those of a pixel, along y and along x."""

    row: int
    column: int


class Lenslet(NamedTuple):
    """Lenslet that light comes through: pitches along y and x from the pixel's own lenslet."""

    down: float
    right: float
    aside_y: float  # displacement in mm from where the pixel's own lenslet is read
    aside_x: float


class Place(NamedTuple):
    """Position of a pixel from the centre of a micro-image, along the array's axes.

    In the pitch of the micro-images, so that those of other lenslets are whole numbers apart.
    """

    down: float
    right: float


@njit
def crossing(stop, shifts, k, lenslet, pixel, ray):
    """Position where a ray crosses round stop number k, in mm from the stop's centre."""
    y = stop.rows[pixel.view_row, pixel.row, ray.row]
    x = stop.columns[pixel.view_column, pixel.column, ray.column]
    if shifts is not None:
        y += lenslet.aside_y * shifts.stops[k]
        x += lenslet.aside_x * shifts.stops[k]
    return y, x


@njit
def passes(stop, second, shifts, lenslet, pixel, ray):
    """Share of a ray's box inside two round stops, whose edges are straight within the box.

    Both stops have the same axis. Stops that cut the box from the same side leave the smaller of
    the two shares; from opposite sides, the overlap of the two.
    """
    if stop is None:
        return 1.0
    y, x = crossing(stop, shifts, 0, lenslet, pixel, ray)
    share = left_by_edge(stop.radius, y, x, abs(stop.height), abs(stop.width))
    if second is None:
        return share
    then_y, then_x = crossing(second, shifts, 1, lenslet, pixel, ray)
    other = left_by_edge(second.radius, then_y, then_x, abs(second.height), abs(second.width))
    # Above 0 where both edges cut from the same side, as the box lies on the pixel.
    along = y * stop.height * then_y * second.height + x * stop.width * then_x * second.width
    return left_by_both(share, other, along)


@njit
def left_by_both(share, other, along):
    """Share of a box that two straight edges leave; along < 0: they cut from opposite sides."""
    if along < 0.0:
        return max(share + other - 1.0, 0.0)
    return min(share, other)


@njit
def left_by_edge(radius, y, x, tall, wide):
    """Share of a box, centred at (y, x), inside a circle about the axis."""
    squared, edge = y * y + x * x, tall + wide  # the box is at most `edge` wide in any direction
    if edge > radius:  # a stop of the size of the box: a square of the same area replaces it
        half = 0.5 * math.sqrt(math.pi) * radius
        return overlap(y, tall, half) * overlap(x, wide, half)
    if squared > (radius + edge) * (radius + edge):
        return 0.0
    if squared > (radius - edge) * (radius - edge):
        distance = math.sqrt(squared)
        breadth = (abs(y) * tall + abs(x) * wide) / distance
        return min(max((radius - distance) / max(breadth, 1e-300) + 0.5, 0.0), 1.0)
    return 1.0


@njit
def on_array(micro_images, pixel):
    """Position of a pixel from the centre of its own lenslet's micro-image."""
    row, column = (pixel.view_row, pixel.row), (pixel.view_column, pixel.column)
    y = micro_images.rows[row] + micro_images.shift_rows[column]
    x = micro_images.columns[column] + micro_images.shift_columns[row]
    # Along the axes of the rotated array.
    cosine, sine = micro_images.cosine, micro_images.sine
    return Place(cosine * y - sine * x, cosine * x + sine * y)


@njit
def inside(squares, micro_images, place, ray):
    """Share of a ray's box on the sensor that lies in a square micro-image."""
    if squares is None:
        return 1.0
    y, x = squares.down[ray.row], squares.right[ray.column]
    cosine, sine = micro_images.cosine, micro_images.sine
    along = overlap(place.down + cosine * y - sine * x, squares.height, 0.5)
    return along * overlap(place.right + cosine * x + sine * y, squares.width, 0.5)


@njit
def overlap(position, breadth, half):
    """Share of a box, centred at a position, that lies between -half and half."""
    if breadth <= 0.0:
        return 1.0 if abs(position) <= half else 0.0
    low, high = max(position - breadth / 2, -half), min(position + breadth / 2, half)
    return max(high - low, 0.0) / breadth


@njit
def whole(squares, place):
    """Whether all of a pixel lies in a square micro-image, at any rotation."""
    if squares is None:
        return False
    return max(abs(place.down), abs(place.right)) < 0.5 - 0.75 * squares.pixel


@njit
def shade(falloff, a, c, b, d):
    """Mean of cos^4 over the angles at which a pixel's rays leave the main lens."""
    if falloff is None:
        return 1.0
    return cos4(falloff.rows[a, c] + falloff.columns[b, d], falloff.patch)


@njit
def shade_ray(falloff, tilt, lenslet, pixel, ray):
    """Mean of cos^4 over a ray's box, through a lenslet."""
    if falloff is None:
        return 1.0
    down = falloff.rows[pixel.view_row, pixel.row] + falloff.down[ray.row]
    right = falloff.columns[pixel.view_column, pixel.column] + falloff.right[ray.column]
    if tilt is not None:
        down += tilt.rows[pixel.view_column, pixel.column] + lenslet.down * tilt.pitch
        right += tilt.columns[pixel.view_row, pixel.row] + lenslet.right * tilt.pitch
    return cos4(down * down + right * right, falloff.patch)


@njit
def cos4(squared, patch):
    """Mean of cos^4 over a patch of the main lens about a position of such a squared tangent.

    By the mean and the variance of the squared tangents over the patch, of a width w along both
    axes: ``w^2 / 6`` more than in its centre, which is `patch`, and ``r w^2 / 3 + w^4 / 90``.
    """
    cos2 = 1.0 / (1.0 + squared + patch)
    variance = patch * (2.0 * squared + 0.4 * patch)
    return cos2 * cos2 * (1.0 + 3.0 * variance * cos2 * cos2)
