"""Aligning selected views on a slope without averaging them, as input of refocusing networks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from lf_flame._common.arrays import centred
from lf_flame._common.threads import parallel
from lf_flame.errors import InputError
from lf_flame.refocus._arguments import (
    Views,
    as_block,
    as_slopes,
    as_views,
    for_slopes,
    refuse_not_finite,
)
from lf_flame.refocus.shift import shift_taps


def align_views(
    light_field: Views,
    slopes: ArrayLike,
    view_indices: Sequence[tuple[int, int]],
    *,
    block: tuple[int, int] = (1, 1),
) -> np.ndarray:
    """Shift some views so that objects at a slope are at the same place in all of them.

    View (v, u) becomes ``L[v, u, t + slope (v - vc), s + slope (u - uc)]``, interpolated linearly,
    coordinates clamped at the edges; the mean over all views is `shift_and_sum`.

    Parameters
    ----------
    light_field : LightField or array_like, shape (v, u, t, s) or (v, u, t, s, channels)
        Views; those without an index are not read.
    slopes : float or sequence of float
        Slopes in lenslets per view step, whatever the block.
    view_indices : sequence of (int, int)
        Row and column of each view, counted from 0.
    block : (int, int), optional
        Number of lenslets averaged into one pixel, along (t, s), after shifting.

    Returns
    -------
    ndarray of float32, shape (n, views, t / block, s / block), or with a last axis of channels
        Aligned views; without the first axis for a single slope.

    Raises
    ------
    InputError
        If an argument cannot be used, or a pixel that was read is NaN or infinite.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame import refocus
    >>> views = np.random.default_rng(1).uniform(size=(5, 5, 24, 30))

    >>> aligned = refocus.align_views(views, 0.5, [(0, 0), (2, 2), (4, 4)])
    >>> aligned.shape
    (3, 24, 30)
    >>> np.allclose(aligned[1], views[2, 2])  # the central view stays where it is
    True
    """
    views, steps = as_views(light_field), as_slopes(slopes)
    indices = as_view_indices(view_indices, views.shape[:2])
    block = as_block(block, views.shape[2:4])
    images, at = _as_images(views, indices)
    channels = views.shape[4] if views.ndim == 5 else 1
    shifts = [np.outer(centred(views.shape[axis])[indices[:, axis]], steps) for axis in (0, 1)]
    rows, row_weights = _taps(shifts[0], views.shape[2], block[0])
    columns, column_weights = _taps(shifts[1], views.shape[3], block[1])
    size = rows.shape[2], columns.shape[2]
    out = np.empty((len(steps), len(indices), size[0], size[1] * channels), np.float32)
    _align_in_blocks(
        images, at, rows, row_weights, columns * channels, column_weights, channels, out
    )
    if not np.isfinite(out).all():
        refuse_not_finite(images[at])
    return for_slopes(out.reshape(*out.shape[:2], *size, *views.shape[4:]), slopes)


def as_view_indices(view_indices: Sequence[tuple[int, int]], shape: tuple[int, ...]) -> np.ndarray:
    """Check rows and columns of views against the light field's number of views, [k, 2]."""
    indices = np.asarray(view_indices)
    if indices.ndim != 2 or indices.shape[1:] != (2,) or indices.dtype.kind not in "iu":
        raise InputError(f"Views are indexed by pairs of row and column, got {view_indices!r}.")
    for v, u in indices.tolist():
        if not (0 <= v < shape[0] and 0 <= u < shape[1]):
            raise InputError(
                f"There is no view ({v}, {u}) in a light field of {shape[0]} x {shape[1]} views, "
                f"counted from 0."
            )
    return indices


def _as_images(views: np.ndarray, indices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Give views as images[m, t, x] of float32, and the numbers m of those at the indices.

    If the views have this form already, nothing is copied; else only the views at the indices.
    """
    shape = views.shape[:2]
    at = np.ravel_multi_index(tuple(indices.T), shape)
    if views.dtype != np.float32 or not views.flags.c_contiguous:
        views = np.ascontiguousarray(views[tuple(indices.T)], np.float32)
        return views.reshape(*views.shape[:2], -1), np.arange(len(at))
    return views.reshape(shape[0] * shape[1], views.shape[2], -1), at


def _taps(shifts: np.ndarray, length: int, block: int) -> tuple[np.ndarray, np.ndarray]:
    """Find the lenslets that each output pixel along an axis is read from, and their weights.

    Parameters
    ----------
    shifts : ndarray, shape (k, n)
        Shifts in lenslets.
    length, block : int
        Number of lenslets along the axis, and in a pixel.

    Returns
    -------
    ndarray of int, shape (k, n, length / block, block + 1)
    ndarray of float32, shape (k, n, block + 1)
        Weights with sum 1.
    """
    first, (near, far) = shift_taps(np.clip(shifts, -length, length), "linear")
    weights = np.ones((*shifts.shape, block + 1))
    weights[..., 0], weights[..., -1] = near, far
    starts = np.arange(0, length, block)[:, None] + np.arange(block + 1)
    index = np.clip(first[..., None, None] + starts, 0, length - 1)
    return index, (weights / block).astype(np.float32)


@njit
def _combine_rows(view, rows, weights, line):
    """Sum weighted rows of a view[t, x]: line[x]."""
    line[:] = 0.0
    for j in range(rows.size):
        weight, row = weights[j], view[rows[j]]
        if weight != 0.0:
            for x in range(np.uint64(line.size)):
                line[x] += weight * row[x]


@parallel(lambda out: out.shape[0] * out.shape[1] * out.shape[2])
def _align_in_blocks(m, images, at, rows, row_weights, columns, column_weights, channels, out):
    """Shift images[at[k], t, x], average them over blocks: out[n, k, i, j * channels + c].

    images: the channels of a lenslet are adjacent along x.
    rows[k, n, i, a], row_weights[k, n, a]: rows that make up row i of the output.
    columns[k, n, j, b], column_weights[k, n, b]: the same along x, for channel 0.
    """
    slopes, count, height = out.shape[:3]
    n, k, i = m // (count * height), m // height % count, m % height
    line = np.empty(images.shape[2], np.float32)
    _combine_rows(images[at[k]], rows[k, n, i], row_weights[k, n], line)
    for j in range(columns.shape[2]):
        for c in range(channels):
            total = np.float32(0.0)
            for b in range(columns.shape[3]):
                total += column_weights[k, n, b] * line[np.uint64(columns[k, n, j, b] + c)]
            out[n, k, i, j * channels + c] = total
