"""The command that tabulates a camera, and its facts in mm: camera.

As in `lf_flame.commands.cli`, heavy modules are imported inside.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import click

from lf_flame._common.printable import printable
from lf_flame.commands.options import ABOVE_0, FILE, PATH, command, open_lens, option
from lf_flame.errors import InputError

if TYPE_CHECKING:
    from lf_flame.optics.lens import Lens

PERIODS_MM = (0.5, 1.0, 2.0, 5.0, 10.0)
"""Lateral periods in mm of the table of depth resolution if none is given."""

APART = 1.0
"""Largest slope at which detail of one pixel is seen by neighbouring views without gaps."""

PERIOD = 10
"""Period of coarse detail, in periods of the finest: two pixels."""


@command()
@click.argument("file", type=FILE, required=False)
@option("--depth-mm depths", "Depth in the table of slopes, in mm.", float, multiple=True)
@option(
    "--period periods",
    "Period of detail in the table of resolution, in mm.",
    ABOVE_0,
    multiple=True,
)
@option(
    "--thickness thickness_mm",
    "Extent in depth in that table, in mm.",
    ABOVE_0,
    default=30.0,
    rare=True,
)
@option("--figure", "PNG to write: the camera's planes, lenses and rays.", PATH)
def camera(file, depths, periods, thickness_mm, figure) -> None:
    """Print what follows from a camera: aperture, field, slopes of depths, depth resolution.

    FILE is a TOML file with a [camera] table, the calibration.toml of `lf-flame calibrate`, or the
    simulation.json of `lf-flame simulate`; without it, the paper's camera is used.

    The camera sees the scene within the angle of its aperture: fine detail has a depth, blurred
    over its period divided by that angle, and an even glow has none.
    """
    from lf_flame.optics.camera import PAPER_CAMERA, PlenopticCamera
    from lf_flame.optics.camera_report import camera_figure, camera_report, depth_table

    lens = open_lens(file) or PAPER_CAMERA
    if figure and figure.suffix.lower() != ".png":
        raise InputError(f"--figure must end in .png, got {figure}.")
    if figure and not isinstance(lens, PlenopticCamera):
        raise InputError(f"--figure needs a thin-lens camera, got the calibration {file}.")
    if file is None:
        click.echo("The paper's camera; name a file for yours.\n")
    shown = depths or (20.0, 10.0, 0.0, -10.0)
    if isinstance(lens, PlenopticCamera):
        click.echo(camera_report(lens, shown))
    else:
        for name, fact in lens_facts(lens)[0].items():
            click.echo(f"{name:<14}{fact}")
        if depths:
            click.echo(f"\n{depth_table(lens, depths)}")
    click.echo(f"\n{_resolution(lens, periods, thickness_mm)}")
    if figure and isinstance(lens, PlenopticCamera):
        from lf_flame._common import figures

        figures.save(camera_figure(lens, shown), figure)
        click.echo(f"\n{printable(figure)} is written")


def _resolution(lens: "Lens", periods: Sequence[float], thickness_mm: float) -> str:
    """Tabulate the blur in depth of detail of some lateral periods."""
    import numpy as np

    from lf_flame.optics.camera_report import table
    from lf_flame.tomography.data_checks import NO_DEPTH
    from lf_flame.tomography.resolution import (
        angular_width,
        depth_blur,
        depth_modes,
        finest_period,
    )

    if lens.views < 2:
        return "A single view resolves no depth."
    finest, width = finest_period(lens), angular_width(lens)
    if periods and min(periods) < finest:
        raise InputError(
            f"--period must be at least {finest:.3g} mm, the finest detail of this camera (two "
            f"pixels), got {min(periods):g}."
        )
    periods = periods or (float(f"{finest:.3g}"), *(one for one in PERIODS_MM if one > finest))
    rows = [
        (f"{period:g}", f"{depth_blur(lens, period):.3g}",
         f"{depth_modes(lens, period, thickness_mm):.1f}")
        for period in periods
    ]  # fmt: skip
    heads = "lateral period (mm)", "blur in depth (mm)", f"values in {thickness_mm:g} mm of depth"
    return (
        f"{table(rows, *heads)}\n\n{NO_DEPTH}.\nThe views span {width:.4f} rad "
        f"({np.degrees(width):.1f} degrees), seen from the focal plane: {thickness_mm:g} mm of "
        f"depth are resolved\nfor periods below {thickness_mm * width:.3g} mm, and have one value "
        f"for larger ones."
    )


def lens_facts(lens: "Lens", shape: tuple[int, ...] = ()) -> tuple[dict[str, str], list[str]]:
    """Facts in mm on what a camera sees, by name, and notes on a light field of another."""
    from lf_flame.commands.reading_options import note_on_pixels
    from lf_flame.tomography.resolution import depth_blur, finest_period

    notes = []
    if shape:
        lens.check_views(shape)
        notes += note_on_pixels(lens, shape)
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
    return facts, notes


def _span(lens: "Lens", slope: float) -> str:
    """Depths between two slopes, in mm; those beyond a calibration are unknown."""
    from math import isfinite

    from lf_flame.calibration import CameraLaw

    ends = [float(lens.slope_to_real_depth(end)) for end in (-slope, slope)]
    beyond = ["the lens", "infinity"]
    if isinstance(lens, CameraLaw):
        beyond = [f"beyond the targets ({end:g} mm)" for end in lens.depth_range_mm]
        ends = ends if lens.slope_mm < 0 else ends[::-1]
    near, far = (
        f"{end:.4g} mm" if isfinite(end) else words for end, words in zip(ends, beyond, strict=True)
    )
    return f"{near} to {far}"
