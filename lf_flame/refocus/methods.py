"""Refocusing by the fastest method for an interpolation."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from lf_flame.errors import InputError
from lf_flame.refocus._arguments import Views
from lf_flame.refocus.shift import INTERPOLATIONS, check_interpolation, shift_and_sum

METHODS = ("auto", "space", "fourier", "slice")

FINEST_SLICE = 8
"""Width at which a slice equals exact phases up to the rounding of float32."""


def refocus(
    light_field: Views,
    slopes: ArrayLike,
    *,
    interpolation: str = "linear",
    method: str = "auto",
    weights: ArrayLike | None = None,
) -> np.ndarray:
    """Refocus a light field by any method; coordinates are clamped at the edges.

    The method affects the time, not the image: where two methods offer an interpolation, their
    results agree to 1e-6 of the brightest pixel.

    Parameters
    ----------
    light_field : LightField or array_like, shape (v, u, t, s) or (v, u, t, s, channels)
    slopes : float or sequence of float
        Slopes in lenslets per view step.
    interpolation : {"linear", "nearest", "cubic", "sinc"}, optional
        Interpolation between lenslets. "sinc" shifts band-limited views exactly.
    method : {"auto", "space", "fourier", "slice"}, optional
        `shift_and_sum`, `fourier_refocus`, `fourier_slice` (for "sinc" only), or chosen.
        "auto" is "fourier" for "sinc", and "space" otherwise, the fastest for some images. A slice
        is read from all over a spectrum far larger than the cache, and takes less time than phases
        for many tens of images only.
    weights : array_like, shape (v, u), optional
        Weight of each view, 0 or above; divided by their sum. The light field's own weights
        multiply them. Default: all equal.

    Returns
    -------
    ndarray of float32, shape (n, t, s) or (n, t, s, channels)
        One image for each slope; for a single number the image itself, without the first axis.

    Raises
    ------
    InputError
        If an argument cannot be used, or the method does not offer the interpolation.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame import refocus
    >>> views = np.random.default_rng(1).uniform(size=(5, 5, 24, 30))

    >>> refocus.refocus(views, 0.5, interpolation="sinc").shape
    (24, 30)
    """
    if method not in METHODS:
        raise InputError(f"method must be one of {', '.join(METHODS)}, got {method!r}.")
    check_interpolation(interpolation, (*INTERPOLATIONS, "sinc"))
    if method == "auto":
        method = "fourier" if interpolation == "sinc" else "space"
    if (method == "space") == (interpolation == "sinc") and method != "fourier":
        raise InputError(f"The method {method!r} does not know {interpolation!r} interpolation.")
    if method == "space":
        return shift_and_sum(light_field, slopes, interpolation=interpolation, weights=weights)
    # SciPy takes longer to import than Numba, and shifts in space do not need it.
    from lf_flame.refocus.fourier import fourier_refocus, fourier_slice

    if method == "fourier":
        return fourier_refocus(
            light_field, slopes, interpolation=interpolation, edges="clamp", weights=weights
        )
    return fourier_slice(light_field, slopes, width=FINEST_SLICE, edges="clamp", weights=weights)
