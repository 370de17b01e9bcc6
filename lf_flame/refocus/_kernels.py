"""Compiled loops of shift-and-sum: arrays in, output array filled, nothing returned.

As in `lf_flame.simulation`, all loops gather: one thread sums each output element in a fixed order,
so the bits do not depend on the number of threads. Chains of CHAIN fused multiply-adds run in the
type of the weights, all other sums in float64.

Indices are unsigned where a loop is vectorised, because Python's negative indices cost a branch.
"""

import numpy as np
from numba import config, njit
from numba.extending import intrinsic

from lf_flame._common.threads import parallel

CHAIN = 8
"""Number of views summed in one chain; lists of views are padded to a multiple with weight 0."""

LANES = 16
"""Number of which padded line lengths are a multiple, so that no loop over a line has a rest."""


@intrinsic
def _fused(_context, a, _b, _c):
    """Compute ``a * b + c`` with one rounding, for three numbers of one type."""
    return a(a, a, a), lambda context, builder, signature, values: builder.fma(*values)


fma = (lambda a, b, c: a * b + c) if config.DISABLE_JIT else _fused


@njit(forceinline=True)
def cut_line(line, start, reach, channels, lines, base, size):
    """Copy a line from start - reach on, with its edges repeated."""
    low, high = max(start - reach, 0), min(start - reach + size, line.size)
    left, right = base + low - (start - reach), base + high - (start - reach)
    source, target = np.uint64(low), np.uint64(left)
    for s in range(np.uint64(high - low)):
        lines[target + s] = line[source + s]
    for c in range(channels):
        fill(lines, base + c, left, channels, line[c])
        fill(lines, right + c, base + size, channels, line[line.size - channels + c])


@njit
def fill(line, start, stop, step, value):
    """Write a value to every step-th place."""
    if step == 1:  # a separate loop, so that it is vectorised
        for s in range(np.uint64(start), np.uint64(stop)):
            line[s] = value
    else:
        for s in range(start, stop, step):
            line[s] = value


@njit
def has_non_finite(lines):
    """Whether a number is NaN or infinite; without a branch, so that the loop is vectorised."""
    found = np.uint32(0)
    for s in range(np.uint64(lines.size)):
        found |= np.uint32(lines[s] - lines[s] != 0)
    return found != 0


@njit
def link(row):
    """CHAIN numbers as a tuple, which the compiler keeps in registers."""
    return row[0], row[1], row[2], row[3], row[4], row[5], row[6], row[7]


@njit
def sum_views(lines, first, weight, part):
    """Sum CHAIN views, each shifted and weighted: part[s]."""
    for s in range(np.uint64(part.size)):
        total = weight[0] * lines[first[0] + s]
        for k in range(1, CHAIN):
            total = fma(weight[k], lines[first[k] + s], total)
        part[s] = total


@njit
def sum_views_twice(lines, first, weight, other, this, that):
    """Sum views as `sum_views` does, for two lists of weights, loading every pixel once."""
    for s in range(np.uint64(this.size)):
        value = lines[first[0] + s]
        a, b = weight[0] * value, other[0] * value
        for k in range(1, CHAIN):
            value = lines[first[k] + s]
            a, b = fma(weight[k], value, a), fma(other[k], value, b)
        this[s] = a
        that[s] = b


@njit(forceinline=True)
def sum_row(lines, at, weights, v, n, channels, parts, total):
    """Sum a row of views: ``weights[j, v, n, i, k] * lines[at[v, n, i, k] + j * channels + s]``.

    The sum is over i, j, k. Tap j of all views is summed in a separate line, which is added to
    total[s] with its offset at the end.
    """
    near, far = parts
    for s in range(total.size):
        total[s] = 0.0
    for i in range(at.shape[2]):
        first = link(at[v, n, i])
        for j in range(0, len(weights) - 1, 2):
            one, other = link(weights[j, v, n, i]), link(weights[j + 1, v, n, i])
            sum_views_twice(lines, first, one, other, near, far)
            start, next_start = np.uint64(j * channels), np.uint64((j + 1) * channels)
            for s in range(np.uint64(total.size)):
                total[s] += np.float64(near[start + s]) + np.float64(far[next_start + s])
        if len(weights) == 1:
            sum_views(lines, first, link(weights[0, v, n, i]), near)
            for s in range(np.uint64(total.size)):
                total[s] += near[s]


@njit
def rows_read(top, bottom, offset, taps, height):
    """First and last row that taps from an offset on read for rows of an image, before bottom."""
    first = min(max(top + offset, 0), height - 1)
    return first, min(max(bottom + offset + taps - 2, 0), height - 1)


@njit(forceinline=True)
def add_row(total, row, offset, weight, sums, n, top, height):
    """Add a row to sums[n, t, s] for each t that shows it: top + t + offset, clamped, is row."""
    rows = sums.shape[1]
    low = 0 if row == 0 else max(row - offset - top, 0)
    high = rows if row == height - 1 else min(row - offset + 1 - top, rows)
    for t in range(low, high):
        for s in range(np.uint64(total.size)):
            sums[n, t, s] = fma(weight, total[s], sums[n, t, s])


@parallel(lambda bad: bad.size)
def sum_bands(k, views, reach, channels, used, at, weights, down, down_weights, bad, out):
    """Weighted sums of shifted views, for several slopes: out[n, t, s].

    The image is cut into bands of rows and blocks of columns. Each pixel is the sum over v, in
    order, of sums over u: no bit depends on where it is cut.

    views[v, u, t, s]: the channels of a lenslet are neighbours along s.
    reach: number of pixels that the taps read beyond a block of columns.
    used[v, u]: whether a view has a weight above 0.
    at[v, n, i, k], weights[j, v, n, i, k]: position of tap 0 of view (i, k) in the padded lines of
    all u, and the weight of tap j.
    down[v, n], down_weights[v, n, j]: row of tap 0 for t = 0, and the weights of the taps.
    bad[band, block]: whether a pixel that was read is not finite.
    """
    rows, columns, height, width = views.shape
    bands, blocks = bad.shape
    slopes, taps = len(out), down_weights.shape[2]
    breadth = -(-width // (blocks * channels)) * channels
    wide = -(-(breadth + (len(weights) - 1) * channels) // LANES) * LANES
    padded = wide + 2 * reach
    top, bottom = k // blocks * height // bands, (k // blocks + 1) * height // bands
    start = k % blocks * breadth
    size = min(breadth, width - start)
    sums = np.zeros((slopes, bottom - top, size))
    lines = np.zeros(columns * padded, weights.dtype)
    parts = np.empty(wide, weights.dtype), np.empty(wide, weights.dtype)
    total, non_finite = np.empty(size), False
    for v in range(rows):
        if not is_used(used, v):
            continue
        low, high = top, bottom - 1  # rows that the band reads; its own are checked in any case
        for n in range(slopes):
            first, last = rows_read(top, bottom, down[v, n], taps, height)
            low, high = min(low, first), max(high, last)
        for t in range(low, high + 1):
            for u in range(columns):
                if used[v, u]:
                    cut_line(views[v, u, t], start, reach, channels, lines, u * padded, padded)
            non_finite |= has_non_finite(lines)
            for n in range(slopes):
                first, last = rows_read(top, bottom, down[v, n], taps, height)
                if first <= t <= last:
                    sum_row(lines, at, weights, v, n, channels, parts, total)
                    for j in range(taps):
                        weight = down_weights[v, n, j]
                        add_row(total, t, down[v, n] + j, weight, sums, n, top, height)
    bad[k // blocks, k % blocks] = non_finite
    for n in range(slopes):
        for t in range(bottom - top):
            for s in range(np.uint64(size)):
                out[n, np.uint64(top + t), np.uint64(start) + s] = sums[n, t, s]


@njit
def is_used(used, v):
    """Whether a row of views has one with a weight above 0."""
    found = False
    for u in range(used.shape[1]):  # `np.any`, and assigning arrays, take seconds to compile
        found = found or used[v, u]
    return found


@parallel(lambda out: out.shape[0] * out.shape[1])
def slice_spectrum(k, spectrum, rows, row_weights, columns, column_weights, out):
    """Interpolate slices of an angular spectrum [t, s, v, u]: out[n, t, s].

    rows[n, t, i], columns[n, s, j]: samples around the slice along v and u, with their weights.
    """
    slopes, height, waves = out.shape
    n, t = k // height, k % height
    for s in range(waves):
        total = np.complex128(0)
        for i in range(rows.shape[2]):
            near, row = np.complex128(0), rows[n, t, i]
            for j in range(columns.shape[2]):
                near += column_weights[n, s, j] * spectrum[t, s, row, columns[n, s, j]]
            total += row_weights[n, t, i] * near
        out[n, t, s] = total


@parallel(lambda out: out.shape[2])
def sum_spectra(t, spectra, down, across, out):
    """Sum shifted views by their spectra[field, v, u, t, part, s]: out[field, n, t, part, s].

    The parts are real and imaginary. down[part, n, v, t], across[part, n, u, s]: phase factors of
    the shifts along v and along u.
    """
    fields, rows, columns = spectra.shape[:3]
    real, imaginary = np.empty(out.shape[4], np.float32), np.empty(out.shape[4], np.float32)
    out[:, :, t] = 0.0
    for field in range(fields):
        for v in range(rows):
            for n in range(out.shape[1]):
                real[:] = 0.0
                imaginary[:] = 0.0
                for u in range(columns):
                    re, im = spectra[field, v, u, t, 0], spectra[field, v, u, t, 1]
                    c, d = across[0, n, u], across[1, n, u]
                    for s in range(np.uint64(real.size)):
                        real[s] += re[s] * c[s] - im[s] * d[s]
                        imaginary[s] += re[s] * d[s] + im[s] * c[s]
                c, d = down[0, n, v, t], down[1, n, v, t]
                for s in range(np.uint64(real.size)):
                    out[field, n, t, 0, s] += real[s] * c - imaginary[s] * d
                    out[field, n, t, 1, s] += real[s] * d + imaginary[s] * c
