"""Depth resolution of one light field; it is worse for coarser detail.

A plenoptic camera sees the scene within the angle that its aperture spans. For detail of lateral
frequency k it records only depth frequencies within ``k theta / 2``; the rest is the missing cone
(for limited angles in general: Tuy, SIAM J. Appl. Math. 43, 546, 1983; Natterer, The Mathematics of
Computerized Tomography, chapter 6). Depth is therefore blurred over ``1 / (k theta)``, and a
uniform glow has no depth at all.
"""

from collections.abc import Sequence

import numpy as np

from lf_flame._common.arrays import Number
from lf_flame.errors import InputError
from lf_flame.optics.camera_report import table
from lf_flame.optics.lens import Lens

NO_DEPTH = "A light field gives almost no depth information for a smooth flame"

PERIODS_MM = (0.5, 1.0, 2.0, 5.0, 10.0)
"""Lateral periods in mm of the table of depth resolution if none is given."""


def angular_width(camera: Lens) -> float:
    """Angle that the recorded views span, seen from the focal plane, in rad.

    An aperture narrower than what the lenslets see limits it.
    """
    return camera.pupil_width_mm / camera.pupil_distance_mm


def finest_period(camera: Lens, block: int = 1) -> float:
    """Shortest period that the central view resolves, in mm in the focal plane: two pixels."""
    return 2 * block * camera.lenslet_in_focus_mm


def depth_blur(camera: Lens, period_mm: Number) -> Number:
    """Distance in depth over which detail is blurred: ``period / theta``.

    Parameters
    ----------
    camera : Lens
    period_mm : float or ndarray
        Lateral period of the detail in the focal plane in mm, above 0.

    Returns
    -------
    float or ndarray
        Blur in depth in mm.

    Raises
    ------
    InputError
        If a period is not above 0.

    Examples
    --------
    >>> from lf_flame import PAPER_CAMERA
    >>> from lf_flame.tomography import depth_blur
    >>> round(depth_blur(PAPER_CAMERA, 1.0), 1)  # mm in depth, for detail of 1 mm across
    4.2
    """
    if not np.all(np.asarray(period_mm) > 0):
        raise InputError(f"period_mm must be above 0, got {period_mm}.")
    return period_mm / angular_width(camera)


def resolution_report(
    lens: Lens, periods_mm: Sequence[float], thickness_mm: float | None = None
) -> str:
    """Tabulate the blur in depth of detail of given lateral periods, and how many values it leaves.

    The extent in depth is 30 mm by default, or a tenth of the distance if that is less.
    """
    if lens.views < 2:
        return "A single view resolves no depth."
    if thickness_mm is None:
        thickness_mm = float(f"{min(30.0, lens.pupil_distance_mm / 10):.2g}")
    finest, width = finest_period(lens), angular_width(lens)
    periods = periods_mm or (float(f"{finest:.3g}"), *(one for one in PERIODS_MM if one > finest))
    rows = [
        (f"{period:g}", f"{depth_blur(lens, period):.3g}",
         f"{1 + thickness_mm / depth_blur(lens, period):.1f}")
        for period in periods
    ]  # fmt: skip
    heads = "lateral period (mm)", "blur in depth (mm)", f"values in {thickness_mm:g} mm of depth"
    return (
        f"{table(rows, *heads)}\n\n{NO_DEPTH}.\nThe views span {width:.4f} rad "
        f"({np.degrees(2 * np.arctan(width / 2)):.1f} degrees), seen from the focal plane: "
        f"{thickness_mm:g} mm of depth are resolved\nfor periods below "
        f"{thickness_mm * width:.3g} mm, and have one value for larger ones."
    )


def lens_facts(lens: Lens) -> dict[str, str]:
    """Facts in mm on what a camera sees, by name."""
    facts = {
        "focal plane": f"at {lens.focal_plane_mm:.4g} mm, "
        f"{lens.pupil_distance_mm:.4g} mm from where the views meet",
        "pixel there": f"{lens.lenslet_in_focus_mm:.4g} mm",
        "in focus": f"{_span(lens, 1 / max(lens.views - 1, 1))} (the views agree within a pixel)",
        # Up to slope 1, neighbouring views see detail of one pixel without gaps.
        "refocusable": f"{_span(lens, 1.0)} (slopes from -1 to 1)",
    }
    if lens.views > 1:
        finest = finest_period(lens)
        fine, coarse = (depth_blur(lens, times * finest) for times in (1, 10))
        facts["depth"] = (
            f"detail of {finest:.2g} mm is blurred over {fine:.2g} mm of depth, of "
            f"{10 * finest:.2g} mm over {coarse:.2g} mm"
        )
    return facts


def _span(lens: Lens, slope: float) -> str:
    """Depths between two slopes, in mm; those beyond a calibration are unknown."""
    slopes, beyond = [-slope, slope], ["the lens", "infinity"]
    if ends := getattr(lens, "depth_range_mm", None):  # of a calibration
        near, far = map(lens.depth_to_slope, ends)
        slopes = slopes if near < far else slopes[::-1]
        sides = [ends[(one - near) * (far - near) > 0] for one in slopes]
        beyond = [f"beyond the targets ({end:g} mm)" for end in sides]
    depths = [float(lens.slope_to_real_depth(one)) for one in slopes]
    return " to ".join(
        f"{end:.4g} mm" if np.isfinite(end) else words
        for end, words in zip(depths, beyond, strict=True)
    )
