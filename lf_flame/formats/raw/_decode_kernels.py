"""The compiled loop of decoding: pixels under a lenslet to equal parts of its micro-image.

Only pixels that belong to the lenslet are read; beyond the last one along a line, light is
extrapolated linearly. Light is summed along a line; between the pixels' edges the sum is the cubic
through the four nearest edges, and differences of it are the light of parts (Colella and Woodward
1984, section 1). Pixels are reproduced where parts coincide with them, and a view's light comes
from its part's centre, also at the rim. The loop gathers: one thread writes each element.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from lf_flame._common.threads import parallel, without_refcounts

LANES = 16
"""Number of lines that are integrated side by side, in the lanes of vector instructions."""


class Lattices(NamedTuple):
    """Pixels of each channel, `step` apart, the first one in row `top` and column `left`.

    Red and blue of a mosaic are two apart. Green has all pixels, of which those are green whose sum
    of row and column is even (`green` 0) or odd (1); `green` is -1 for all other lattices.
    """

    step: np.ndarray
    top: np.ndarray
    left: np.ndarray
    green: np.ndarray


class Lenslets(NamedTuple):
    """Positions of lenslets, and their own pixels, in pixels of a lattice that begins at 0, 0.

    The lenslet in row and column 0 is at (y, x); odd rows of round micro-images are offset by half
    a pitch. Parts of a micro-image are `part_down` high down a column of pixels, and `part_along`
    wide along a row of pixels. Own pixels are up to `half_down` and `half_along` from the centre,
    across and along the array's rows; in round micro-images up to `half_along` in any direction.
    They reach up to `high` above and below the centre, and parts up to `wide` beside it and
    `margin` lines beyond the own pixels. There light is extrapolated linearly over `reach` lines:
    corners of round micro-images, which no used view shows, are farther. A line with less than
    `fewest` own pixels is not read.
    """

    y: float
    x: float
    pitch: float
    row_pitch: float
    cos: float
    sin: float
    is_round: bool
    part_down: float
    part_along: float
    half_down: float
    half_along: float
    high: float
    wide: float
    margin: int
    reach: int
    fewest: int


class Workspace(NamedTuple):
    """Working arrays for one micro-image.

    Own pixels of each line, and those extrapolated beyond them, (lines, pixels); light of the parts
    along each line, (u, lines); sums of light. The own pixels of each line are those from `low` to
    `high`, and the own lines of each part across those from `first` to `end`, where `high` and
    `end` are last + 1, or 0 if there are none (`low` is then beyond the line).
    """

    own: np.ndarray
    across: np.ndarray
    total: np.ndarray
    low: np.ndarray
    high: np.ndarray
    first: np.ndarray
    end: np.ndarray


@without_refcounts
def is_read(y, x, lenslets, gain, i, j, n):
    """Whether a pixel, (y, x) from a lenslet's centre, is lit and entirely in its micro-image."""
    if gain.size > 0 and gain[i, j, n] == 0.0:
        return False
    if lenslets.is_round:
        return y * y + x * x <= lenslets.half_along * lenslets.half_along
    down, along = lenslets.cos * y - lenslets.sin * x, lenslets.sin * y + lenslets.cos * x
    return abs(down) <= lenslets.half_down and abs(along) <= lenslets.half_along


@without_refcounts
def continue_linearly(values, line, n, first, end, reach):
    """Fill a line before `first`, and from `end` to n, linearly for `reach` steps, then flat."""
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
    """Sum of light up to the position a: the cubic through the sums up to 0, 1, 2 and 3."""
    half, sixth = np.float32(0.5), np.float32(1 / 6)
    b, c, d = a - np.float32(1.0), a - np.float32(2.0), a - np.float32(3.0)
    return half * a * d * (c * left - b * right) + sixth * b * c * (a * far - d * near)


@without_refcounts
def integrate(values, lines, n, start, part, parts, drift, total, light, shift):
    """Find the mean light of parts along lines, light[number of the part, shift + line].

    values: lines of n pixels. start: where the first part begins, moved by `drift` line by line.
    part: width of each. total: (n + 1, LANES), overwritten. light has a spare row and LANES spare
    columns.
    """
    scale, move = np.float32(1.0 / part), np.float32(drift)
    # Lines that are read at the same pixels; of one line the other lanes are overwritten later.
    batch = LANES if abs(drift) * LANES <= 0.5 else 1
    # Unsigned, because Numba would check each signed index for being negative.
    lanes, one, two, three = np.uintp(LANES), np.uintp(1), np.uintp(2), np.uintp(3)
    for first in range(0, lines, batch):
        begin = np.uintp(first + shift)
        for i in range(np.uintp(min(batch, lines - first))):
            line, up_to = np.uintp(first) + i, np.float32(0.0)
            for k in range(np.uintp(n)):
                up_to += values[line, k]
                total[k + one, i] = up_to
        for j in range(np.uintp(parts + 1)):
            place = start + part * j + drift * first
            near = min(max(int(place + drift * (batch // 2)) - 1, 0), n - 3)
            away, k = np.float32(place - near), np.uintp(near)
            for i in range(lanes):
                light[j, begin + i] = scale * cubic(
                    total[k, i], total[k + one, i], total[k + two, i], total[k + three, i],
                    away + move * np.float32(i),
                )  # fmt: skip
        for j in range(np.uintp(parts)):
            for i in range(lanes):
                light[j, begin + i] = light[j + one, begin + i] - light[j, begin + i]


@without_refcounts
def fill_green(own, low, high, odd):
    """Give pixels of other colours the mean of opposite green neighbours in the micro-image.

    Both neighbours of a pair, so that linear light stays as it is. odd: whether the sum of row and
    column of a green pixel is odd, counted from the first line and position 0 of `own`. A pixel
    without a pair at an end of its line is taken off.
    """
    for here in range(low.size):
        first, end = low[here], high[here]
        left = right = 0  # between them, the lines above and below have own pixels
        if 0 < here < low.size - 1:
            left = max(low[here - 1], low[here + 1])
            right = min(high[here - 1], high[here + 1])
        for k in range(first + (here + first + 1 - odd) % 2, end, 2):
            total, count = np.float32(0.0), np.float32(0.0)
            if first < k < end - 1:
                total, count = own[here, k - 1] + own[here, k + 1], np.float32(2.0)
            if left <= k < right:
                total, count = total + own[here - 1, k] + own[here + 1, k], count + np.float32(2.0)
            if count > 0:
                own[here, k] = total / count
            elif k == first:
                low[here] += 1
            else:
                high[here] -= 1


@without_refcounts
def read_lines(image, gain, lattices, n, y, x, top, left, lenslets, work):
    """Read a micro-image's own, lit pixels line by line, and extrapolate each line.

    Fills work.own and its ranges. n: number of the lattice. y, x: centre in its pixels. top, left:
    pixel of the lattice at work.own[0, 0].
    """
    own, low, high = work.own, work.low, work.high
    step, upper, j = lattices.step[n], lattices.top[n], lattices.left[n]
    # Channel of each, which may be grey or a mosaic.
    channel, factor = np.uintp(min(n, image.shape[2] - 1)), np.uintp(min(n, gain.shape[2] - 1))
    rows, columns = image.shape[0], image.shape[1] // step
    for here in range(low.size):
        row = top + here
        low[here], high[here] = own.shape[1], 0
        if row < 0 or (row + 1) * step > rows:
            continue
        i, begin, stop = upper + step * row, max(left, 0), min(left + own.shape[1], columns)
        while begin < stop and not is_read(
            row - y, begin - x, lenslets, gain, i, j + step * begin, factor
        ):
            begin += 1
        while begin < stop and not is_read(
            row - y, stop - 1 - x, lenslets, gain, i, j + step * (stop - 1), factor
        ):
            stop -= 1
        if stop - begin < lenslets.fewest:
            continue
        low[here], high[here] = begin - left, stop - left
        line, row, count = np.uintp(here), np.uintp(i), np.uintp(stop - begin)
        first, into, stride = np.uintp(j + step * begin), np.uintp(begin - left), np.uintp(step)
        for k in range(count):
            own[line, into + k] = image[row, first + stride * k, channel]
        if gain.size > 0:
            for k in range(count):
                own[line, into + k] *= gain[row, first + stride * k, factor]
    if lattices.green[n] >= 0:
        fill_green(own, low, high, (lattices.green[n] + top + left) % 2)
    for here in range(low.size):
        if high[here] - low[here] < lenslets.fewest:
            low[here], high[here], own[here] = own.shape[1], 0, 0.0
        else:
            continue_linearly(own, here, own.shape[1], low[here], high[here], own.shape[1])


@without_refcounts
def find_own_lines(start, drift, part, work):
    """Find the lines that show each part across: those in whose own pixels its centre is.

    Or half a pixel beyond. start: position of the first part's centre in line 0; it moves by
    `drift`.
    """
    first, end, low, high, views = work.first, work.end, work.low, work.high, work.first.size
    for u in range(views):
        first[u], end[u] = low.size, 0
        for line in range(low.size):
            if low[line] - 0.5 <= start + part * u + drift * line <= high[line] + 0.5:
                first[u], end[u] = min(first[u], line), line + 1
    middle = views // 2
    for u in range(middle + 1, views):  # beyond the lit pixels: as the inner neighbour
        if end[u] == 0:
            first[u], end[u] = first[u - 1], end[u - 1]
    for u in range(middle - 1, -1, -1):
        if end[u] == 0:
            first[u], end[u] = first[u + 1], end[u + 1]


@without_refcounts
def read_micro_image(image, gain, lattices, n, y, x, lenslets, work, light):
    """Find the light of the parts of one micro-image, light[v, u], in one lattice."""
    own, across, margin, views = work.own, work.across, lenslets.margin, work.first.size
    lines, pixels = own.shape
    first, end = work.first, work.end
    top, left = int(np.ceil(y - lenslets.high)), int(np.ceil(x - lenslets.wide))
    read_lines(image, gain, lattices, n, y, x, top, left, lenslets, work)
    tan, part = lenslets.sin / lenslets.cos, lenslets.part_along
    start = x - left + 0.5 - tan * (top - y) - 0.5 * views * part
    integrate(own, lines, pixels, start, part, views, -tan, work.total, across, margin)
    find_own_lines(start + 0.5 * part, -tan, part, work)
    count = lines + 2 * margin
    for u in range(views):
        if end[u] > 0:
            continue_linearly(across, u, count, margin + first[u], margin + end[u], lenslets.reach)
        else:
            across[u] = 0.0
    # Parts move down a column by the shear from each to the next; the first one across is
    # (views - 1) / 2 parts before the centre.
    drift, part = lenslets.sin * lenslets.cos * part, lenslets.part_down
    start = y - top + margin + 0.5 - 0.5 * drift * (views - 1) - 0.5 * views * part
    integrate(across, views, count, start, part, views, drift, work.total, light, 0)


@njit
def make_workspace(lenslets, views):
    """Allocate a workspace."""
    lines, pixels = int(2 * lenslets.high) + 1, 2 * int(lenslets.wide) + 2
    count = lines + 2 * lenslets.margin
    return Workspace(
        np.zeros((lines, pixels), np.float32), np.zeros((views + 1, count + LANES), np.float32),
        np.zeros((max(count, pixels) + 1, LANES), np.float32),
        np.zeros(lines, np.int64), np.zeros(lines, np.int64),
        np.zeros(views, np.int64), np.zeros(views, np.int64),
    )  # fmt: skip


@parallel(lambda out: out.shape[2])
def resample(r, image, gain, lattices, lenslets, rows, columns, left, share, out):
    """Find the light of all parts of the micro-images in a row of lenslets.

    image: (rows, columns, channels). gain: factors of its pixels, 0 where they are dark in the
    white image, with as many channels or one; empty without a white image. lattices: one for each
    channel of `out`. lenslets: in pixels, and in pairs of pixels. rows, columns: those of the
    array. left, share: first column and share of the second in each of `out`, by the row's parity.
    out: (v, u, row, column, channel).
    """
    views, channels, parity = out.shape[0], out.shape[4], rows[r] % 2
    spaces = (make_workspace(lenslets[0], views), make_workspace(lenslets[1], views))
    # With a row and some columns to spare, which `integrate` needs, and a lenslet.
    found = np.zeros((columns.size + 1, channels, views + 1, views + LANES), np.float32)
    for n in range(channels):
        step = lattices.step[n]
        own, work = lenslets[step - 1], spaces[step - 1]
        down, offset = own.row_pitch * rows[r], 0.5 * parity if own.is_round else 0.0
        for c in range(columns.size):
            along = own.pitch * (columns[c] + offset)
            y = own.y - lattices.top[n] / step + own.sin * along + own.cos * down
            x = own.x - lattices.left[n] / step + own.cos * along - own.sin * down
            read_micro_image(image, gain, lattices, n, y, x, own, work, found[c, n])
    for v in range(np.uintp(views)):  # unsigned, as above
        for u in range(np.uintp(views)):
            for c in range(np.uintp(out.shape[3])):
                near = np.uintp(left[parity, c])
                for n in range(np.uintp(channels)):
                    low, high = found[near, n, v, u], found[near + np.uintp(1), n, v, u]
                    out[v, u, np.uintp(r), c, n] = low + share[parity, c] * (high - low)
