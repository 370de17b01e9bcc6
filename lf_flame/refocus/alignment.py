"""Aligning some views on a slope, each kept by itself: what networks that refocus look at."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from lf_flame._common.arrays import centred
from lf_flame.errors import InputError
from lf_flame.refocus import _alignment_kernels
from lf_flame.refocus._arguments import Views, as_block, as_slopes, as_views, refuse_not_finite
from lf_flame.refocus.interpolation import shift_taps


def align_views(
    views: Views,
    slopes: ArrayLike,
    view_indices: Sequence[tuple[int, int]],
    block: tuple[int, int] = (1, 1),
) -> np.ndarray:
    """Shift some views so that what stands at a slope is at the same place in all of them.

    View (v, u) becomes ``L[v, u, t + slope (v - vc), s + slope (u - uc)]``, interpolated linearly,
    coordinates clamped at the edges; the mean over all views is `shift_and_sum`.

    Parameters
    ----------
    views : LightField or array_like, shape (v, u, t, s) or (v, u, t, s, channels)
        Views whose indices are not given are not read.
    slopes : float or sequence of float
        In lenslets per view step, whatever the blocks.
    view_indices : sequence of (int, int)
        Row and column of each view.
    block : (int, int), optional
        Lenslets that are averaged into one pixel, along (t, s), after shifting.

    Returns
    -------
    ndarray of float32, shape (n, views, t / block, s / block) or with a last axis of channels

    Raises
    ------
    InputError
        If an argument cannot be used, or a pixel that was read is NaN or infinite.
    """
    views, slopes = as_views(views), as_slopes(slopes)
    indices = as_view_indices(view_indices, views.shape[:2])
    block = as_block(block, views.shape[2:4])
    images, at = _as_images(views, indices)
    channels = views.shape[4] if views.ndim == 5 else 1
    shifts = [np.outer(centred(views.shape[axis])[indices[:, axis]], slopes) for axis in (0, 1)]
    rows, row_weights = _taps(shifts[0], views.shape[2], block[0])
    columns, column_weights = _taps(shifts[1], views.shape[3], block[1])
    size = rows.shape[2], columns.shape[2]
    out = np.empty((len(slopes), len(indices), size[0], size[1] * channels), np.float32)
    _alignment_kernels.align_views(
        images, at, rows, row_weights, columns * channels, column_weights, channels, out
    )
    if not np.isfinite(out).all():
        refuse_not_finite(images[at])
    return out.reshape(*out.shape[:2], *size, *views.shape[4:])


def as_view_indices(view_indices: Sequence[tuple[int, int]], shape: tuple[int, ...]) -> np.ndarray:
    """Rows and columns of views of a light field that has so many, [k, 2]."""
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
    """Lay views out as images[m, t, x] of float32, and say which of them are those at the indices.

    Where they are laid out so already, nothing is copied; else only what is asked for.
    """
    shape = views.shape[:2]
    at = np.ravel_multi_index(tuple(indices.T), shape)
    if views.dtype != np.float32 or not views.flags.c_contiguous:
        views = np.ascontiguousarray(views[tuple(indices.T)], np.float32)
        return views.reshape(*views.shape[:2], -1), np.arange(len(at))
    return views.reshape(shape[0] * shape[1], views.shape[2], -1), at


def _taps(shifts: np.ndarray, length: int, block: int) -> tuple[np.ndarray, np.ndarray]:
    """Find what is read for each pixel of the output along an axis, and its weight.

    Parameters
    ----------
    shifts : ndarray, shape (k, n)
        In lenslets.
    length, block : int
        Lenslets along the axis, and in a pixel.

    Returns
    -------
    ndarray of int, shape (k, n, length / block, block + 1)
    ndarray of float32, shape (k, n, block + 1)
        Sums to 1.
    """
    first, (near, far) = shift_taps(np.clip(shifts, -length, length), "linear")
    weights = np.ones((*shifts.shape, block + 1))
    weights[..., 0], weights[..., -1] = near, far
    starts = np.arange(0, length, block)[:, None] + np.arange(block + 1)
    index = np.clip(first[..., None, None] + starts, 0, length - 1)
    return index, (weights / block).astype(np.float32)
