"""Which share of a ray's box round stops and square micro-images leave, compiled."""

import math

from numba import njit


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


overlap = njit(_overlap)
crossing = njit(_crossing)
left_by_edge = njit(_left_by_edge)
left_by_both = njit(_left_by_both)
passes = njit(_passes)
on_array = njit(_on_array)
inside = njit(_inside)
whole = njit(_whole)
