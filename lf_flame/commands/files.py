"""The commands on a file or a camera: info, convert and camera.

As in `lf_flame.commands.cli`, heavy modules are imported inside.
"""

import shlex
from dataclasses import replace
from pathlib import Path

import click
import cloup

from lf_flame._common.input_files import printable
from lf_flame.commands.options import (
    ABOVE_0,
    FILE,
    PATH,
    camera_option,
    command,
    open_lens,
    option,
    report,
)
from lf_flame.commands.reading_options import ALL_READING, Reading, note_on_pixels
from lf_flame.errors import InputError

ARRAYS = (".npy", ".npz")
"""Endings of the formats that keep values unchanged."""


@command()
@click.argument("source", type=PATH)
@option("--white", "White image of a raw image; info says if it fits.", PATH)
@option("--lenslets", "Image that shows the lenslets' centres.", PATH)
@option("--dark", "Dark image, which is subtracted.", PATH)
@option("--bayer", "Bayer pattern of the sensor.", metavar="rggb")
@option("--names", "Pattern of the views' names in a folder, such as 'input_Cam*.png'.")
@option("--grid", "Rows x columns of the views, such as 9x9.")
@option("--order", "Meaning of the two numbers of a view, such as row,-col.")
@camera_option("; adds facts in mm")
def info(source: Path, camera: Path | None, **options) -> None:
    """Say what a file or folder is, what is missing to read it, and which command comes next.

    SOURCE is anything that may contain a light field: a picture of a Lytro camera (.lfp, .lfr,
    .raw), its white images (a folder, or caldata-SERIAL.tar), the calibration of a Raytrix camera
    (.xml), a folder of views, an array, a TIFF of many pages, a raw image or a lenslet image.
    Nothing is changed.

    \b
      lf-flame info photo.lfr                        camera, sensor, white image
      lf-flame info caldata-B5143909630.tar          for which camera it is
      lf-flame info raw.tif --lenslets spots.tif     lenslets, views, and what is missing
      lf-flame info flame.npz --camera calibration.toml  in mm: pixels, focus, depth
    """  # noqa: D301 - click reads the backspace
    from lf_flame.formats.file_facts import describe
    from lf_flame.tomography.resolution import lens_facts

    if not source.exists():
        raise InputError(f"There is no {source}: no such file or folder.")
    lens = open_lens(camera)
    if lens and (options["white"] or options["lenslets"]):  # as `refocus` decodes it
        options["views"] = lens.views
    found = describe(source, **options)
    if lens is not None and camera is not None:
        if found.shape:
            lens.check_views(found.shape)
            found.notes += note_on_pixels(lens, found.shape)
        found.facts |= lens_facts(lens)
        if found.shape and found.command:
            found.command += f" --camera {shlex.quote(str(camera))}"
    click.echo(found.text(source))


@command()
@click.argument("source", type=PATH)
@click.argument("target", type=PATH)
@ALL_READING
@cloup.option_group(
    "How TARGET is written",
    option(
        "--bits",
        "Bits of a value of an image; 32 are floats, in TIFF (default: 16, or 32 where needed).",
        click.Choice(["8", "16", "32"]),
    ),
    option("--gain", "Factor on all values; 8 and 16 bits keep 0 to 1.", ABOVE_0),
)
def convert(source: Path, target: Path, bits: str | None, gain: float | None, **options) -> None:
    """Write a light field of any kind in another form.

    \b
      lf-flame convert raw.png views.npz --white white.png  decode a raw image
      lf-flame convert raw.png views.npz --focused calibration.xml        of a Raytrix camera
      lf-flame convert picture.png views.npz --mosaic 8x8  views side by side
      lf-flame convert views lenslets.png                  for programs that read lenslet images
    \f

    SOURCE is read as by `lf-flame refocus`; or it is a picture of views side by side (--mosaic), an
    array with other axes (--axes, --array), or a raw image of focused lenslets (--focused). TARGET
    is a new folder (one PNG for each view), a .png or .tif file (a lenslet image, N x N pixels
    under each lenslet), .npy (views[v, u, t, s]) or .npz (views, their weights if some are
    excluded, and which pixels are known if some are not). Decode once, and use that file for long
    work. Levels of 8 and 16 bits represent values from 0 to 1; values outside, as in most raw
    images divided by a white image, are written as floats (TIFF), or need --gain (PNG).
    """  # noqa: D301 - click reads the backspace
    from lf_flame._common.atomic_files import exclusive
    from lf_flame.formats.writing import check_ending

    check_ending(target)
    reading = Reading(**options)
    inputs = {path.resolve() for path in (source, *reading.files)}
    as_array = target.suffix.lower() in ARRAYS
    # A picture in a folder that is read may be one of its views.
    is_view = not as_array and target.is_file() and target.parent.resolve() in inputs
    if is_view or target.resolve() in inputs:
        raise InputError(f"{target} is an input, and cannot be replaced; name another file.")
    if bits and as_array:
        raise InputError(f"--bits does not apply to {target}, which stores floats unchanged.")
    with exclusive(target):
        light_field = reading.read(source)
        linear = not reading.coded
        said = _write(light_field, target, int(bits) if bits else None, gain, linear=linear)
    lost = {
        "which views are excluded": light_field.excluded,
        "which pixels are known": light_field.unknown,
    }
    if target.suffix.lower() != ".npz" and any(lost.values()):
        what = " and ".join(name for name, is_lost in lost.items() if is_lost)
        report(f"{printable(target)} does not store {what}; .npz does")
    click.echo(f"{printable(target)} is written{said}")


def _write(light_field, target: Path, bits: int | None, gain: float | None, *, linear: bool) -> str:
    """Write a light field, and say so if its values are floats; `linear` marks 8-bit PNGs."""
    import numpy as np

    from lf_flame.formats import write_light_field

    suffix = target.suffix.lower()
    if gain is not None:
        light_field = replace(light_field, views=light_field.views * np.float32(gain))
    low, high = (f(light_field.used_values) for f in (np.min, np.max))  # others are clipped
    fits, as_array = 0 <= low <= high <= 1, suffix in ARRAYS
    if bits is None:
        bits = 16 if fits or gain is not None or suffix == ".png" else 32
    if not (as_array or bits == 32):
        if not fits and gain is None:
            raise InputError(
                f"{target} stores values from 0 to 1 in levels of {bits} bits, got {low:.4g} to "
                f"{high:.4g}: state a factor, such as --gain {1 / max(high, 1):.3g} (values still "
                f"outside 0 to 1 are clipped), or write .npz, or .tif with --bits 32 (floats)."
            )
        light_field = replace(light_field, views=light_field.views.clip(0, 1))
    write_light_field(light_field, target, bits, linear=linear)
    if bits == 32 and not as_array:
        return f" with values from {low:.4g} to {high:.4g}, as floats"
    return ""


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
    if periods and min(periods) < 0.995 * (finest := finest_period(lens)):  # as printed
        raise InputError(
            f"--period must be at least {finest:.3g} mm, the finest detail of this camera (two "
            f"pixels), got {min(periods):g}."
        )
    if file is None:
        click.echo("The paper's camera; name a file for yours.\n")
    if isinstance(lens, PlenopticCamera):
        room = min(lens.focus_distance_mm, lens.pupil_distance_mm) / 2
        click.echo(camera_report(lens, depths or [z for z in (20, 10, 0, -10) if -z < room]))
    else:
        for name, fact in lens_facts(lens).items():
            click.echo(f"{name:<14}{fact}")
        if depths:
            click.echo(f"\n{depth_table(lens, depths)}")
    click.echo(f"\n{resolution_report(lens, periods, thickness_mm)}")
