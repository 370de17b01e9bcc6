"""The command that writes a light field in another form: convert.

As in `lf_flame.commands.cli`, heavy modules are imported inside.
"""

from dataclasses import replace
from pathlib import Path

import click
import cloup

from lf_flame._common.printable import printable
from lf_flame.commands.options import ABOVE_0, PATH, command, option, tell
from lf_flame.commands.reading_options import ALL_READING, Reading
from lf_flame.errors import InputError

ARRAYS = (".npy", ".npz", ".zarr")
"""Endings of the formats that keep values unchanged."""


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
      lf-flame convert raw.png views.npz --white white.png decode a plenoptic camera's image
      lf-flame convert raw.png views.npz --focused calibration.xml        of a Raytrix camera
      lf-flame convert picture.png views.npz --mosaic 8x8  views side by side
      lf-flame convert views lenslets.png                  for programs that read lenslet images
    \f

    SOURCE is read as by `lf-flame refocus`; or it is a picture of views side by side (--mosaic), an
    array with other axes (--axes, --array), or a raw image of focused lenslets (--focused). TARGET
    is a new folder (one PNG for each view), a .png or .tif file (a lenslet image, N x N pixels
    under each lenslet), .npy (views[v, u, t, s]), .npz or .zarr (views, their weights if some are
    excluded, and which pixels are known if some are not). Decode once, and use that file for long
    work. Levels of 8 and 16 bits hold values from 0 to 1; values outside, as in most raw images
    divided by a white image, are written as floats in TIFF files, or by --gain.
    """  # noqa: D301 - click reads the backspace
    from lf_flame._common.atomic_files import exclusive

    reading = Reading(**options)
    if target.resolve() in {path.resolve() for path in (source, *reading.files)}:
        raise InputError(f"{target} is read, and cannot be replaced; name another file.")
    with exclusive(target):
        light_field = reading.read(source)
        linear = not reading.coded
        said = _write(light_field, target, int(bits) if bits else None, gain, linear=linear)
    lost = {
        "which views are excluded": light_field.weights is not None
        and not light_field.weights.all(),
        "which pixels are known": light_field.valid is not None,
    }
    if target.suffix.lower() not in (".npz", ".zarr") and any(lost.values()):
        what = " and ".join(name for name, is_lost in lost.items() if is_lost)
        tell(f"{printable(target)} does not hold {what}; .npz and .zarr do")
    click.echo(f"{printable(target)} is written{said}")


def _write(light_field, target: Path, bits: int | None, gain: float | None, *, linear: bool) -> str:
    """Write a light field, and say so if its values are floats; `linear` marks 8-bit PNGs."""
    import numpy as np

    from lf_flame.formats import write_light_field

    suffix = target.suffix.lower()
    if gain is not None:
        light_field = replace(light_field, views=light_field.views * np.float32(gain))
    low, high = light_field.views.min(), light_field.views.max()
    fits, as_array = 0 <= low <= high <= 1, suffix in ARRAYS
    if bits is None:
        bits = 16 if fits or gain is not None or suffix == ".png" else 32
    if not (fits or as_array or bits == 32):
        if gain is None:
            raise InputError(
                f"{target} holds values from 0 to 1 in levels of {bits} bits, got {low:.4g} to "
                f"{high:.4g}: state a factor, as --gain {1 / max(high, 1):.3g}, with which the "
                f"rest is clipped, or write .npz or .tif (floats)."
            )
        light_field = replace(light_field, views=light_field.views.clip(0, 1))
    write_light_field(light_field, target, bits, linear=linear)
    if bits == 32 and not as_array:
        return f" with values from {low:.4g} to {high:.4g}, as floats"
    return ""
