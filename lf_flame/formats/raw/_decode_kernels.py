"""The compiled loop of decoding: pixels under a lenslet to equal parts of its micro-image.

Only pixels that belong to the lenslet are read; beyond the last one along a line, light goes on
linearly for a pixel. Light is summed along a line; between the pixels' edges the sum is the cubic
through the four nearest edges, and differences of it are the light of parts (Colella and Woodward
1984, section 1). Pixels are reproduced where parts coincide with them, and a view's light comes
from its part's centre, also at the rim. The loop gathers: one thread writes each element.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from lf_flame._common.threads import parallel


class Room(NamedTuple):
    """Arrays to work in, for one micro-image."""

    own: np.ndarray
    """Own pixels of each line and those that continue them, (lines, pixels)."""
    pixels: np.ndarray
    """The same, (pixels, lines)."""
    across: np.ndarray
    """Light of the parts along each line, (u, lines)."""
    lines: np.ndarray
    """The same of the lines that show a part, and of those that continue them, (lines, u)."""
    low: np.ndarray
    """First of the own pixels of each line."""
    high: np.ndarray
    """Last + 1 of them, 0 if there is none."""
    first: np.ndarray
    """First of the own lines of each part across."""
    end: np.ndarray
    """Last + 1 of them, 0 if there is none."""
    total: np.ndarray
    light: np.ndarray
    """(v, u)."""


@njit
def find_own_pixels(y, x, array, size):
    """First and last + 1 of the pixels of a row that belong to a lenslet.

    y: distance of the row from the lenslet's centre. x: place of the centre in the row.
    """
    if array.radius > 0.0:
        if abs(y) > array.radius:
            return 0, 0
        high = np.sqrt(array.radius * array.radius - y * y)
        low = -high
    else:
        low = (-array.half_along - array.sin * y) / array.cos
        high = (array.half_along - array.sin * y) / array.cos
        if abs(array.sin) > 1e-9:
            one = (array.cos * y - array.half_down) / array.sin
            other = (array.cos * y + array.half_down) / array.sin
            low, high = max(low, min(one, other)), min(high, max(one, other))
        elif abs(y) > array.half_down:
            return 0, 0
    return max(int(np.ceil(x + low)), 0), min(int(np.floor(x + high)) + 1, size)


@njit
def continue_linearly(values, first, end):
    """Fill what is before `first` and from `end` on, linearly for two steps, then evenly."""
    before = after = np.float32(0.0)
    if end - first > 1:
        before = values[first] - values[first + 1]
        after = values[end - 1] - values[end - 2]
    if first > 0:
        values[first - 1] = values[first] + before
    for k in range(first - 1):
        values[k] = values[first] + np.float32(2.0) * before
    if end < values.size:
        values[end] = values[end - 1] + after
    for k in range(end + 1, values.size):
        values[k] = values[end - 1] + np.float32(2.0) * after


@njit
def integrate(values, edges, start, drift, together, total, light):
    """Find the mean light between edges along many lines, light[edge, line].

    values: (pixels, lines). edges: from the centre, which is at start + drift line in line. So many
    lines together are read at the same pixels. total: room for sums, (pixels + 1, lines).
    """
    n, lines = values.shape
    for line in range(lines):
        total[0, line] = 0.0
    for k in range(n):
        below, above, pixel = total[k], total[k + 1], values[k]
        for line in range(lines):
            above[line] = below[line] + pixel[line]
    share, sixth, half = 1.0 / (edges[1] - edges[0]), np.float32(1 / 6), np.float32(0.5)
    one, two, three = np.float32(1.0), np.float32(2.0), np.float32(3.0)
    scale, move = np.float32(share), np.float32(drift)
    for begin in range(0, lines, together):
        some = slice(begin, min(begin + together, lines))
        count = min(together, lines - begin)
        for j in range(edges.size):
            middle = start + edges[j] + drift * (begin + 0.5 * (count - 1))
            k = min(max(int(middle) - 1, 0), n - 3)
            near, left = total[k, some], total[k + 1, some]
            right, far = total[k + 2, some], total[k + 3, some]
            place = np.float32(start + edges[j] - k + drift * begin)
            before, after = light[max(j - 1, 0), some], light[min(j, edges.size - 2), some]
            for line in range(count):
                a = place + move * np.float32(line)
                b, c, d = a - one, a - two, a - three
                up_to = half * a * d * (c * left[line] - b * right[line])
                up_to += sixth * b * c * (a * far[line] - d * near[line])
                up_to *= scale
                if j > 0:
                    before[line] += up_to
                if j < edges.size - 1:
                    after[line] = -up_to


@njit
def read_line(image, black, gain, i, j, step, channel, line):
    """Read pixels of row i from column j on, less their black level, times their factors."""
    for k in range(line.size):
        line[k] = image[i, j + step * k, channel]
    if black.size > 0:
        under = min(channel, black.shape[2] - 1)
        for k in range(line.size):
            line[k] -= black[i, j + step * k, under]
    if gain.size > 0:
        own = min(channel, gain.shape[2] - 1)
        for k in range(line.size):
            line[k] *= gain[i, j + step * k, own]


@njit
def fill_green(own, low, high, left, odd):
    """Give pixels of other colours the mean of opposite green neighbours in the micro-image.

    Both neighbours of a pair, so that linear light stays as it is. odd: whether the sum of row and
    column of a green pixel is odd, counted from the first line and place 0 of `own`. A pixel
    without a pair at an end of its line is taken off.
    """
    for here in range(low.size):
        first, end = low[here] - left, high[here] - left
        for k in range(first + (here + first + 1 - odd) % 2, end, 2):
            pairs, total = np.float32(0.0), np.float32(0.0)
            if first < k < end - 1:
                pairs, total = pairs + np.float32(2.0), own[here, k - 1] + own[here, k + 1]
            if 0 < here < low.size - 1:
                above = low[here - 1] <= k + left < high[here - 1]
                if above and low[here + 1] <= k + left < high[here + 1]:
                    pairs += np.float32(2.0)
                    total += own[here - 1, k] + own[here + 1, k]
            if pairs > 0:
                own[here, k] = total / pairs
            elif k == first:
                low[here] += 1
            else:
                high[here] -= 1


@njit
def read_lines(image, black, gain, lattices, lattice, y, x, array, room):
    """Read a micro-image's own, lit pixels line by line, and continue each line beyond them.

    Fills room.pixels, and room.first and room.end, of the own lines of each part across. lattice:
    number of the lattice. y, x: centre in its pixels.
    """
    step, channel = lattices.step[lattice], lattices.source[lattice]
    first, end, own, low, high = room.first, room.end, room.own, room.low, room.high
    top, left = int(np.ceil(y - array.high)), int(np.ceil(x - array.wide))
    views, tan = first.size, array.sin / array.cos
    part = array.along[1] - array.along[0]
    j, factor = lattices.left[lattice], min(channel, gain.shape[2] - 1)
    for here in range(low.size):
        row = top + here
        low[here], high[here] = 0, 0
        if row < 0 or (row + 1) * step > image.shape[0]:
            continue
        begin, stop = find_own_pixels(row - y, x, array, image.shape[1] // step)
        i = lattices.top[lattice] + step * row
        if gain.size > 0:
            while begin < stop and gain[i, j + step * begin, factor] == 0.0:
                begin += 1
            while begin < stop and gain[i, j + step * (stop - 1), factor] == 0.0:
                stop -= 1
        if stop - begin >= array.fewest:
            low[here], high[here] = begin, stop
            line = own[here, begin - left : stop - left]
            read_line(image, black, gain, i, j + step * begin, step, channel, line)
    if lattices.green[lattice] >= 0:
        fill_green(own, low, high, left, (lattices.green[lattice] + top + left) % 2)
    end[:] = 0
    for here in range(low.size):
        if high[here] - low[here] < array.fewest:
            continue
        continue_linearly(own[here], low[here] - left, high[here] - left)
        # Parts whose middle is within the own pixels, or half a pixel beyond.
        begin = (array.along[0] + x - tan * (top + here - y)) / part + 0.5
        from_u = max(int(np.ceil((low[here] - 1.0) / part - begin)), 0)
        for u in range(from_u, min(int(np.floor(high[here] / part - begin)) + 1, views)):
            first[u] = here if end[u] == 0 else first[u]
            end[u] = here + 1
    for here in range(low.size):
        for k in range(room.pixels.shape[0]):
            room.pixels[k, here] = own[here, k]


@njit
def read_micro_image(image, black, gain, lattices, lattice, y, x, array, room):
    """Find the light of the parts of one micro-image, room.light[v, u], in one lattice."""
    first, end, lines = room.first, room.end, room.lines
    read_lines(image, black, gain, lattices, lattice, y, x, array, room)
    top, left = int(np.ceil(y - array.high)), int(np.ceil(x - array.wide))
    tan = array.sin / array.cos
    integrate(
        room.pixels, array.along, x - left + 0.5 - tan * (top - y), -tan, array.together,
        room.total, room.across,
    )  # fmt: skip
    size, middle = first.size, first.size // 2
    for n in range(size):
        # From the middle on, then from there back, so that the inner neighbour is known.
        u, inner = (middle + n, middle + n - 1) if n < size - middle else (size - 1 - n, size - n)
        if end[u] == 0 and n > 0:  # beyond the lit pixels: as its neighbour
            first[u], end[u] = first[inner], end[inner]
        if end[u] > 0:
            continue_linearly(room.across[u], first[u], end[u])
        else:
            room.across[u] = 0.0
    for here in range(lines.shape[0]):
        for u in range(size):
            lines[here, u] = room.across[u, here]
    middle, part = 0.5 * (array.along[0] + array.along[1]), array.along[1] - array.along[0]
    integrate(
        lines, array.down, y - top + 0.5 + array.shear * middle, array.shear * part,
        array.together, room.total, room.light,
    )  # fmt: skip


@njit
def make_room(array, views):
    """Make room to work in."""
    high, wide = 2 * int(array.high) + 2, 2 * int(array.wide) + 2
    return Room(
        np.zeros((high, wide), np.float32), np.zeros((wide, high), np.float32),
        np.zeros((views, high), np.float32),
        np.zeros((high, views), np.float32), np.zeros(high, np.int64), np.zeros(high, np.int64),
        np.zeros(views, np.int64), np.zeros(views, np.int64),
        np.empty((max(wide, high) + 1, max(views, high)), np.float32),
        np.zeros((views, views), np.float32),
    )  # fmt: skip


@parallel(lambda arrays: arrays[0].rows.size)
def resample(r, image, black, gain, lattices, arrays, join, out):
    """Find the light of all parts of the micro-images in a row of lenslets.

    image: (rows, columns, channels). black, gain: float32, of this shape or with one channel;
    empty without dark or white image; gain is 0 where a pixel is dark. lattices, join: named tuples
    of `decode_plan`, and arrays: two of them, in pixels and in pairs of pixels.
    out: (v, u, row, column, channel).
    """
    views, size = out.shape[0], arrays[0].columns.size
    rooms = (make_room(arrays[0], views), make_room(arrays[1], views))
    line = np.empty((views, views, size, out.shape[4]), np.float32)
    light = np.empty((out.shape[4], views, views), np.float32)
    parity = arrays[0].rows[r] % 2
    for c in range(size):
        light[:] = 0.0
        for lattice in range(lattices.top.size):
            # Pixels of a colour that are two apart have an array of their own, in their pixels.
            array, room = arrays[lattices.step[lattice] - 1], rooms[lattices.step[lattice] - 1]
            along = array.pitch * (array.columns[c] + array.offset * parity)
            down = array.row_pitch * array.rows[r]
            y = lattices.y[lattice] + array.sin * along + array.cos * down
            x = lattices.x[lattice] + array.cos * along - array.sin * down
            read_micro_image(image, black, gain, lattices, lattice, y, x, array, room)
            channel = lattices.channel[lattice]
            for v in range(views):
                for u in range(views):
                    light[channel, v, u] = room.light[v, u]
        for v in range(views):
            for u in range(views):
                for channel in range(out.shape[4]):
                    line[v, u, c, channel] = light[channel, v, u]
    for v in range(views):
        for u in range(views):
            for c in range(out.shape[3]):
                for channel in range(out.shape[4]):
                    if join.left.size == 0:
                        out[v, u, r, c, channel] = line[v, u, c, channel]
                    else:
                        near = join.left[parity, c]
                        low, high = line[v, u, near, channel], line[v, u, near + 1, channel]
                        out[v, u, r, c, channel] = low + join.share[parity, c] * (high - low)
