"""Slope conventions of other programs, and conversion from them.

A slope is the displacement of an image from one view to the next: a point that moves by d lenslets
per view, rows counted downward and columns rightward as the views are stored, is in focus at
``slope = d``. Programs differ in sign, and some scale their number with the number of views. (For
Ng's alpha a camera is needed: `PlenopticCamera.slope_to_alpha`.)

The views must be stored in the same order. A program or decoder that rotates the micro-images,
and with them the views, by 180 degrees changes the sign of every number here.
"""

from collections.abc import Callable

import numpy as np

from lf_flame._common.arrays import Number, number_or_array
from lf_flame.errors import InputError

CONVENTIONS: dict[str, float | Callable[[int], float]] = {
    # Motion of an image in lenslets per view; the slope of this package.
    "motion": 1.0,
    # Disparity in pixels per view, positive for objects nearer than the focus distance: 4D Light
    # Field Benchmark, Honauer et al., ACCV 2016, depth2disp of its toolkit; EPINET's output, too.
    "hci": -1.0,
    # LFToolbox 0.5, LFFiltShiftSum: views are read at linspace(-0.5, 0.5, N) Slope N.
    "lftoolbox": lambda n: n / (n - 1),
    # LiFF, FocalStack.c: views are read at + slope per view.
    "liff": 1.0,
    # PlenoptiCam 0.9, refo_from_vp: views are moved by + a, a whole number.
    "plenopticam": -1.0,
    # PlenoptiCam 0.9 with refinement: views are enlarged N times and moved by + a of the finer
    # pixels (T of them become N T by (T - 1) / (N T - 1) and not 1 / N, which is left aside).
    "plenopticam-refined": lambda n: -1 / n,
    # plenpy 0.9, get_refocus: views are moved by + slope N / (N - 1).
    "plenpy": lambda n: -n / (n - 1),
    # Fourier Disparity Layers, refocusFFT.m: views are moved by + d U, U to the right and V upward;
    # Le Pendu, Guillemot, Smolic, IEEE Trans. Image Process. 28, 5740, 2019.
    "fdl": -1.0,
}
"""Slope for a number of 1 in the convention of a known program, by name; a function of the number N
of views along an axis if it depends on that."""


def to_slope(number: Number, convention: str, views: int | None = None) -> Number:
    """Convert a refocusing number of another program to a slope.

    Parameters
    ----------
    number : float or ndarray
        Number in that convention.
    convention : str
        A name in `CONVENTIONS`.
    views : int, optional
        Number of views along an axis, for conventions that depend on it. For unequal numbers of
        rows and columns of views such a program's number is not a slope.

    Returns
    -------
    float or ndarray
        Slope in lenslets per view step.

    Raises
    ------
    InputError
        If the convention is unknown, or needs the number of views, 2 or more.

    Examples
    --------
    >>> from lf_flame.optics import to_slope
    >>> to_slope(-0.4, "plenpy", views=5)  # -number N / (N - 1)
    0.5
    """
    if convention not in CONVENTIONS:
        raise InputError(f"convention must be one of {', '.join(CONVENTIONS)}, got {convention!r}.")
    slope = CONVENTIONS[convention]
    if callable(slope):
        if views is None or views != int(views) or views < 2:
            raise InputError(
                f"This number depends on the number of views along an axis, which must be 2 or "
                f"more, got views={views}."
            )
        slope = slope(views)
    return number_or_array(np.asarray(number, float) * slope)
