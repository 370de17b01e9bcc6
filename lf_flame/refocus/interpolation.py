"""Shifting an image by a fraction of a lenslet: neighbours and their weights."""

import numpy as np

from lf_flame.errors import InputError

INTERPOLATIONS = ("linear", "nearest", "cubic")
"""Interpolations: two neighbours by distance; the nearest; four by Keys's cubic convolution."""


def check_interpolation(interpolation: str, allowed=INTERPOLATIONS) -> None:
    """Refuse an unknown interpolation."""
    if interpolation not in allowed:
        raise InputError(
            f"interpolation must be one of {', '.join(allowed)}, got {interpolation!r}."
        )


def shift_taps(shifts: np.ndarray, interpolation: str) -> tuple[np.ndarray, np.ndarray]:
    """Find the neighbours that make up ``line[s + shift]``, and their weights.

    Parameters
    ----------
    shifts : ndarray of float64
        Shifts in lenslets, within the range of integers.
    interpolation : {"linear", "nearest", "cubic"}
        "nearest" rounds halves up. "cubic" is the convolution with a = -1/2 of R. Keys, "Cubic
        convolution interpolation for digital image processing", IEEE Trans. ASSP 29 (1981).

    Returns
    -------
    first : ndarray of int64, of the shape of `shifts`
        Offset of the first neighbour: tap j reads ``line[s + first + j]``.
    weights : ndarray of float64, shape (taps, *shape of shifts)
        Weights with sum 1. Shifts are rounded to 2^-24, so that "linear" weights have sum 1 in
        float32 as well.

    Raises
    ------
    InputError
        If the interpolation is unknown.
    """
    check_interpolation(interpolation)
    if interpolation == "nearest":
        return np.floor(shifts + 0.5).astype(np.int64), np.ones((1, *np.shape(shifts)))
    shifts = np.rint(shifts * 2.0**24) / 2.0**24
    whole = np.floor(shifts)
    f = shifts - whole
    if interpolation == "linear":
        return whole.astype(np.int64), np.stack([1 - f, f])
    weights = [
        f * (-0.5 + f * (1 - 0.5 * f)),
        1 + f * f * (-2.5 + 1.5 * f),
        f * (0.5 + f * (2 - 1.5 * f)),
        f * f * (-0.5 + 0.5 * f),
    ]
    return whole.astype(np.int64) - 1, np.stack(weights)
