"""The command that calibrates a camera's colours: calibrate-colours.

As in `lf_flame.commands.cli`, heavy modules are imported inside the command.
"""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click
import cloup

from lf_flame._common.printable import printable
from lf_flame.commands.options import FILE, FOLDER, OVERWRITE, FiniteRange, PlacedFile, tell_all
from lf_flame.commands.reading_options import READING, Reading
from lf_flame.errors import InputError

if TYPE_CHECKING:
    import numpy as np

    from lf_flame.lightfield import LightField

MOST_UNKNOWN = 0.01
"""Largest fraction of unknown pixels of a picture of the source."""


@cloup.command("calibrate-colours")
@click.argument(
    "placed",
    nargs=-1,
    required=True,
    type=PlacedFile("a picture and its temperature in K", "f1.tif@1273"),
    metavar="PICTURE@KELVIN...",
)
@cloup.option(
    "--responses",
    type=FILE,
    required=True,
    help="Spectral responses: a CSV file with the heading wavelength_nm and the colours' names in "
    "the order of the channels, and a row for each wavelength, with lens and filters.",
)
@cloup.option(
    "--exposure",
    "exposures",
    multiple=True,
    type=FiniteRange(min=0, min_open=True),
    help="Exposure of each picture over that of the flame's, in the order of the pictures "
    "(default: as the files state their times; if they do not, the same).",
)
@cloup.option(
    "--emissivity",
    type=FiniteRange(min=0, min_open=True, max=1),
    default=1.0,
    show_default=True,
    help="Emissivity of the source: 1 for a furnace, less for a lamp.",
)
@READING
@click.option("--out", type=FOLDER, help="Folder for the files; default colours.")
@OVERWRITE
def calibrate_colours(placed, responses, exposures, emissivity, out, overwrite, **options) -> None:
    """Measure the gains of a camera's colours, by pictures of a furnace at known temperatures.

    PICTURE@KELVIN is a picture of the opening of a furnace (black body) or of a lamp, read as by
    `lf-flame refocus`, and its temperature in K. Aperture, gain and filters must be those of the
    flame's picture. Three temperatures or more around the flame's are well; two are the least.
    The source must be in the same place in all pictures, evenly bright, and not saturated.

    \b
      lf-flame calibrate-colours f1.tif@1273 f2.tif@1473 f3.tif@1673 --responses camera.csv \\
          --bayer rggb --white white.tif --dark dark.tif
      lf-flame abel flame.tif --camera camera.toml --colours colours/colours.toml \\
          --bayer rggb --white white.tif --dark dark.tif
      lf-flame temperature abel/flame --colours colours/colours.toml

    colours.toml holds gains, their errors, and the responses. The table and colours.png show how
    far each picture is from the fit. The line below it is the lowest temperature that the responses
    tell from all higher ones; they must do so from 1,000 K on.
    """  # noqa: D301 - click reads the backspace
    from lf_flame._common.output_folders import output_folder, recorded_path
    from lf_flame.formats import read_exposure
    from lf_flame.formats.coding import notes_on_coding
    from lf_flame.tomography import colour_output
    from lf_flame.tomography.colour_calibration import MOST_UNEVEN, measure_source
    from lf_flame.tomography.colour_calibration import calibrate_colours as fit_colours
    from lf_flame.tomography.pyrometry import least_temperature
    from lf_flame.tomography.spectra import read_responses

    kelvin = [temperature for _, temperature in placed]
    curves = read_responses(responses)
    if exposures and len(exposures) != len(placed):
        raise InputError(
            f"--exposure must be given once for each of the {len(placed)} pictures, or not at all, "
            f"got {len(exposures)}."
        )
    reading = Reading(**options)
    out = out or Path("colours")
    with output_folder(out, colour_output.RECORD, overwrite=overwrite) as folder:
        sources = [path for path, _ in placed]
        in_files = [] if exposures else list(filter(None, map(read_exposure, sources)))
        # Gains are those of the first picture's exposure, to which that of the flame is compared.
        first = in_files[0] if len(in_files) == len(sources) else None
        exposures = [one / first for one in in_files] if first else exposures
        photographs = _photographs(reading, sources, len(curves.names))
        least = least_temperature(curves)
        source = measure_source(photographs)
        fit = fit_colours(
            kelvin, source.signals, curves, exposures=exposures or None, emissivity=emissivity
        )
        fit = replace(fit, calibration=replace(fit.calibration, exposure=first))
        notes = next(filter(None, map(notes_on_coding, sources)), [])
        colour_output.write_colours(fit, kelvin, folder)
        folder.facts |= {
            "pictures": [recorded_path(path, folder.folder) for path, _ in placed],
            "signals": source.signals.tolist(),
            "pixels": int(source.mask.sum()),
            "exposures": list(exposures) or None,
            "emissivity": emissivity,
            "least_temperature_K": least,
            "reading": reading.given(),
            "notes": notes,
        }
    click.echo(colour_output.colours_table(fit, kelvin))
    click.echo(f"these colours tell temperatures of soot from {least:.0f} K on")
    if source.uneven > MOST_UNEVEN:
        click.echo(
            f"Warning: the source is uneven, by {source.uneven:.0%} within the part that is "
            f"averaged; the gains are those of its mean.",
            err=True,
        )
    if not exposures:
        click.echo(
            "Note: the pictures' files state no exposure. All are taken as exposed as the flame "
            "is; if not, say so by --exposure, or its absorption comes out wrong.",
            err=True,
        )
    tell_all("Note", notes)
    tell_all("Warning", fit.warnings)
    click.echo(f"{', '.join(folder.files)} are in {printable(folder.folder)}")


def _photographs(reading: Reading, sources: list[Path], colours: int) -> "list[np.ndarray]":
    """Read light fields or raw images of one camera, and average the views of each."""
    from tqdm import tqdm

    again, found = None, []
    for source in tqdm(sources, "reading", unit="picture"):
        if again is not None:
            light_field = again(source)
        elif reading.is_raw:
            # The lenslets of all pictures are found once, as they are of one camera.
            first = reading.find(source)
            light_field, again = first.light_field, first.again
        else:
            light_field = reading.read(source)
        if light_field.channels != colours or colours < 2:
            raise InputError(
                f"{source} must have a channel for each of the {colours} spectral responses, got "
                f"{light_field.channels}."
            )
        _refuse_unknown(source, light_field)
        found.append(light_field.photograph)
    return found


def _refuse_unknown(source: Path, light_field: "LightField") -> None:
    """Refuse a picture that is saturated where it is bright."""
    if light_field.valid is None:
        return
    lost = 1 - float(light_field.valid.mean())
    if lost > MOST_UNKNOWN:
        raise InputError(
            f"{source} is saturated or unknown in {lost:.1%} of its pixels, of {MOST_UNKNOWN:.0%} "
            f"at most: its mean would be too dark; expose less."
        )
