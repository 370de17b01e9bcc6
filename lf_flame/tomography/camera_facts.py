"""Facts and tables of a camera: its field and focus in mm, and its resolution in depth."""

from collections.abc import Sequence

import numpy as np

from lf_flame.optics.camera_report import table
from lf_flame.optics.lens import Lens
from lf_flame.tomography.data_checks import NO_DEPTH
from lf_flame.tomography.resolution import angular_width, depth_blur, depth_modes, finest_period

PERIODS_MM = (0.5, 1.0, 2.0, 5.0, 10.0)
"""Lateral periods in mm of the table of depth resolution if none is given."""

APART = 1.0
"""Largest slope at which detail of one pixel is seen by neighbouring views without gaps."""

PERIOD = 10
"""Period of coarse detail, in periods of the finest: two pixels."""


def resolution_report(
    lens: Lens, periods_mm: Sequence[float], thickness_mm: float | None = None
) -> str:
    """Tabulate the blur in depth of detail of some lateral periods.

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
         f"{depth_modes(lens, period, thickness_mm):.1f}")
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
        "refocusable": f"{_span(lens, APART)} (slopes from -{APART:g} to {APART:g})",
    }
    if lens.views > 1:
        finest = finest_period(lens)
        fine, coarse = (depth_blur(lens, times * finest) for times in (1, PERIOD))
        facts["depth"] = (
            f"detail of {finest:.2g} mm is blurred over {fine:.2g} mm of depth, of "
            f"{PERIOD * finest:.2g} mm over {coarse:.2g} mm"
        )
    return facts


def _span(lens: Lens, slope: float) -> str:
    """Depths between two slopes, in mm; those beyond a calibration are unknown."""
    ends = [float(lens.slope_to_real_depth(end)) for end in (-slope, slope)]
    beyond = ["the lens", "infinity"]
    if targets := getattr(lens, "depth_range_mm", None):  # of a calibration
        beyond = [f"beyond the targets ({end:g} mm)" for end in targets]
        near, far = map(lens.depth_to_slope, targets)
        ends = ends if near < far else ends[::-1]
    return " to ".join(
        f"{end:.4g} mm" if np.isfinite(end) else words
        for end, words in zip(ends, beyond, strict=True)
    )
