"""The compiled loop of decoding: pixels under a lenslet to equal parts of its micro-image.

Only pixels that belong to the lenslet are read; beyond the last one along a line, light goes on
linearly. Light is summed along a line; between the pixels' edges the sum is the cubic
through the four nearest edges, and differences of it are the light of parts (Colella and Woodward
1984, section 1). Pixels are reproduced where parts coincide with them, and a view's light comes
from its part's centre, also at the rim. The loop gathers: one thread writes each element.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from lf_flame._common.threads import parallel, uncounted

LANES = 16
"""Number of lines that are integrated side by side, in the lanes of vector instructions."""

BLOCK = 16
"""Number of lenslets whose parts are written at a time."""


class Room(NamedTuple):
    """Arrays to work in, for one micro-image."""

    own: np.ndarray
    """Own pixels of each line, and those that continue them, (lines, pixels)."""
    across: np.ndarray
    """Light of the parts along each line, and of the lines that continue them, (u, lines)."""
    light: np.ndarray
    """(v, u)."""
    low: np.ndarray
    """First of the own pixels of each line."""
    high: np.ndarray
    """Last + 1 of them, 0 if there is none."""
    first: np.ndarray
    """First of the own lines of each part across."""
    end: np.ndarray
    """Last + 1 of them, 0 if there is none."""
    total: np.ndarray


@uncounted
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


@uncounted
def continue_linearly(values, line, n, first, end, reach):
    """Fill a line before `first`, and from `end` to n, linearly for `reach` steps, then evenly."""
    line, left, right = np.uintp(line), np.uintp(first), np.uintp(end - 1)
    one = np.uintp(end - first > 1)
    before = values[line, left] - values[line, left + one]
    after = values[line, right] - values[line, right - one]
    for k in range(first):
        steps = np.float32(min(first - k, reach))
        values[line, np.uintp(k)] = values[line, left] + steps * before
    for k in range(end, n):
        steps = np.float32(min(k + 1 - end, reach))
        values[line, np.uintp(k)] = values[line, right] + steps * after


@njit(inline="always")
def cubic(near, left, right, far, a):
    """Sum of light up to the place a: the cubic through the sums up to 0, 1, 2 and 3."""
    half, sixth = np.float32(0.5), np.float32(1 / 6)
    b, c, d = a - np.float32(1.0), a - np.float32(2.0), a - np.float32(3.0)
    return half * a * d * (c * left - b * right) + sixth * b * c * (a * far - d * near)


@uncounted
def integrate(values, lines, n, start, part, parts, drift, total, light, shift):
    """Find the mean light of parts along lines, light[number of the part, shift + line].

    values: lines of n pixels. start: where the first part begins, moved by `drift` line by line.
    part: width of each. total: room, (n + 1, LANES). light has a row and LANES columns to spare.
    """
    scale, move = np.float32(1.0 / part), np.float32(drift)
    # Unsigned numbers, as Numba would look whether others are negative, one by one.
    lanes, one, two, three = np.uintp(LANES), np.uintp(1), np.uintp(2), np.uintp(3)
    for first in range(0, lines, LANES):
        count, begin = np.uintp(min(LANES, lines - first)), np.uintp(first + shift)
        for i in range(count):
            line, up_to = np.uintp(first) + i, np.float32(0.0)
            for k in range(np.uintp(n)):
                up_to += values[line, k]
                total[k + one, i] = up_to
        for j in range(np.uintp(parts + 1)):
            place = start + part * j + drift * first
            if abs(drift) * LANES <= 0.5:  # all lines are read at the same pixels
                near = min(max(int(place + 0.5 * drift * LANES) - 1, 0), n - 3)
                away, k = np.float32(place - near), np.uintp(near)
                for i in range(lanes):
                    light[j, begin + i] = scale * cubic(
                        total[k, i], total[k + one, i], total[k + two, i], total[k + three, i],
                        away + move * np.float32(i),
                    )  # fmt: skip
            else:
                for i in range(count):
                    own = place + drift * i
                    near = min(max(int(own) - 1, 0), n - 3)
                    k = np.uintp(near)
                    light[j, begin + i] = scale * cubic(
                        total[k, i], total[k + one, i], total[k + two, i], total[k + three, i],
                        np.float32(own - near),
                    )  # fmt: skip
        for j in range(np.uintp(parts)):
            for i in range(lanes):
                light[j, begin + i] = light[j + one, begin + i] - light[j, begin + i]


@uncounted
def fill_green(own, low, high, odd):
    """Give pixels of other colours the mean of opposite green neighbours in the micro-image.

    Both neighbours of a pair, so that linear light stays as it is. odd: whether the sum of row and
    column of a green pixel is odd, counted from the first line and place 0 of `own`. A pixel
    without a pair at an end of its line is taken off.
    """
    for here in range(low.size):
        first, end = low[here], high[here]
        left = right = 0  # between them, all four neighbours are own pixels
        if 0 < here < low.size - 1:
            left = max(first + 1, low[here - 1], low[here + 1])
            right = min(end - 1, high[here - 1], high[here + 1])
        for k in range(first + (here + first + 1 - odd) % 2, end, 2):
            total, pairs = np.float32(0.0), np.float32(0.0)
            if first < k < end - 1:
                total, pairs = own[here, k - 1] + own[here, k + 1], np.float32(2.0)
            if left <= k < right:
                own[here, k] = np.float32(0.25) * (total + own[here - 1, k] + own[here + 1, k])
                continue
            if 0 < here < low.size - 1:
                above = low[here - 1] <= k < high[here - 1]
                if above and low[here + 1] <= k < high[here + 1]:
                    pairs += np.float32(2.0)
                    total += own[here - 1, k] + own[here + 1, k]
            if pairs > 0:
                own[here, k] = total / pairs
            elif k == first:
                low[here] += 1
            else:
                high[here] -= 1


@uncounted
def read_lines(image, black, gain, lattices, lattice, y, x, top, left, array, room):
    """Read a micro-image's own, lit pixels line by line, and continue each line beyond them.

    Fills room.own and its ranges. lattice: number of the lattice. y, x: centre in its pixels. top,
    left: pixel of the lattice at room.own[0, 0].
    """
    step, channel = lattices.step[lattice], lattices.source[lattice]
    own, low, high, j = room.own, room.low, room.high, lattices.left[lattice]
    # Channel of each, which may be grey; 0 where there is none.
    under, factor = (
        min(channel, max(black.shape[2], 1) - 1),
        min(channel, max(gain.shape[2], 1) - 1),
    )
    channel, under, factor = np.uintp(channel), np.uintp(under), np.uintp(factor)
    rows, columns, upper = image.shape[0], image.shape[1] // step, lattices.top[lattice]
    for here in range(low.size):
        row = top + here
        low[here], high[here] = 0, 0
        if row < 0 or (row + 1) * step > rows:
            continue
        begin, stop = find_own_pixels(row - y, x, array, columns)
        i = upper + step * row
        if gain.size > 0:
            while begin < stop and gain[i, j + step * begin, factor] == 0.0:
                begin += 1
            while begin < stop and gain[i, j + step * (stop - 1), factor] == 0.0:
                stop -= 1
        if stop - begin < array.fewest:
            continue
        low[here], high[here] = begin - left, stop - left
        line, row, count = np.uintp(here), np.uintp(i), np.uintp(stop - begin)
        first, into, stride = np.uintp(j + step * begin), np.uintp(begin - left), np.uintp(step)
        for k in range(count):
            own[line, into + k] = image[row, first + stride * k, channel]
        if black.size > 0:
            for k in range(count):
                own[line, into + k] -= black[row, first + stride * k, under]
        if gain.size > 0:
            for k in range(count):
                own[line, into + k] *= gain[row, first + stride * k, factor]
    if lattices.green[lattice] >= 0:
        fill_green(own, low, high, (lattices.green[lattice] + top + left) % 2)
    for here in range(low.size):
        if high[here] - low[here] >= array.fewest:
            continue_linearly(own, here, own.shape[1], low[here], high[here], own.shape[1])


@uncounted
def find_own_lines(start, drift, part, fewest, room):
    """Find the lines that show each part across: those in whose own pixels its middle is.

    Or half a pixel beyond. start: place of the first part's middle in line 0; it moves by `drift`.
    """
    low, high, first, end = room.low, room.high, room.first, room.end
    views = first.size
    end[:] = 0
    for here in range(low.size):
        if high[here] - low[here] < fewest:
            continue
        begin = (start + drift * here) / part
        from_u = max(int(np.ceil((low[here] - 0.5) / part - begin)), 0)
        for u in range(from_u, min(int(np.floor((high[here] + 0.5) / part - begin)) + 1, views)):
            first[u] = here if end[u] == 0 else first[u]
            end[u] = here + 1
    middle = views // 2
    for n in range(1, views):
        # From the middle on, then from there back, so that the inner neighbour is known.
        u, inner = (middle + n, middle + n - 1)
        if n >= views - middle:
            u, inner = views - 1 - n, views - n
        if end[u] == 0:  # beyond the lit pixels: as its neighbour
            first[u], end[u] = first[inner], end[inner]


@uncounted
def read_micro_image(image, black, gain, lattices, lattice, y, x, array, room):
    """Find the light of the parts of one micro-image, room.light[v, u], in one lattice."""
    own, across, margin, views = room.own, room.across, array.margin, room.first.size
    lines, pixels = own.shape
    first, end = room.first, room.end
    top, left = int(np.ceil(y - array.high)), int(np.ceil(x - array.wide))
    read_lines(image, black, gain, lattices, lattice, y, x, top, left, array, room)
    tan, part = array.sin / array.cos, array.part_along
    start = x - left + 0.5 - tan * (top - y) - 0.5 * views * part
    integrate(own, lines, pixels, start, part, views, -tan, room.total, across, margin)
    find_own_lines(start + 0.5 * part, -tan, part, array.fewest, room)
    count = lines + 2 * margin
    for u in range(views):
        if end[u] > 0:
            continue_linearly(across, u, count, margin + first[u], margin + end[u], array.reach)
        else:
            across[u] = 0.0
    # The first part across is (views - 1) / 2 parts before the centre.
    start = y - top + margin + 0.5 - 0.5 * array.shear * (views - 1) * part
    start, part, drift = start - 0.5 * views * array.part_down, array.part_down, array.shear * part
    integrate(across, views, count, start, part, views, drift, room.total, room.light, 0)


@njit
def make_room(array, views):
    """Make room to work in."""
    lines, pixels = int(2 * array.high) + 1, 2 * int(array.wide) + 2
    count = lines + 2 * array.margin
    return Room(
        np.zeros((lines, pixels), np.float32), np.zeros((views + 1, count + LANES), np.float32),
        np.zeros((views + 1, views + LANES), np.float32), np.zeros(lines, np.int64),
        np.zeros(lines, np.int64), np.zeros(views, np.int64), np.zeros(views, np.int64),
        np.zeros((max(count, pixels) + 1, LANES), np.float32),
    )  # fmt: skip


@parallel(lambda out: out.shape[2])
def resample(r, image, black, gain, lattices, arrays, join, out):
    """Find the light of all parts of the micro-images in a row of lenslets.

    image: (rows, columns, channels). black, gain: float32, of this shape or with one channel;
    empty without dark or white image; gain is 0 where a pixel is dark. lattices, join: named tuples
    of `decode_plan`, and arrays: two of them, in pixels and in pairs of pixels.
    out: (v, u, row, column, channel).
    """
    views, size, channels = out.shape[0], arrays[0].columns, out.shape[4]
    rooms = (make_room(arrays[0], views), make_room(arrays[1], views))
    # So many lenslets at a time, and the one before, stay in the processor's first cache.
    found = np.zeros((views, views, channels, BLOCK + 2), np.float32)
    row, done = arrays[0].first_row + r, 0
    parity = row % 2
    left, share = join.left[parity], join.share[parity]
    for begin in range(0, size, BLOCK):
        end = min(begin + BLOCK, size)
        found[..., 0] = found[..., BLOCK]
        for lattice in range(lattices.top.size):
            # Pixels of a colour that are two apart have an array of their own, in their pixels.
            step, channel = lattices.step[lattice], lattices.channel[lattice]
            array, room = arrays[step - 1], rooms[step - 1]
            down = array.row_pitch * row
            for c in range(begin, end):
                along = array.pitch * (array.first_column + c + array.offset * parity)
                y = lattices.y[lattice] + array.sin * along + array.cos * down
                x = lattices.x[lattice] + array.cos * along - array.sin * down
                read_micro_image(image, black, gain, lattices, lattice, y, x, array, room)
                for v in range(views):
                    for u in range(views):
                        found[v, u, channel, 1 + c - begin] = room.light[v, u]
        first = done
        while done < out.shape[3] and left[done] + (share[done] > 0) < end:
            done += 1
        for v in range(views):
            for u in range(views):
                for c in range(first, done):
                    near = left[c] + 1 - begin
                    for channel in range(channels):
                        low, high = found[v, u, channel, near], found[v, u, channel, near + 1]
                        out[v, u, r, c, channel] = low + share[c] * (high - low)
