"""The compiled loops of decoding: pixels to spline coefficients, and these to views.

The arrays of a lattice are padded by `MARGIN` pixels on each side; positions count from the padded
corner. All loops gather: each element is written by one thread.
"""

import numpy as np
from numba import njit

from lf_flame._common.threads import parallel

MARGIN = 16
"""Number of repeated edge pixels around a lattice; a spline's end effect falls by 0.27 for each."""

POLE = np.float32(np.sqrt(3) - 2)
"""Pole of the recursive filter from pixels to spline coefficients (Unser 1999, box 2)."""

GAIN = np.float32(6.0)
"""Gain of that filter, with which a constant image gives equal coefficients."""

LANES = 256
"""Number of columns that one thread filters at a time."""


@njit
def read_row(image, black, y, first, step, line):
    """Read the pixels of a row of a lattice less their black level, and repeat those at its ends.

    y: row of the image. first, step: column of the lattice's first pixel, and distance to the next.
    """
    width = line.size - 2 * MARGIN
    for x in range(width):
        at = first + step * x
        line[MARGIN + x] = image[y, at]
        if black is not None:
            line[MARGIN + x] = image[y, at] - black[y, at]
    line[:MARGIN] = line[MARGIN]
    line[MARGIN + width :] = line[MARGIN + width - 1]


@njit
def filter_four(p, q, r, s):
    """Filter four rows; the processor waits for one's sums while it makes those of the others.

    Two passes, forward and backward, invert the spline's values at the pixels (Unser 1999).
    """
    # Before the first pixel a row is constant, so that the filter's state is known.
    a, b = GAIN * p[0] / (1 - POLE), GAIN * q[0] / (1 - POLE)
    c, d = GAIN * r[0] / (1 - POLE), GAIN * s[0] / (1 - POLE)
    last = p.size - 1
    ends = p[last], q[last], r[last], s[last]
    for x in range(p.size):
        p[x] = a = GAIN * p[x] + POLE * a
        q[x] = b = GAIN * q[x] + POLE * b
        r[x] = c = GAIN * r[x] + POLE * c
        s[x] = d = GAIN * s[x] + POLE * d
    a, b, c, d = ends
    for x in range(last, -1, -1):
        p[x] = a = POLE * (a - p[x])
        q[x] = b = POLE * (b - q[x])
        r[x] = c = POLE * (c - r[x])
        s[x] = d = POLE * (d - s[x])


@parallel(lambda out: -(-len(out) // 4))
def filter_rows(k, image, black, first, step, filtered, out):
    """Read the pixels of a lattice less their black level, and perhaps filter them along rows.

    image: shape (rows, columns). black: the same, or None. first, step: row and column of the
    lattice's first pixel, and distances to the next.
    """
    rows, columns = out.shape
    spare = np.zeros(columns, np.float32)  # in place of rows beyond the last
    begin = 4 * k
    for row in range(begin, min(begin + 4, rows)):
        y = first[0] + step[0] * min(max(row - MARGIN, 0), rows - 2 * MARGIN - 1)
        read_row(image, black, y, first[1], step[1], out[row])
    if filtered:
        filter_four(
            out[begin],
            out[begin + 1] if begin + 1 < rows else spare,
            out[begin + 2] if begin + 2 < rows else spare,
            out[begin + 3] if begin + 3 < rows else spare,
        )


@parallel(lambda out: -(-out.shape[1] // LANES))
def filter_columns(k, out):
    """Filter along the columns, many side by side."""
    rows, columns = out.shape
    lanes = slice(k * LANES, min((k + 1) * LANES, columns))
    last = out[rows - 1, lanes].copy()
    out[0, lanes] *= GAIN / (1 - POLE)
    for y in range(1, rows):
        here, before = out[y, lanes], out[y - 1, lanes]
        for x in range(here.size):
            here[x] = GAIN * here[x] + POLE * before[x]
    for x in range(last.size):
        out[rows - 1, lanes][x] = POLE * (last[x] - out[rows - 1, lanes][x])
    for y in range(rows - 2, -1, -1):
        here, after = out[y, lanes], out[y + 1, lanes]
        for x in range(here.size):
            here[x] = POLE * (after[x] - here[x])


@njit
def find_weights(positions, first, table, weights, slopes):
    """Weights of the coefficients beside many positions, and their changes with the position.

    positions: shape (n,). first: shape (n,), index of the coefficient of the first weight.
    weights, slopes: shape (taps or more, n), filled.
    """
    for c in range(positions.size):
        spot = (positions[c] + table.start - first[c]) * table.steps
        low = int(spot)
        rest = np.float32(spot - low)
        for i in range(table.values.shape[1]):
            rise = table.values[low + 1, i] - table.values[low, i]
            weights[i, c] = table.values[low, i] + rest * rise
            slopes[i, c] = rise * np.float32(table.steps)


@njit
def along_rows(coefficients, base, line, first, weights, slopes, taps, move, out):
    """Sum coefficients of the pixel row base[c] + line from first[c] on, for each c.

    move: distance of the positions from those of the weights.
    """
    for c in range(out.size):
        total = np.float32(0.0)
        row, column = np.uintp(base[c] + line), np.uintp(first[c])
        for i in range(len(taps)):
            weight = weights[i, c] + move * slopes[i, c]
            total += weight * coefficients[row, column + np.uintp(i)]
        out[c] = total


@njit
def down_columns(lines, weights, slopes, taps, move, share, out):
    """Add the sum of lines[:, c], times a share, for each c."""
    for c in range(out.size):
        total = np.float32(0.0)
        for i in range(len(taps)):
            total += (weights[i, c] + move * slopes[i, c]) * lines[i, c]
        out[c] += share * total


@njit
def write_row(light, gain, joined, parity, r, out):
    """Write a row of lenslets, divided by the white image, interpolated in a hexagonal array.

    light: shape (channel, v, u, lenslet), changed. parity: that of the row in the array. gain,
    joined, out: as for `resample`; r: row of gain and out.
    """
    for v in range(out.shape[0]):
        for u in range(out.shape[1]):
            for channel in range(out.shape[4]):
                line = light[channel, v, u]
                if gain.size > 0:
                    for c in range(line.size):
                        line[c] *= gain[v, u, r, c, channel]
                if joined.left.size == 0:
                    out[v, u, r, :, channel] = line
                else:
                    for c in range(out.shape[3]):
                        near = joined.left[parity, c]
                        far = joined.share[parity, c] * (line[near + 1] - line[near])
                        out[v, u, r, c, channel] = line[near] + far


@parallel(lambda array: array.rows.size)
def resample(r, lattices, places, array, across, along, taps, taps_down, gain, joined, out):
    """Resample each row of lenslets into its views: first along the pixel rows, then down.

    lattices: coefficients, shape (n, rows, columns). places, array, across, along, joined: named
    tuples of `resampling`. taps, taps_down: tuples of as many elements as there are weights along
    and across, by which the compiler knows their number. gain: factors of the parts,
    (v, u, row, column, channel), or empty, as may be those of `joined`. out: of this shape too.
    """
    views, size = array.part_down.size, array.columns.size
    cos, sin, tan = array.cos, array.sin, array.sin / array.cos
    place, position = np.empty(size), np.empty(size)
    base, first = np.empty(size, np.int64), np.empty(size, np.int64)
    weights = np.empty((len(taps_down), size), np.float32)
    slopes = np.empty((len(taps_down), size), np.float32)
    lines = np.empty((min(array.block, views), array.lines, size), np.float32)
    light = np.zeros((out.shape[4], views, views, size), np.float32)
    shifted = array.row_pitch * array.rows[r] + array.part_down[0]
    for c in range(size):
        place[c] = array.pitch * (array.columns[c] + array.offset * (array.rows[r] % 2))
    for n in range(lattices.shape[0]):
        left, top = places.left[n], places.top[n]
        for start in range(0, views, array.block):
            block = array.part_along[start : start + array.block]
            middle = block[0] / 2 + block[-1] / 2
            # The first pixel row that the block's views of each lenslet need.
            for c in range(size):
                position[c] = top + sin * (place[c] + middle) + cos * shifted
                base[c] = int(position[c] + across.start - array.slack)
            # Pass 1: the needed pixel rows, a position in a row moves by `tan` from one to the
            # next.
            for u in range(block.size):
                for begin in range(0, array.lines, array.together):
                    end = min(begin + array.together, array.lines)
                    centre = (begin + end - 1) / 2
                    for c in range(size):
                        beyond = base[c] + centre - top
                        position[c] = left + (place[c] + block[u]) / cos - tan * beyond
                        first[c] = int(position[c] + along.start)
                    find_weights(position, first, along, weights, slopes)
                    for k in range(begin, end):
                        move = np.float32(tan * (centre - k))
                        along_rows(
                            lattices[n], base, k, first, weights, slopes, taps, move,
                            lines[u, k],
                        )  # fmt: skip
            # Pass 2: down the lines, from a whole number of them after the first.
            for v in range(views):
                down = cos * (array.part_down[v] - array.part_down[0])
                skip = int(down)
                for c in range(size):
                    position[c] = top + sin * (place[c] + middle) + cos * shifted + down - skip
                find_weights(position, base, across, weights, slopes)
                for u in range(block.size):
                    move = np.float32(sin * (block[u] - middle))
                    down_columns(
                        lines[u, skip : skip + len(taps_down)], weights, slopes, taps_down,
                        move, places.share[n], light[places.channel[n], v, start + u]
                    )  # fmt: skip
    write_row(light, gain, joined, array.rows[r] % 2, r, out)
