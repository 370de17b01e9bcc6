"""Shift-and-sum refocusing in space."""

import numpy as np

from lf_flame._common.arrays import centred
from lf_flame.refocus import _kernels
from lf_flame.refocus._arguments import (
    as_readable,
    as_slopes,
    as_views,
    as_weights,
    refuse_not_finite,
)
from lf_flame.refocus.interpolation import shift_taps

SLOPES_AT_ONCE = 8
"""Slopes that share one reading of the light field."""

BLOCK = 2048
"""Pixels of a line, about, that are worked on together; shorter pieces are read more slowly."""


def shift_and_sum(views, slopes, interpolation: str = "linear", weights=None) -> np.ndarray:
    """Refocus by shifting in space, coordinates clamped at the edges.

    Interpolation is separable over the views, so each row of views is shifted and summed along s
    first, and the row sums along t after that: N^2 + N shifts instead of 2 N^2. Slopes share one
    reading of the light field.

    Parameters
    ----------
    views : LightField or array_like, shape (v, u, t, s) or (v, u, t, s, channels)
        Of 8 or 16 bits, float32 or float64, and contiguous, it is read without a copy.
    slopes : float or sequence of float
        One refocused image for each.
    interpolation : {"linear", "nearest", "cubic"}, optional
        Between neighbouring lenslets. "nearest" rounds each view's shift to whole lenslets,
        halves up; "cubic" is Keys's convolution, which can overshoot at edges.
    weights : array_like, shape (v, u), optional
        Share of each view, 0 or above (`lf_flame.refocus.aperture`); divided by their sum.
        Default: all alike. Views of weight 0 are not read.

    Returns
    -------
    ndarray of float32, shape (n, t, s) or (n, t, s, channels)
        In the unit of the views. Eight taps at a time are summed in float32, the rest in
        float64: the error stays within some units of the last place for any number of views.
        (Views of float64 are summed in float64 throughout.)

    Raises
    ------
    InputError
        If views, slopes, interpolation or weights cannot be used.
    """
    views, slopes = as_readable(as_views(views)), as_slopes(slopes)
    weights = as_weights(weights, views.shape[:2])
    channels = views.shape[4] if views.ndim == 5 else 1
    lines = views.reshape(*views.shape[:3], -1)  # the channels of a lenslet side by side
    stack = np.empty((len(slopes), *lines.shape[2:]), np.float32)
    for first in range(0, len(slopes), SLOPES_AT_ONCE):
        some = slice(first, first + SLOPES_AT_ONCE)
        _shift_and_sum(lines, channels, slopes[some], interpolation, weights, stack[some])
    return stack.reshape(len(slopes), *views.shape[2:])


def _shift_and_sum(views, channels, slopes, interpolation, weights, out) -> None:
    rows, columns, height, width = views.shape
    down, down_shares = shift_taps(_shifts(slopes, rows, height), interpolation)
    right, right_shares = shift_taps(_shifts(slopes, columns, width // channels), interpolation)
    if not right_shares[1:].any():  # whole slopes
        right_shares = right_shares[:1]
    taps = len(right_shares)
    blocks = -(-width // BLOCK)
    breadth = -(-width // (blocks * channels)) * channels
    reach = max(-int(right.min()), int(right.max()) + taps - 1, 0) * channels
    padded = _padded(breadth + (taps - 1) * channels, _kernels.LANES) + 2 * reach
    # A power of two, so that equal weights stay exact and no sum leaves the range of float32.
    scale = 2.0 ** np.ceil(np.log2(np.maximum(weights.sum(axis=1), np.finfo(float).tiny)))
    precision = np.float64 if views.dtype == np.float64 else np.float32
    at = np.arange(columns)[:, None] * padded + right * channels + reach
    shares = right_shares[:, None] * (weights / scale[:, None])[:, :, None]
    chains = _chain(weights > 0, at, shares.astype(precision))
    down_shares = np.moveaxis(down_shares * (scale / weights.sum())[:, None], 0, 2).copy()
    groups = min(rows, max(4 // blocks, 1))
    sums = np.empty((groups, len(slopes), height, width))
    bad = np.zeros(groups * blocks, bool)
    _kernels.shift_and_sum(
        views, reach, channels, weights > 0, *chains, down, down_shares, sums, bad
    )
    if bad.any():
        refuse_not_finite(views)
    _kernels.merge(sums, out)


def _shifts(slopes: np.ndarray, views: int, length: int) -> np.ndarray:
    """Shift of every view at every slope, [view, n]; beyond the image all shifts are alike."""
    return np.clip(slopes * centred(views)[:, None], -length, length)


def _padded(length: int, multiple: int) -> int:
    return -(-length // multiple) * multiple


def _chain(used: np.ndarray, at: np.ndarray, shares: np.ndarray):
    """Lay the views that count out in chains.

    Parameters
    ----------
    used : ndarray of bool, shape (v, u)
    at : ndarray of int, shape (u, n)
    shares : ndarray of float, shape (tap, v, u, n)

    Returns
    -------
    at : ndarray of uint64, shape (v, n, chain, link)
    shares : tuple of ndarray of float, one for each tap, shape (v, n, chain, link)
    """
    rows, columns = used.shape
    taps, slopes = len(shares), at.shape[1]
    length = _padded(int(used.sum(axis=1).max()), _kernels.CHAIN)
    links = np.argsort(~used, axis=1, kind="stable")[:, :length]  # those that count come first
    chained_at = np.zeros((rows, slopes, length), np.uint64)
    chained_at[..., : links.shape[1]] = np.swapaxes(at[links], 1, 2)
    chained = np.zeros((taps, rows, slopes, length), shares.dtype)
    chosen = np.take_along_axis(shares, links[None, :, :, None], axis=2)
    chained[..., : links.shape[1]] = np.swapaxes(chosen, 2, 3)
    shape = (rows, slopes, -1, _kernels.CHAIN)
    return chained_at.reshape(shape), tuple(chained.reshape(taps, *shape))
