"""The commands that use emission that was found: profiles and temperature.

As in `lf_flame.commands.cli`, heavy modules are imported inside the commands.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from lf_flame.commands.options import (
    ABOVE_0,
    FILE,
    RUN,
    FiniteRange,
    command,
    option,
    out_options,
    print_files,
    print_notes,
    result_name,
)
from lf_flame.errors import InputError

if TYPE_CHECKING:
    from lf_flame.tomography import ColourCalibration, EmissionFolder

WIDTH = FiniteRange(min=0)


@command()
@click.argument("folder", type=RUN)
@option("--across", "Centre of the upright strip, in mm (default: found).", float)
@option("--width", "Width of the upright strip in mm; at least one pixel.", WIDTH, default=0.0)
@option("--height", "Centre of the level strip, in mm (default: found).", float)
@option(
    "--thickness", "Thickness of the level strip in mm; at least one pixel.", WIDTH, default=0.0
)
@out_options("profiles/FOLDER")
def profiles(folder, out, overwrite, **strips) -> None:
    """Take profiles of emission along a flame and across it, with 95 % bands.

    FOLDER is the output of `lf-flame reconstruct`. Positions and heights are in mm from the optical
    axis, to the right and upwards; by default, the strips run through the centre of the light in
    each depth plane. axial.csv and radial.csv contain a row for each position and depth plane,
    profiles.png shows them. `lf-flame abel` writes profiles of axisymmetric flames itself.

    \b
      lf-flame profiles reconstructed/flames
      lf-flame profiles reconstructed/flames --across 0 --width 1 --height -5 --thickness 2
    \f

    Standard deviations need the folder's bootstrap draws (`--bootstrap` of reconstruct). They and
    the bands include noise, penalty and the bias of the draws; for flames behind each other, nearer
    than the blur in depth, they do not include all of the exchange of light between planes.
    """  # noqa: D301 - click reads the backspace
    from lf_flame._common.atomic_files import output_folder, recorded_path
    from lf_flame.tomography import EmissionFolder
    from lf_flame.tomography.profiles import RECORD, take_profiles, write_profiles

    emission = EmissionFolder(folder)
    if emission.is_section:
        raise InputError(
            f"{folder} is of `lf-flame abel`, which has written its profiles: axial.csv and "
            f"radial.csv."
        )
    found = take_profiles(emission, **strips)
    out = out or Path("profiles") / folder.resolve().name
    with output_folder(out, RECORD, overwrite=overwrite) as written:
        write_profiles(found, emission.depths_mm, written)
        written.facts |= {"source": recorded_path(folder, written.folder)}
        written.facts |= {"bootstrap": len(emission.draws), **strips}
    if not len(emission.draws):
        print_notes("Warning", ["the folder contains no draws, so the profiles have no bands."])
    print_files(written)


@command()
@click.argument("folders", nargs=-1, required=True, type=RUN, metavar="FOLDER...")
@option("--colours calibration_file", "colours.toml of `calibrate-colours`.", FILE)
@option(
    "--wavelengths",
    "Without --colours: wavelengths of the two folders' light, in nm, each taken as monochromatic.",
    float,
    nargs=2,
    metavar="FIRST SECOND",
)
@option(
    "--soot-exponent",
    "Exponent a of soot's absorption, wavelength^-a; from -1 to 5 (default: the folder's, or 1).",
    float,
)
@option(
    "--calibration",
    "With --wavelengths: signal of the first colour divided by the second's, for equal spectral "
    "radiance (default: 1).",
    ABOVE_0,
)
@out_options("temperature/FOLDER")
def temperature(
    folders, calibration_file, wavelengths, soot_exponent, calibration, out, overwrite
) -> None:
    """Find the temperature of soot from its emission in two colours or more.

    FOLDER is one of `lf-flame reconstruct` or `lf-flame abel` with --colours, which contains a
    folder for each colour; or give the folders of the colours, of one camera and the same planes,
    or of one axis and radius. All need error bars, and images that are linear in light. Where an
    emission is not above three of its standard deviations, there is no temperature (NaN).

    --wavelengths is for two exposures through narrow filters, of flames that are thin: with a
    colour camera (Bayer) temperatures would be wrong by tens to hundreds of kelvin.

    \b
      lf-flame temperature abel/flame --colours colours/colours.toml
      lf-flame temperature green red --wavelengths 550 650
    """  # noqa: D301 - click reads the backspace
    import numpy as np

    from lf_flame._common.atomic_files import output_folder, recorded_path
    from lf_flame.tomography import soot_output as output
    from lf_flame.tomography.emission_folder import read_colours_of
    from lf_flame.tomography.pyrometry import soot_temperature

    colours = _calibration(calibration_file, wavelengths, calibration)
    every = read_colours_of(*_colour_folders(folders, colours.responses.names))
    if len(folders) == 1 and len({one.record.call for one in every}) > 1:
        raise InputError(
            f"The colours in {folders[0]} are not of one run; if it was interrupted, repeat it."
        )
    if calibration_file is not None:
        _check_order(every, colours.responses.names)
    first = every[0].record
    soot_exponent = _exponent(every[0], soot_exponent)
    if first.absorbing and calibration_file and first.gains not in (None, colours.gains.tolist()):
        raise InputError(f"The absorption was found with other gains than {calibration_file} has.")
    # Colours of one run are drawn together.
    drawn = len(folders) == 1 and all(len(one.draws) for one in every)
    found = soot_temperature(
        [one.emission for one in every],
        colours.responses,
        sigmas=[one.sigma for one in every],  # type: ignore[misc]
        draws=[one.draws for one in every] if drawn else None,
        gains=colours.gains,
        soot_exponent=soot_exponent,
    )
    out = out or Path("temperature") / result_name(folders[0])
    with output_folder(out, output.TEMPERATURE_RECORD, overwrite=overwrite) as folder:
        warnings = output.temperature_warnings(found, colours)
        notes = output.temperature_notes(found, every, colours, soot_exponent)
        # Without absorption the gains need not be absolute.
        absolute = calibration_file is not None and all(one.record.absorbing for one in every)
        last = every[-1].emission
        output.write_temperature(found, last, every[0].places, folder, absolute=absolute)
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
    print_files(folder, f"{known.size} of {found.kelvin.size} cells have a temperature{median}; ")
    print_notes("Warning", warnings)
    print_notes("Note", notes)


def _exponent(folder: "EmissionFolder", stated: float | None) -> float:
    """Exponent as stated, or with which the absorption was found; both must agree."""
    used = folder.record.soot_exponent
    if stated is None:
        return 1.0 if used is None else used
    if folder.record.absorbing and used is not None and used != stated:
        raise InputError(
            f"--soot-exponent must be that with which the absorption in {folder.folder} was found, "
            f"{used:g}, got {stated:g}: run lf-flame reconstruct or lf-flame abel with it."
        )
    return stated


def _check_order(folders: "list[EmissionFolder]", names: Sequence[str]) -> None:
    """Refuse folders that are not in the order of the calibration's colours, as far as they say."""
    for folder, name in zip(folders, names, strict=True):
        if folder.record.colour not in (None, name):
            raise InputError(
                f"{folder.folder} is {folder.record.colour}; the order is {', '.join(names)}."
            )


def _calibration(
    file: Path | None, wavelengths: tuple[float, float] | None, ratio: float | None
) -> "ColourCalibration":
    """Calibration from a file, or of two single wavelengths."""
    import numpy as np

    from lf_flame.tomography.colour_calibration import ColourCalibration, read_colours
    from lf_flame.tomography.pyrometry import LEAST_K, MOST_K
    from lf_flame.tomography.spectra import SpectralResponses

    if (wavelengths is None) == (file is None):
        raise InputError("State the colours: either --colours FILE or --wavelengths.")
    if file is not None:
        if ratio is not None:
            raise InputError("--calibration does not apply with --colours, which has the gains.")
        return read_colours(file)
    assert wavelengths is not None
    colours = SpectralResponses.single(wavelengths)
    return ColourCalibration(colours, np.array([ratio or 1.0, 1.0]), np.zeros(2), (LEAST_K, MOST_K))


def _colour_folders(folders: tuple[Path, ...], names: tuple[str, ...]) -> list[Path]:
    """Folder of each colour: as given, or by name inside the one that is given."""
    if len(folders) == 1:
        inside = [folders[0] / name for name in names]
        missing = [path.name for path in inside if not path.is_dir()]
        if missing:
            raise InputError(
                f"{folders[0]} contains no folder {missing[0]}: give a folder of lf-flame "
                f"reconstruct or abel with --colours, or one for each of {', '.join(names)}."
            )
        return inside
    if len(folders) != len(names):
        raise InputError(
            f"Give a folder for each of the {len(names)} colours ({', '.join(names)}), or the one "
            f"that contains them all, got {len(folders)}."
        )
    return list(folders)
