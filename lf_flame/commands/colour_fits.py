"""Fits of each colour of a sooty flame, for `lf-flame reconstruct` and `lf-flame abel`."""

import secrets
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import cloup

from lf_flame._common.printable import printable
from lf_flame.commands.options import FILE, tell_all
from lf_flame.errors import InputError

if TYPE_CHECKING:
    from lf_flame._common.output_folders import OutputFolder
    from lf_flame.lightfield import LightField
    from lf_flame.tomography.colour_calibration import ColourCalibration
    from lf_flame.tomography.soot_rounds import Soot

SOOT = (
    cloup.option(
        "--colours",
        type=FILE,
        help="Calibration of the camera's colours, colours.toml of lf-flame calibrate-colours. "
        "SOURCE is in colour then; each colour is fitted, the soot's own absorption is corrected, "
        "and FOLDER gets a folder for each.",
    ),
    cloup.option(
        "--thin",
        is_flag=True,
        help="With --colours: take the flame for optically thin, as with a calibration whose gains "
        "are not absolute.",
    ),
    cloup.option(
        "--soot-exponent",
        type=float,
        help="With --colours: exponent a of soot's absorption, wavelength^-a, from -1 to 5 "
        "(default: 1).",
    ),
)
"""Options for the soot of a flame, seen in colour."""


def soot_options(colours: Path | None, thin: bool, exponent: float | None) -> dict[str, Any]:
    """Options of the fit of soot; --thin and --soot-exponent are refused without --colours."""
    if colours is None:
        for name, given in (("--thin", thin), ("--soot-exponent", exponent is not None)):
            if given:
                raise InputError(f"{name} goes with --colours, without which no soot is fitted.")
    return {"absorbing": not thin, "soot_exponent": 1.0 if exponent is None else exponent}


def read_exposed_colours(path: Path, source: Path) -> "tuple[ColourCalibration, list[str]]":
    """Read a calibration of colours with its gains for the exposure of a flame's picture.

    Returns
    -------
    ColourCalibration
    list of str
        A sentence where one exposure is known and not the other, or they differ.
    """
    from lf_flame.formats import read_exposure
    from lf_flame.tomography.colour_calibration import read_colours

    calibration, exposure = read_colours(path), read_exposure(source)
    if calibration.exposure is None:
        return calibration, []
    if exposure is None:
        return calibration, [
            f"{source} states no exposure: it is taken as that of the furnace's first picture, "
            f"{calibration.exposure:.3g} s at ISO 100."
        ]
    times = exposure / calibration.exposure
    if abs(times - 1) < 1e-6:
        return calibration, []
    return calibration.exposed(exposure), [
        f"{source} was exposed {times:.3g} times as the furnace's first picture, as their files "
        f"state; this is taken into account."
    ]


def check_colour_folders(out: Path, names: tuple[str, ...], record: str, overwrite: bool) -> None:
    """Refuse, before the fits, folders of colours that may not be written."""
    from lf_flame._common.output_folders import refuse_folder

    for name in names:
        refuse_folder(out / name, record, overwrite=overwrite)


def write_soot(
    soot: "Soot",
    lights: "list[LightField]",
    names: tuple[str, ...],
    out: Path,
    record: str,
    overwrite: bool,
    write: "Callable[[Any, LightField, OutputFolder], None]",
    source: Path,
    facts: dict[str, Any],
) -> None:
    """Write a folder for each colour, and print warnings and where they are.

    All records hold the same random `call`, as a call that is killed may leave colours of two.
    """
    from lf_flame._common.output_folders import output_folder, recorded_path

    call = secrets.token_hex(8)
    for number, (name, found, light) in enumerate(zip(names, soot.colours, lights, strict=True)):
        with output_folder(out / name, record, overwrite=overwrite) as folder:
            write(found, light, folder)
            folder.facts |= facts | {
                "source": recorded_path(source, folder.folder),
                "colour": name,
                "call": call,
                "warnings": list(found.warnings),
                "greatest_optical_thickness": float(soot.total_thickness[number]),
            }
        tell_all(f"Warning: {name}", found.warnings)
    tell_all("Note", facts["notes"])
    tell_all("Warning", soot.warnings)
    thick = ", ".join(
        f"{name} {total:.2g}" for name, total in zip(names, soot.total_thickness, strict=True)
    )
    if soot.total_thickness.any():
        click.echo(f"optical thickness of the soot, at most: {thick}")
    click.echo(f"{', '.join(names)} are in {printable(out)}")
