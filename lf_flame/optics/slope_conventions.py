"""Slope conventions of other programs, and conversion from and to them.

A slope is the displacement of an image from one view to the next: a point that moves by d lenslets
per view, rows counted downward and columns rightward as the views are stored, is in focus at
``slope = d``. Programs differ in sign, and some scale their number with the number of views.
`CONVENTIONS` holds those proportional to the slope. A refocusing distance needs a camera:
`ng_alpha` and `plenoptomos_distance` make conventions for it.

The views must be stored in the same order. A program or decoder that turns the micro-images, and
with them the views, by 180 degrees changes the sign of every number here.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from lf_flame._common.arrays import Number, number_or_array
from lf_flame.errors import InputError
from lf_flame.optics.camera import PlenopticCamera


@dataclass(frozen=True)
class Convention:
    """A number proportional to the slope.

    Attributes
    ----------
    sign : int
        Sign of the number for a positive slope, 1 or -1.
    formula : str
        Formula of the number in terms of the slope and of N, the number of views along an axis.
    source : str
        Place in the program, or publication, that defines the number.
    stretch : callable, optional
        Function of N that gives the absolute slope for a number of 1. Default: 1 for all N.
    """

    sign: int
    formula: str
    source: str
    stretch: Callable[[int], float] | None = None

    def to_slope(self, number: Number, views: int | None = None) -> Number:
        """Slope in lenslets per view step for the program's number; scalar or array."""
        return number_or_array(np.asarray(number, float) * self._factor(views))

    def from_slope(self, slope: Number, views: int | None = None) -> Number:
        """Program's number for a slope in lenslets per view step; scalar or array."""
        return number_or_array(np.asarray(slope, float) / self._factor(views))

    def _factor(self, views: int | None) -> float:
        if self.stretch is None:
            return self.sign
        if views is None or views != int(views) or views < 2:
            raise InputError(
                f"This number depends on the N views along an axis ({self.formula}), of which "
                f"there must be 2 or more, got views={views}."
            )
        return self.sign * self.stretch(views)


@dataclass(frozen=True)
class AlphaConvention:
    """A distance from the lens, relative to the focused one: ``slope = scale (1 - z0/z)``.

    Attributes
    ----------
    scale : float
        Slope at an infinite distance.
    z0 : float
        Distance in focus as recorded, in any unit; 1 if the number is a ratio.
    """

    scale: float
    z0: float = 1.0

    def __post_init__(self):
        for name in ("scale", "z0"):
            value = getattr(self, name)
            if not np.isfinite(value) or value == 0:
                raise InputError(f"{name} must be finite and not 0, got {value}.")

    def to_slope(self, number: Number, views: int | None = None) -> Number:
        """Slope for a distance, which may be infinite; the number of views does not matter."""
        with np.errstate(divide="ignore"):
            return number_or_array(self.scale * (1 - self.z0 / np.asarray(number, float)))

    def from_slope(self, slope: Number, views: int | None = None) -> Number:
        """Distance for a slope, infinite at ``slope = scale``."""
        with np.errstate(divide="ignore"):
            return number_or_array(self.z0 / (1 - np.asarray(slope, float) / self.scale))


def ng_alpha(camera: PlenopticCamera) -> AlphaConvention:
    """Convention of Ng's alpha for a camera: image distance over that of the microlens array.

    ``1 - 1/alpha = -slope * pitch / view_step`` (R. Ng, "Fourier slice photography", ACM Trans.
    Graph. 24, 2005), like `PlenopticCamera.slope_to_alpha` and `alpha_to_slope`.

    Examples
    --------
    >>> from lf_flame.optics import PAPER_CAMERA, ng_alpha, to_slope
    >>> abs(to_slope(1.0, ng_alpha(PAPER_CAMERA)))  # the image plane on the microlens array
    0.0
    """
    return AlphaConvention(-camera.on_exit_pupil(camera.view_step_mm) / camera.grid_pitch_mm)


def plenoptomos_distance(
    z0: float, view_pitch: float, pixel_pitch: float, magnification: float = 1.0
) -> AlphaConvention:
    """Convention of the refocusing distance z of plenoptomos (its parallel beam geometry).

    plenoptomos reads a view at ``v`` on the lens at ``t + v (1 - 1/alpha)`` with ``alpha = z / z0``
    (refocus.py, lightfield.py, version 0.2.0): ``slope = view_pitch / (pixel_pitch magnification)
    (1 - z0/z)``.

    Parameters
    ----------
    z0 : float
        Focused distance of the plenoptomos camera.
    view_pitch, pixel_pitch : float
        Distance between views on the lens, and between pixels of a view, in the same unit.
    magnification : float, optional
        Magnification of the plenoptomos geometry; it multiplies `pixel_pitch`.

    Raises
    ------
    InputError
        If a length is 0 or not finite.

    Examples
    --------
    >>> from lf_flame.optics import plenoptomos_distance, to_slope
    >>> convention = plenoptomos_distance(z0=100.0, view_pitch=1.0, pixel_pitch=0.05)
    >>> float(to_slope(200.0, convention))  # 1 / 0.05 * (1 - 100 / 200)
    10.0
    """
    if 0 in (pixel_pitch, magnification):
        raise InputError(
            f"pixel_pitch and magnification must not be 0, got {pixel_pitch} and {magnification}."
        )
    return AlphaConvention(view_pitch / (pixel_pitch * magnification), z0)


CONVENTIONS = {
    "motion": Convention(
        1, "slope", "motion of an image in lenslets per view; the slope of this package"
    ),
    "hci": Convention(
        -1,
        "-slope",
        "disparity in pixels per view, positive for what is nearer than the focus distance: 4D "
        "Light Field Benchmark, Honauer et al., ACCV 2016, depth2disp of its evaluation toolkit; "
        "EPINET's output, too",
    ),
    "lftoolbox": Convention(
        1,
        "slope (N - 1) / N",
        "LFToolbox 0.5, LFFiltShiftSum: views are read at linspace(-0.5, 0.5, N) Slope N",
        lambda n: n / (n - 1),
    ),
    "liff": Convention(1, "slope", "LiFF, FocalStack.c: views are read at + slope per view"),
    "plenopticam": Convention(
        -1, "-slope", "PlenoptiCam 0.9, refo_from_vp: views are moved by + a, a whole number"
    ),
    "plenopticam-refined": Convention(
        -1,
        "-slope N",
        "PlenoptiCam 0.9 with refinement: views are enlarged N times and moved by + a of the finer "
        "pixels (T of them become N T by (T - 1) / (N T - 1) and not 1 / N, which is left aside)",
        lambda n: 1 / n,
    ),
    "plenpy": Convention(
        -1,
        "-slope (N - 1) / N",
        "plenpy 0.9, get_refocus: views are moved by + slope N / (N - 1)",
        lambda n: n / (n - 1),
    ),
    "fdl": Convention(
        -1,
        "-slope",
        "Fourier Disparity Layers, refocusFFT.m: views are moved by + d U, U to the right and V "
        "upward; Le Pendu, Guillemot, Smolic, IEEE Trans. Image Process. 28, 5740, 2019",
    ),
}
"""Conventions of known programs by name."""


def to_slope(
    number: Number, convention: str | Convention | AlphaConvention, views: int | None = None
) -> Number:
    """Convert a refocusing number of another program to a slope.

    Parameters
    ----------
    number : float or ndarray
        Number in that convention.
    convention : str or Convention or AlphaConvention
        A name in `CONVENTIONS`, or the result of `ng_alpha` or `plenoptomos_distance`.
    views : int, optional
        Number of views along an axis, for conventions that depend on it. For unequal numbers of
        rows and columns of views such a program's number stands for no slope.

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
    return _named(convention).to_slope(number, views)


def from_slope(
    slope: Number, convention: str | Convention | AlphaConvention, views: int | None = None
) -> Number:
    """Convert a slope to the refocusing number of another program; the inverse of `to_slope`.

    Parameters
    ----------
    slope : float or ndarray
        Slope in lenslets per view step.
    convention : str or Convention or AlphaConvention
        A name in `CONVENTIONS`, or the result of `ng_alpha` or `plenoptomos_distance`.
    views : int, optional
        Number of views along an axis, for conventions that depend on it.

    Returns
    -------
    float or ndarray
        Number in that convention.

    Raises
    ------
    InputError
        If the convention is unknown, or needs the number of views, 2 or more.

    Examples
    --------
    >>> from lf_flame.optics import from_slope
    >>> from_slope(0.5, "plenpy", views=5)
    -0.4
    """
    return _named(convention).from_slope(slope, views)


def _named(convention: str | Convention | AlphaConvention) -> Convention | AlphaConvention:
    if isinstance(convention, Convention | AlphaConvention):
        return convention
    if convention not in CONVENTIONS:
        raise InputError(f"convention must be one of {', '.join(CONVENTIONS)}, got {convention!r}.")
    return CONVENTIONS[convention]
