"""The command that says what a file is, and what to type next: info.

As in `lf_flame.commands.cli`, heavy modules are imported inside.
"""

import shlex
from pathlib import Path

import click

from lf_flame.commands.options import PATH, camera_option, command, open_lens, option
from lf_flame.commands.reading_options import note_on_pixels
from lf_flame.errors import InputError


@command()
@click.argument("source", type=PATH)
@option("--white", "White image of a raw image; info says if it fits.", PATH)
@option("--lenslets", "Image that shows the lenslets' centres.", PATH)
@option("--dark", "Dark image; needs --white or --lenslets.", PATH)
@option("--bayer", "Bayer pattern of the sensor.", metavar="rggb")
@camera_option("; adds facts in mm")
def info(source: Path, white, lenslets, dark, bayer, camera: Path | None) -> None:
    """Say what a file or folder is, what is missing to read it, and which command comes next.

    SOURCE is anything that may hold a light field: a picture of a Lytro camera (.lfp, .lfr, .raw),
    its white images (a folder, or caldata-SERIAL.tar), the calibration of a Raytrix camera (.xml),
    a folder of views, an array, a TIFF of many pages, a raw image or a lenslet image. Nothing is
    changed.

    \b
      lf-flame info photo.lfr                        camera, exposure, lenslets, white image
      lf-flame info caldata-B5143909630.tar          for which camera, zoom and focus it is
      lf-flame info raw.tif --lenslets spots.tif     lenslets, views, and what is missing
      lf-flame info flame.npz --camera calibration.toml  in mm: pixels, focus, depth
    """  # noqa: D301 - click reads the backspace
    from lf_flame.formats.file_facts import describe
    from lf_flame.tomography.resolution import lens_facts

    if not source.exists():
        raise InputError(f"There is no {source}: no such file or folder.")
    lens = open_lens(camera)
    found = describe(source, white, lenslets, dark, bayer)
    if lens is not None and camera is not None:
        if found.shape:
            lens.check_views(found.shape)
            found.notes += note_on_pixels(lens, found.shape)
        found.facts |= lens_facts(lens)
        if found.shape and found.command:
            found.command += f" --camera {shlex.quote(str(camera))}"
    click.echo(found.text(source))
