"""Shift-and-sum refocusing in space."""

import numpy as np

from lf_flame import _kernels
from lf_flame.errors import InputError
from lf_flame.footprint import centred
from lf_flame.refocus._arguments import as_slopes, as_views

INTERPOLATIONS = ("linear", "nearest")


def shift_and_sum(views, slopes, interpolation: str = "linear") -> np.ndarray:
    """Refocus by shifting in space, coordinates clamped at the edges.

    Bilinear interpolation is separable over the views, so each row of views is shifted and
    summed along s first, and the row sums along t after that: N^2 + N shifts instead of 2 N^2.

    Parameters
    ----------
    views : LightField or array_like, shape (v, u, t, s) or (v, u, t, s, channels)
    slopes : float or sequence of float
        One refocused image for each.
    interpolation : {"linear", "nearest"}, optional
        Between neighbouring lenslets; "nearest" rounds each view's shift to whole lenslets,
        halves up.

    Returns
    -------
    ndarray of float32, shape (n, t, s) or (n, t, s, channels)
        Sums run in float64.

    Raises
    ------
    InputError
        If views, slopes or interpolation cannot be used.
    """
    views, slopes = as_views(views), as_slopes(slopes)
    if interpolation not in INTERPOLATIONS:
        raise InputError(
            f"interpolation must be one of {', '.join(INTERPOLATIONS)}, got {interpolation!r}."
        )
    if views.ndim == 5:
        channels = [
            shift_and_sum(views[..., c], slopes, interpolation) for c in range(views.shape[4])
        ]
        return np.stack(channels, axis=-1)
    views = np.ascontiguousarray(views)
    rows, columns, height, width = views.shape
    out = np.empty((len(slopes), height, width), np.float32)
    row_sums = np.empty((rows, height, width))
    for image, slope in zip(out, slopes, strict=True):
        _kernels.shift_columns(views, *_shifts(slope, columns, width, interpolation), row_sums)
        down = _shifts(slope, rows, height, interpolation)
        _kernels.shift_rows(row_sums, *down, 1 / (rows * columns), image)
    return out


def _shifts(slope: float, views: int, length: int, interpolation: str):
    """Whole and fractional part of every view's shift; beyond the image all shifts are alike."""
    shift = np.clip(slope * centred(views), -length, length)
    if interpolation == "nearest":
        shift = np.floor(shift + 0.5)
    whole = np.floor(shift)
    return whole.astype(np.int64), shift - whole
