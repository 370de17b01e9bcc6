"""Files and table of a calibration."""

from collections.abc import Sequence

import numpy as np
from tabulate import tabulate

from lf_flame._common import figures
from lf_flame._common.atomic_files import write_text
from lf_flame._common.output_folders import OutputFolder
from lf_flame.calibration.camera_law import thin_lens
from lf_flame.calibration.fit import LawFit
from lf_flame.calibration.targets import Target
from lf_flame.errors import InputError
from lf_flame.optics.camera import PlenopticCamera

RECORD = "calibration.json"
LAW = "calibration.toml"
CAMERA = "camera.toml"
PICTURE = "calibration.png"

LARGEST_TILT = 1.5
"""Largest tilt of a target in degrees without a note: it raises the scale by 0.02 %."""


def tilt_deg(target: Target, fit: LawFit, depth_mm: float) -> tuple[float, float]:
    """Angle in degrees between a target and the plane of the lenslets, and its error."""
    _, error, gradient = target.slope_at_centre(fit.law.distortion)
    per_mm = -fit.law.slope_mm / (depth_mm - fit.law.slope_centre_mm) ** 2
    size = fit.law.scale * (depth_mm - fit.law.scale_centre_mm)
    # A gradient is as exact as a slope at a distance of the spread of the corners.
    changes = np.array([np.hypot(*gradient), error / np.std(target.points)])
    tilt, tilt_error = np.degrees(np.arctan(changes / abs(per_mm) / size))
    return float(tilt), float(tilt_error)


def table(fit: LawFit, depths: Sequence[float], targets: Sequence[Target]) -> str:
    """Tabulate each target: measured, by the law, and by the law of the others."""
    headers = [
        "depth\nmm", "corners", "slope", "+-", "mm per\nlenslet", "depth error\nmm",
        "scale error\n%", "left out:\nmm", "left out:\n%", "tilt\ndeg",
    ]  # fmt: skip
    rows = []
    for number, (depth, target) in enumerate(zip(depths, targets, strict=True)):
        slope, error, _ = target.slope_at_centre(fit.law.distortion)
        left_out = (fit.left_out_mm[number], 100 * fit.left_out_scale[number])
        rows.append(
            [
                f"{depth:g}",
                len(target.points),
                f"{slope:+.5f}",
                f"{error:.1e}",
                f"{fit.law.mm_per_lenslet(depth):.5f}",
                f"{fit.depth_residuals_mm[number]:+.4f}",
                f"{100 * fit.scale_residuals[number]:+.4f}",
                *(f"{x:+.4f}" if np.isfinite(x) else "-" for x in left_out),
                "{:.1f} +- {:.1f}".format(*tilt_deg(target, fit, depth)),
            ]
        )
    return tabulate(rows, headers, disable_numparse=True, colalign=["right"] * len(headers))


def summary(fit: LawFit) -> str:
    """Describe the law in a few lines, each number with the range of 95 %."""
    law, factor = fit.law, fit.coverage
    error = {name: factor * x for name, x in law.standard_deviations.items()}
    low, high = law.depth_range_mm
    middle = (low + high) / 2
    return (
        f"slope(z) = {law.slope_at_infinity:.6g} {law.slope_mm:+.6g} / "
        f"(z {-law.slope_centre_mm:+.6g}), mm per lenslet = {law.scale:.6g} "
        f"(z {-law.scale_centre_mm:+.6g})\n"
        f"views meet at z = {law.slope_centre_mm:.2f} +- {error['slope_centre_mm']:.2g} mm; "
        f"focal plane at z = {law.focal_plane_mm:.3f} mm\n"
        f"for z from {low:g} to {high:g} mm; at {middle:g} mm the depth is within "
        f"{factor * fit.depth_error_mm(middle):.2g} mm and the scale within "
        f"{100 * factor * fit.scale_error(middle) / law.mm_per_lenslet(middle):.2g} % (95 %)"
    )


def notes(fit: LawFit, depths: Sequence[float], targets: Sequence[Target]) -> list[str]:
    """Sentences on what lowers the accuracy, and what to do."""
    said = list(fit.notes)
    tilts = [tilt_deg(one, fit, z) for one, z in zip(targets, depths, strict=True)]
    sure = [tilt if tilt > LARGEST_TILT + 3 * error else 0.0 for tilt, error in tilts]
    worst = int(np.argmax(sure))
    if sure[worst]:
        said.append(
            f"The target at {depths[worst]:g} mm is tilted by {sure[worst]:.1f} degrees, which "
            f"foreshortens its squares and is not allowed for: lengths by it are "
            f"{100 * (np.cos(np.radians(sure[worst])) ** -0.5 - 1):.2g} % too large; set it "
            f"parallel to the lens."
        )
    if fit.law.fall_off is not None:
        lit = [level for row in fit.law.fall_off for level in row if level]
        said.append(
            f"Views are unlike in brightness, {min(lit):.2f} to {max(lit):.2f} of the central one; "
            f"{LAW} holds it, and pictures read with it are divided by it: read them in the same "
            f"way as these (with --white or without)."
        )
    if fit.law.distortion:
        corner = np.hypot(*fit.law.lenslets) / 2
        bend = fit.law.distortion * corner**2
        said.append(
            f"The lens distorts: distances from the centre are {100 * bend:+.2g} % longer at the "
            f"corners when freed of it, and slopes there {200 * bend:+.2g} %; {LAW} holds it, and "
            f"pictures read with it are freed of it (flicker keeps it)."
        )
    return said


def try_thin_lens(
    fit: LawFit, lenslet_mm: float, focal_mm: float | None = None
) -> tuple[PlenopticCamera | None, str]:
    """Make the thin-lens camera of a law; None, and the reason, where there is none."""
    try:
        return thin_lens(fit.law, lenslet_mm, focal_mm=focal_mm), ""
    except InputError as error:
        return None, f"{error} {CAMERA} is not written."


def write_calibration(
    fit: LawFit,
    targets: Sequence[Target],
    depths: Sequence[float],
    sources: Sequence[str],
    folder: OutputFolder,
    camera: PlenopticCamera | None = None,
) -> None:
    """Write the law, the thin-lens camera if there is one, the picture, and facts of the record."""
    head = (
        "# Measured by lf-flame calibrate. Depths are in mm, from the zero of the given ones:\n"
        "# slope(z) = slope_at_infinity + slope_mm / (z - slope_centre_mm)\n"
        "# mm per lenslet(z) = scale (z - scale_centre_mm)\n"
    )
    write_text(folder.path(LAW), head + fit.law.to_toml())
    if camera is not None:
        write_text(folder.path(CAMERA), _camera_toml(camera, fit.law.focal_plane_mm))
    figures.save(law_figure(fit, targets, depths), folder.path(PICTURE))
    folder.facts |= {
        "targets": [
            _facts(fit, number, targets[number], depths[number], sources[number])
            for number in range(len(targets))
        ],
        "law": {**vars(fit.law)},
        "covariance": fit.covariance.tolist(),
        "degrees_of_freedom": fit.freedom,
        "standard_deviations_for_95_percent": fit.coverage,
        "position_error_mm": fit.position_error_mm,
        "notes": notes(fit, depths, targets),
    }


def _facts(fit: LawFit, number: int, target: Target, depth: float, source: str) -> dict:
    slope, slope_error, _ = target.slope_at_centre(fit.law.distortion)
    lattice = target.squares_per_lenslet(fit.law.distortion)
    facts = {
        "source": source,
        "depth_mm": depth,
        "corners": len(target.points),
        "slope": slope,
        "slope_error": slope_error,
        "squares_per_lenslet": lattice.scale,
        "squares_per_lenslet_error": lattice.scale_error,
        "residual_lenslets": target.residual,
        "anisotropy": target.anisotropy,
        "rotation_rad": target.rotation_rad,
        "tilt_deg": tilt_deg(target, fit, depth)[0],
        "depth_residual_mm": float(fit.depth_residuals_mm[number]),
        "scale_residual": float(fit.scale_residuals[number]),
        "left_out_mm": float(fit.left_out_mm[number]),
        "left_out_scale": float(fit.left_out_scale[number]),
    }
    return {k: x if not isinstance(x, float) or np.isfinite(x) else None for k, x in facts.items()}


def _camera_toml(camera: PlenopticCamera, focal_plane_mm: float) -> str:
    names = ("main_lens_focal_mm", "focus_distance_mm", "lenslet_focal_mm", "lenslet_pitch_mm",
             "views", "lenslets", "exit_pupil_mm")  # fmt: skip
    values = {name: getattr(camera, name, None) for name in names}
    lines = [f"{x} = {list(y) if x == 'lenslets' else y!r}" for x, y in values.items() if y]
    return (
        f"# Thin-lens camera by lf-flame calibrate. Its depths are from the focal plane, which is "
        f"at\n# {focal_plane_mm:.4f} mm by the depths of {LAW}.\n[camera]\n"
        + "\n".join(lines)
        + "\n"
    )


def law_figure(fit: LawFit, targets: Sequence[Target], depths: Sequence[float]):
    """Draw slope and scale by depth, and below the residuals, also of targets left out."""
    law, placed = fit.law, np.asarray(depths, float)
    figure, axes = figures.subplots(2, 2, figsize=(10, 6), layout="constrained", sharex=True)
    fine = np.linspace(*law.depth_range_mm, 200)
    slopes = [one.slope_at_centre(law.distortion)[0] for one in targets]
    scales = law.mm_per_lenslet(placed) / (1 + fit.scale_residuals)
    for axis, curve, points, title in (
        (axes[0, 0], law.depth_to_slope(fine), slopes, "slope in lenslets per view step"),
        (axes[0, 1], law.mm_per_lenslet(fine), scales, "mm per lenslet"),
    ):
        axis.plot(fine, curve, color="0.4", label="law")
        axis.plot(placed, points, "o", label="targets")
        axis.set_ylabel(title)
    depth_errors = np.array([fit.depth_error_mm(z) for z in fine])
    scale_errors = np.array([fit.scale_error(z) for z in fine]) / law.mm_per_lenslet(fine)
    for axis, unit, errors, residuals, left_out, title in (
        (axes[1, 0], 1, depth_errors, fit.depth_residuals_mm, fit.left_out_mm, "depth error in mm"),
        (axes[1, 1], 100, scale_errors, fit.scale_residuals, fit.left_out_scale, "scale error in %")
    ):  # fmt: skip
        band = unit * fit.coverage * errors
        axis.fill_between(fine, -band, band, color="0.85", label="law, 95 %")
        axis.plot(placed, unit * residuals, "o", label="targets")
        axis.plot(placed, unit * left_out, "x", color="C3", label="left out of the fit")
        axis.set(xlabel="depth in mm", ylabel=title)
    for axis in axes.flat:
        axis.legend()
    return figure
