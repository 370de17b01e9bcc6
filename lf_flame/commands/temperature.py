"""The command that finds temperatures of soot: temperature.

As in `lf_flame.commands.cli`, heavy modules are imported inside the command.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click
import cloup

from lf_flame._common.printable import printable
from lf_flame.commands.options import FILE, FOLDER, OVERWRITE, RUN, tell_all
from lf_flame.errors import InputError

if TYPE_CHECKING:
    from lf_flame.tomography import ColourCalibration, EmissionFolder


@cloup.command()
@click.argument("folders", nargs=-1, required=True, type=RUN, metavar="FOLDER...")
@click.option(
    "--colours",
    "calibration_file",
    type=FILE,
    help="Calibration of the camera's colours, colours.toml of lf-flame calibrate-colours.",
)
@click.option(
    "--wavelengths",
    nargs=2,
    type=float,
    metavar="FIRST SECOND",
    help="Without --colours: wavelengths of the two folders' light, in nm, each taken as "
    "monochromatic.",
)
@click.option(
    "--soot-exponent",
    type=float,
    help="Exponent a of soot's absorption, wavelength^-a; from -1 to 5 (default: that of the "
    "folder, or 1).",
)
@click.option(
    "--calibration",
    type=float,
    help="With --wavelengths: ratio of the camera's two signals, first to second, at equal "
    "radiance in both colours (default: 1).",
)
@click.option("--out", type=FOLDER, help="Folder for the files; default temperature/FOLDER.")
@OVERWRITE
def temperature(
    folders, calibration_file, wavelengths, soot_exponent, calibration, out, overwrite
) -> None:
    """Find the temperature of soot from its emission in two colours or more.

    FOLDER is one of `lf-flame reconstruct` or `lf-flame abel` with --colours, which holds a folder
    for each colour; or give the folders of the colours, of one camera and the same planes, or of
    one axis and radius. All need error bars, and images that are linear in light. Where an emission
    is not above three of its standard deviations, there is no temperature (NaN). It is the
    temperature of the soot. Its picture shows the error beside it.

    --wavelengths is for two exposures through narrow filters, of flames that are thin: with a
    colour camera (Bayer) temperatures would be wrong by tens to hundreds of kelvin.

    \b
      lf-flame abel flame.tif --bayer rggb --white white.tif --camera camera.toml \\
          --colours colours/colours.toml
      lf-flame temperature abel/flame --colours colours/colours.toml
      lf-flame temperature green red --wavelengths 550 650
    """  # noqa: D301 - click reads the backspace
    import numpy as np

    from lf_flame._common.output_folders import output_folder, recorded_path
    from lf_flame.tomography.emission_folder import read_colours_of
    from lf_flame.tomography.pyrometry import soot_temperature
    from lf_flame.tomography.temperature_output import (
        RECORD,
        temperature_notes,
        temperature_warnings,
        write_temperature,
    )

    colours = _calibration(calibration_file, wavelengths, calibration)
    every = read_colours_of(*_colour_folders(folders, colours.responses.names))
    if len(folders) == 1 and len({one.record.call for one in every}) > 1:
        raise InputError(
            f"The colours in {folders[0]} are not of one call of lf-flame reconstruct or lf-flame "
            f"abel with --colours, which may have been interrupted: call it again."
        )
    _check_order(every, colours.responses.names)
    soot_exponent = _exponent(every[0], soot_exponent)
    # Colours of one call are drawn together.
    drawn = len(folders) == 1 and all(len(one.draws) for one in every)
    found = soot_temperature(
        [one.emission for one in every],
        colours.responses,
        sigmas=[one.sigma for one in every],  # type: ignore[misc]
        draws=[one.draws for one in every] if drawn else None,
        gains=colours.gains,
        soot_exponent=soot_exponent,
    )
    out = out or Path("temperature") / folders[0].name
    with output_folder(out, RECORD, overwrite=overwrite) as folder:
        warnings = temperature_warnings(found, colours)
        notes = temperature_notes(found, every, colours, soot_exponent)
        absolute = calibration_file is not None
        write_temperature(found, every[-1].emission, every[0].places, folder, absolute=absolute)
        folder.facts |= {
            "folders": [recorded_path(one.folder, folder.folder) for one in every],
            "colours": list(colours.responses.names),
            "gains": colours.gains.tolist(),
            "wavelengths_nm": wavelengths,
            "soot_exponent": soot_exponent,
            "unit_of_optical_thickness": "per mm" if every[0].is_section else "of each plane",
            "warnings": warnings,
            "notes": notes,
        }
    known = found.kelvin[found.kelvin > 0]  # NaN is not
    median = f", their median {np.median(known):.0f} K" if known.size else ""
    click.echo(
        f"{known.size} of {found.kelvin.size} cells have a temperature{median}; "
        f"{', '.join(folder.files)} and {RECORD} are in {printable(folder.folder)}"
    )
    tell_all("Warning", warnings)
    for note in notes:
        click.echo(f"Note: {note}")


def _exponent(folder: "EmissionFolder", stated: float | None) -> float:
    """Exponent as stated, or with which the absorption was found; both must agree."""
    used = folder.record.soot_exponent
    if stated is None:
        return 1.0 if used is None else used
    if folder.record.absorbing and used is not None and used != stated:
        raise InputError(
            f"--soot-exponent must be that with which the absorption in {folder.folder} was found, "
            f"{used:g}, got {stated:g}: call lf-flame reconstruct or lf-flame abel with it."
        )
    return stated


def _check_order(folders: "list[EmissionFolder]", names: Sequence[str]) -> None:
    """Refuse folders that are not in the order of the calibration's colours, as far as they say."""
    for folder, name in zip(folders, names, strict=True):
        if folder.record.colour not in (None, name):
            raise InputError(
                f"{folder.folder} holds the colour {folder.record.colour}, but the folders must be "
                f"in the order of the calibration, {', '.join(names)}."
            )


def _calibration(
    file: Path | None, wavelengths: tuple[float, float] | None, calibration: float | None
) -> "ColourCalibration":
    """Calibration from a file, or of two single wavelengths."""
    import numpy as np

    from lf_flame.tomography.colour_calibration import ColourCalibration, read_colours
    from lf_flame.tomography.pyrometry import LEAST_K, MOST_K, two_wavelengths

    if wavelengths is None or file is not None:
        if file is None or wavelengths is not None:
            raise InputError("Say what the colours are: either --colours FILE or --wavelengths.")
        if calibration is not None:
            raise InputError("--calibration does not apply with --colours, which holds the gains.")
        return read_colours(file)
    ratio = 1.0 if calibration is None else calibration
    if not 0 < ratio < float("inf"):
        raise InputError(f"--calibration must be a finite number above 0, got {ratio}.")
    gains = np.array([ratio, 1.0])
    colours = two_wavelengths(wavelengths)
    return ColourCalibration(colours, gains, np.zeros(2), (LEAST_K, MOST_K))


def _colour_folders(folders: tuple[Path, ...], names: tuple[str, ...]) -> list[Path]:
    """Folder of each colour: as given, or by name inside the one that is given."""
    if len(folders) == 1:
        inside = [folders[0] / name for name in names]
        missing = [path.name for path in inside if not path.is_dir()]
        if missing:
            raise InputError(
                f"{folders[0]} holds no folder {missing[0]}: give a folder of lf-flame reconstruct "
                f"or lf-flame abel with --colours, or one folder for each of {', '.join(names)}."
            )
        return inside
    if len(folders) != len(names):
        raise InputError(
            f"Give a folder for each of the {len(names)} colours ({', '.join(names)}), or the one "
            f"that holds them all, got {len(folders)}."
        )
    return list(folders)
