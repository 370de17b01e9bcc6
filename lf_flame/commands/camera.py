"""The command that tabulates a camera, and its facts in mm: camera.

As in `lf_flame.commands.cli`, heavy modules are imported inside.
"""

import click

from lf_flame.commands.options import ABOVE_0, FILE, command, open_lens, option
from lf_flame.errors import InputError


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
    "Extent in depth in that table, in mm; default: 30, or a tenth of the distance.",
    ABOVE_0,
    rare=True,
)
def camera(file, depths, periods, thickness_mm) -> None:
    """Print what follows from a camera: aperture, field, slopes of depths, depth resolution.

    FILE is a TOML file with a [camera] table, the calibration.toml of `lf-flame calibrate`, or the
    simulation.json of `lf-flame simulate`; without it, the paper's camera is used.

    The camera sees the scene within the angle of its aperture: fine detail has a depth, blurred
    over its period divided by that angle, and an even glow has none.
    """
    from lf_flame.optics.camera import PAPER_CAMERA, PlenopticCamera
    from lf_flame.optics.camera_report import camera_report, depth_table
    from lf_flame.tomography.resolution import finest_period, lens_facts, resolution_report

    lens = open_lens(file) or PAPER_CAMERA
    if periods and min(periods) < (finest := finest_period(lens)):
        raise InputError(
            f"--period must be at least {finest:.3g} mm, the finest detail of this camera (two "
            f"pixels), got {min(periods):g}."
        )
    if file is None:
        click.echo("The paper's camera; name a file for yours.\n")
    if isinstance(lens, PlenopticCamera):
        click.echo(camera_report(lens, depths or (20.0, 10.0, 0.0, -10.0)))
    else:
        for name, fact in lens_facts(lens).items():
            click.echo(f"{name:<14}{fact}")
        if depths:
            click.echo(f"\n{depth_table(lens, depths)}")
    click.echo(f"\n{resolution_report(lens, periods, thickness_mm)}")
