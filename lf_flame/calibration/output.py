"""Files and table of a calibration."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from tabulate import tabulate

from lf_flame._common import figures
from lf_flame._common.atomic_files import OutputFolder, write_text
from lf_flame.calibration.camera_law import toml_table
from lf_flame.calibration.fit import LawFit
from lf_flame.calibration.targets import Target
from lf_flame.optics.camera import PlenopticCamera

RECORD = "calibration.json"
LAW = "calibration.toml"
CAMERA = "camera.toml"

HEAD = """\
# Measured by lf-flame calibrate. Depths are in mm, from the zero of the given ones:
# slope(z) = slope_at_infinity + slope_mm / (z - centre_mm)
# mm per lenslet(z) = scale (z - centre_mm)
"""


def target_facts(fit: LawFit, targets: Sequence[Target]) -> list[dict[str, Any]]:
    """List for each target what was measured, and its errors by the law.

    The tilt is the angle between the target and the plane of the lenslets.
    """
    facts = []
    for number, target in enumerate(targets):
        depth, slope, slope_error, scale, scale_error = (float(x[number]) for x in fit.measured)
        gradient = target.slope_at_centre(fit.law.distortion)[2]
        per_mm = -fit.law.slope_mm / (depth - fit.law.centre_mm) ** 2
        # A gradient is as exact as a slope at a distance of the spread of the corners.
        changes = np.array([np.hypot(*gradient), slope_error / np.std(target.points)])
        tilt, tilt_error = np.degrees(np.arctan(changes / abs(per_mm) / scale)).tolist()
        facts.append({
            "depth_mm": depth,
            "corners": len(target.points),
            "slope": slope,
            "slope_error": slope_error,
            "mm_per_lenslet": scale,
            "mm_per_lenslet_error": scale_error,
            "residual_lenslets": target.residual,
            "tilt_deg": tilt,
            "tilt_error_deg": tilt_error,
            "depth_residual_mm": float(fit.residuals[0, number]),
            "scale_residual": float(fit.residuals[1, number]),
        })  # fmt: skip
    return facts


def table(facts: list[dict]) -> str:
    """Tabulate each target: measured, and by the law."""
    columns = {
        "depth\nmm": ("depth_mm", "g"),
        "corners": ("corners", ""),
        "slope": ("slope", "+.5f"),
        "+-": ("slope_error", ".1e"),
        "mm per\nlenslet": ("mm_per_lenslet", ".5f"),
        "depth error\nmm": ("depth_residual_mm", "+.4f"),
        "scale\nerror": ("scale_residual", "+.4%"),
        "tilt\ndeg": ("tilt_deg", ".1f"),
        "+-\ndeg": ("tilt_error_deg", ".1f"),
    }
    rows = [[format(one[name], form) for name, form in columns.values()] for one in facts]
    return tabulate(rows, list(columns), disable_numparse=True, colalign=["right"] * len(columns))


def summary(fit: LawFit) -> str:
    """Describe the law in a few lines, each number with the range of 95 %."""
    law, factor = fit.law, fit.coverage
    low, high = law.depth_range_mm
    middle = (low + high) / 2
    return (
        f"slope(z) = {law.slope_at_infinity:.6g} {law.slope_mm:+.6g} / (z {-law.centre_mm:+.6g}), "
        f"mm per lenslet = {law.scale:.6g} (z {-law.centre_mm:+.6g})\n"
        f"views meet at z = {law.centre_mm:.2f} +- "
        f"{factor * law.standard_deviations['centre_mm']:.2g} mm; "
        f"focal plane at z = {law.focal_plane_mm:.3f} mm\n"
        f"for z from {low:g} to {high:g} mm; at {middle:g} mm the depth is within "
        f"{factor * fit.depth_error_mm(middle):.2g} mm and the scale within "
        f"{100 * factor * fit.scale_error(middle) / law.mm_per_lenslet(middle):.2g} % (95 %)"
    )


def notes(fit: LawFit, facts: list[dict]) -> list[str]:
    """Sentences on what lowers the accuracy, and what to do."""
    said, law = [], fit.law
    if law.slope_mm > 0:
        said.append(
            "Slopes fall with depth, but those of a camera rise: the views are stored in "
            "reverse along both axes; state the reversed order (--order=-row,-col instead of "
            "row,col) here and for every picture, or the signs of all slopes stay reversed."
        )
    if fit.misfit_mm:
        said.append(
            f"The noise of the pictures does not explain the depth errors of {fit.misfit_mm:.2g} "
            f"mm: check the positions of the targets; the standard deviations allow for them."
        )
    worst = max(facts, key=lambda one: one["tilt_deg"] - 3 * one["tilt_error_deg"])
    tilt = worst["tilt_deg"]
    if tilt > 1.5 + 3 * worst["tilt_error_deg"]:  # 1.5 degrees raise the scale by 0.02 %
        said.append(
            f"The target at {worst['depth_mm']:g} mm is tilted by {tilt:.1f} degrees, which "
            f"foreshortens its squares and is not allowed for: lengths by it are "
            f"{100 * (np.cos(np.radians(tilt)) ** -0.5 - 1):.2g} % too large; set it parallel to "
            f"the lens."
        )
    if law.fall_off is not None:
        lit = [level for row in law.fall_off for level in row if level]
        said.append(
            f"Views differ in brightness, {min(lit):.2f} to {max(lit):.2f} of the central one: "
            f"{LAW} corrects pictures that are read as these are (with --white or without)."
        )
    if law.distortion:
        bend = law.distortion * np.hypot(*law.lenslets) ** 2 / 4
        said.append(
            f"The lens distorts: without it the corners are {100 * bend:+.2g} % farther from the "
            f"centre, and slopes there {200 * bend:+.2g} % higher; {LAW} corrects pictures (but "
            f"not in flicker)."
        )
    return said


def write_calibration(
    fit: LawFit, facts: list[dict], folder: OutputFolder, camera: PlenopticCamera | None = None
) -> None:
    """Write the law, the thin-lens camera if there is one, the picture, and facts of the record."""
    write_text(folder.path(LAW), HEAD + fit.law.to_toml())
    if camera is not None:
        write_text(folder.path(CAMERA), _camera_toml(camera, fit.law.focal_plane_mm))
    figures.save(law_figure(fit), folder.path("calibration.png"))
    folder.facts |= {
        "targets": facts,
        "law": {**vars(fit.law)},
        "covariance": fit.covariance.tolist(),
        "standard_deviations_for_95_percent": fit.coverage,
        "misfit_mm": fit.misfit_mm,
    }


def _camera_toml(camera: PlenopticCamera, focal_plane_mm: float) -> str:
    names = ("main_lens_focal_mm", "focus_distance_mm", "lenslet_focal_mm", "lenslet_pitch_mm",
             "views", "lenslets", "exit_pupil_mm", "layout")  # fmt: skip
    return (
        f"# Thin-lens camera by lf-flame calibrate. Its depths are from the focal plane, which is "
        f"at\n# {focal_plane_mm:.4f} mm by the depths of {LAW}.\n"
        + toml_table("camera", {name: getattr(camera, name) for name in names})
    )


def law_figure(fit: LawFit):
    """Draw the targets' errors of depth and scale by depth, and the law's own."""
    figure, axes = figures.subplots(1, 2, figsize=(10, 4), layout="constrained", squeeze=False)
    fine, placed = np.linspace(*fit.law.depth_range_mm, 200), fit.measured.depths
    scale_errors = [fit.scale_error(z) / fit.law.mm_per_lenslet(z) for z in fine]
    for column, (errors, unit, name) in enumerate(
        (([fit.depth_error_mm(z) for z in fine], 1, "depth error in mm"),
         (scale_errors, 100, "scale error in %"))
    ):  # fmt: skip
        axis, band = axes[0, column], unit * fit.coverage * np.array(errors)
        axis.fill_between(fine, -band, band, color="0.85", label="law, 95 %")
        axis.plot(placed, unit * fit.residuals[column], "o", label="targets")
        axis.set(xlabel="depth in mm", ylabel=name)
        axis.legend()
    return figure
