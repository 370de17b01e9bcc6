"""The commands that find emission by depth: resolution and reconstruct.

As in `lf_flame.commands.cli`, heavy modules are imported inside the commands.
"""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click
import cloup

from lf_flame._common.printable import printable
from lf_flame.commands.colour_fits import (
    SOOT,
    check_colour_folders,
    read_exposed_colours,
    soot_options,
    write_soot,
)
from lf_flame.commands.options import (
    FOLDER,
    OVERWRITE,
    PATH,
    SEED,
    FiniteRange,
    camera_option,
    pick,
    tell_all,
)
from lf_flame.commands.reading_options import READING, Reading
from lf_flame.errors import InputError

if TYPE_CHECKING:
    import numpy as np

    from lf_flame.lightfield import LightField
    from lf_flame.tomography import ColourCalibration, FrustumGrid

PERIODS_MM = (0.5, 1.0, 2.0, 5.0, 10.0)
"""Lateral periods in mm of the table if none is given."""


def _read_camera(path: Path | None):
    from lf_flame.calibration import read_lens
    from lf_flame.optics.camera import PAPER_CAMERA

    return read_lens(path) if path else PAPER_CAMERA


@cloup.command()
@camera_option()
@click.option(
    "--thickness",
    "thickness_mm",
    type=FiniteRange(min=0, min_open=True),
    default=30.0,
    show_default=True,
    help="Extent in depth of the region that may emit, in mm.",
)
@click.option(
    "--period",
    "periods",
    multiple=True,
    type=FiniteRange(min=0, min_open=True),
    help="Lateral period of detail, in mm; may be repeated.",
)
@click.option("--figure", type=PATH, help="PNG of the blur and of the singular values.")
def resolution(camera, thickness_mm, periods, figure) -> None:
    """Print what one light field can resolve in depth, and what it cannot.

    A camera sees the scene within the angle of its aperture, so fine detail has a depth and an even
    glow has none. Without --camera, the paper's camera is used.
    """
    from lf_flame.commands.emission import resolution_report
    from lf_flame.tomography.resolution import finest_period

    chosen = _read_camera(camera)
    finest = finest_period(chosen)
    if periods and min(periods) < finest:
        raise InputError(
            f"--period must be at least {finest:.3g} mm, the finest detail of this camera (two "
            f"pixels), got {min(periods):g}."
        )
    periods = periods or (float(f"{finest:.3g}"), *(one for one in PERIODS_MM if one > finest))
    if camera is None:
        click.echo("The paper's camera; --camera takes yours.")
    click.echo(resolution_report(chosen, thickness_mm, periods))
    if figure:
        from lf_flame._common import figures
        from lf_flame.tomography.figures import resolution_figure

        if figure.suffix.lower() != ".png":
            raise InputError(f"--figure must end in .png, got {figure}.")
        figures.save(resolution_figure(chosen, thickness_mm, periods), figure)
        click.echo(f"\n{figure} is written")


DEPTHS = cloup.option_group(
    "Where emission is sought",
    cloup.option(
        "--depths",
        nargs=3,
        type=float,
        metavar="FROM TO STEP",
        help="Evenly spaced depth planes, both ends included, in mm from the focal plane, or "
        "from the zero of a calibration.",
    ),
    cloup.option(
        "--depth-mm",
        "planes",
        multiple=True,
        type=float,
        help="Depth of one depth plane, in mm; may be repeated. For known depths.",
    ),
    cloup.option(
        "--block",
        type=click.IntRange(min=1),
        default=1,
        show_default=True,
        help="Number of lenslets along each axis that make one pixel. More: less noise, memory and "
        "time.",
    ),
)

FITTING = cloup.option_group(
    "How it is fitted",
    camera_option(),
    cloup.option(
        "--noise",
        type=FiniteRange(min=0),
        help="Standard deviation of the noise of a pixel (default: measured).",
    ),
    cloup.option(
        "--method",
        type=click.Choice(["penalised", "sart", "mlem", "lsqr", "nnls"]),
        default="penalised",
        show_default=True,
        help="Penalised fit; or, to compare with, a classical method without penalty and error "
        "bars, which stops as soon as the residual falls to the noise.",
    ),
    cloup.option(
        "--penalty",
        type=click.Choice(["roughness", "variation"]),
        default="roughness",
        show_default=True,
        help="Regularisation: roughness, for flames; total variation, for emission with sharp "
        "edges.",
    ),
    cloup.option(
        "--strength",
        type=FiniteRange(min=0),
        help="Strength of the penalty (default: chosen from the noise).",
    ),
    cloup.option(
        "--optical-thickness",
        metavar="T",
        help="Absorption by the flame itself, known from elsewhere: a light field does not show "
        "it. A TIFF holds the optical thickness of each depth plane, pixel by pixel. A number is "
        "the total along every line of sight, spread evenly over the planes, as in an even smoke "
        "that fills the field; a flame that does not fill the field gets too bright edges. "
        "Default: no absorption.",
    ),
    cloup.option(
        "--background",
        type=click.Choice(["fit"]),
        help="fit: subtract an even background of unknown level, measured in the pixels that no "
        "emission reaches. Default: no background.",
    ),
    cloup.option("--l-curve", is_flag=True, help="Try every strength, for the curve in trust.png."),
    cloup.option(
        "--bootstrap",
        type=click.IntRange(min=0),
        help="Number of bootstrap light fields (new noise, fitted again) for the error bars; 0: "
        "none (default: 20, and 0 with another --method than penalised).",
    ),
    cloup.option(
        "--seed", type=SEED, default=0, show_default=True, help="Seed of the bootstrap draws."
    ),
    *SOOT,
)


@cloup.command()
@click.argument("source", type=PATH)
@DEPTHS
@FITTING
@READING
@click.option("--out", type=FOLDER, help="Folder for the files; default reconstructed/SOURCE.")
@OVERWRITE
def reconstruct(
    source,
    depths,
    planes,
    block,
    camera,
    out,
    overwrite,
    optical_thickness,
    l_curve,
    seed,
    colours,
    thin,
    **options,
) -> None:
    """Find the emission at each depth that explains a light field of a flame.

    Refocused images do not show it: each holds the blurred light of all other depths. SOURCE is
    read as by `lf-flame refocus`; it must be grey, linear in light, black at 0, divided by a white
    image, and its camera known. `lf-flame resolution` prints what the result can resolve in depth;
    read that first.

    \b
      lf-flame simulate flames.toml
      lf-flame reconstruct simulated/flames/light_field.npz \\
          --camera simulated/flames/simulation.json --depth-mm 20 --depth-mm 10 --depth-mm 0
      lf-flame reconstruct raw.png --white white.png --camera camera.toml --depths -12 12 2
      lf-flame reconstruct flame.npy --camera camera.toml --depths -12 12 2 \\
          --optical-thickness tau.tif
    """  # noqa: D301 - click reads the backspace
    from lf_flame.commands.emission import read_thickness
    from lf_flame.formats.coding import notes_on_coding
    from lf_flame.tomography import FrustumGrid, Roughness
    from lf_flame.tomography.emission_folder import RECORD
    from lf_flame.tomography.frustum_grid import planes_between

    if bool(depths) == bool(planes):
        raise InputError(
            "Say where emission is sought: either --depths FROM TO STEP or --depth-mm."
        )
    if l_curve and options["penalty"] != "roughness":
        raise InputError(
            "--l-curve tries the strengths of --penalty roughness; leave it out with "
            f"--penalty {options['penalty']}, which has one strength."
        )
    if colours and options["method"] != "penalised":
        raise InputError("--method does not apply with --colours, whose fits are penalised.")
    if options["bootstrap"] is None:
        options["bootstrap"] = 20 if options["method"] == "penalised" else 0
    grid = FrustumGrid(_read_camera(camera), planes_between(*depths) if depths else planes, block)
    of_soot = soot_options(colours, thin, options.pop("soot_exponent"))
    if colours and optical_thickness is not None:
        raise InputError("--optical-thickness does not apply with --colours, which finds it.")
    thickness = None if optical_thickness is None else read_thickness(optical_thickness)
    calibration, notes = read_exposed_colours(colours, source) if colours else (None, [])
    out = out or Path("reconstructed") / source.stem
    if calibration is not None:
        check_colour_folders(out, calibration.responses.names, RECORD, overwrite)
    reading = pick(Reading, options)
    light_field, lens = reading.read_of_camera(source, grid.camera if camera else None)
    grid = grid if lens is None else replace(grid, camera=lens)
    facts = {"seed": seed, "bootstrap": options["bootstrap"]}
    facts["notes"] = [*notes, *notes_on_coding(source)]
    if l_curve:
        options["penalty"] = Roughness(whole_curve=True)
    fit = _Fit(light_field, grid, options, source, out, overwrite, facts)
    if calibration is None:
        _write_emission(fit, thickness, optical_thickness)
    else:
        _write_soot(fit, calibration, of_soot)


class _Fit(NamedTuple):
    """A light field to fit, the options of the fit, and what is recorded of the call."""

    light_field: "LightField"
    grid: "FrustumGrid"
    options: dict[str, Any]
    source: Path
    out: Path
    overwrite: bool
    facts: dict[str, Any]


def _write_emission(fit: _Fit, thickness: "float | np.ndarray | None", given: str | None) -> None:
    """Find emission in grey light, write its folder, and say what was found."""
    import numpy as np

    from lf_flame._common.output_folders import output_folder, recorded_path
    from lf_flame.commands.emission import thickness_facts
    from lf_flame.tomography import reconstruct as find_emission
    from lf_flame.tomography.emission_folder import RECORD
    from lf_flame.tomography.output import write_reconstruction

    with output_folder(fit.out, RECORD, overwrite=fit.overwrite) as folder:
        found = find_emission(
            fit.light_field,
            fit.grid,
            rng=np.random.default_rng(fit.facts["seed"]),
            optical_thickness=thickness,
            **fit.options,
        )
        write_reconstruction(found, fit.light_field, folder)
        folder.facts |= {"source": recorded_path(fit.source, folder.folder)} | fit.facts
        folder.facts |= {"method": fit.options["method"]}
        folder.facts |= thickness_facts(given, thickness)
    tell_all("Note", fit.facts["notes"])
    tell_all("Warning", found.warnings)
    click.echo(
        f"noise {found.noise:.3g} a pixel; emission.tif, depth.csv, slices.png, depth.png, "
        f"trust.png and {RECORD} are in {printable(folder.folder)}"
    )


def _write_soot(fit: _Fit, calibration: "ColourCalibration", of_soot: dict[str, Any]) -> None:
    """Find temperature and absorption from the colours, and write the folders of both."""
    from lf_flame.tomography.emission_folder import RECORD
    from lf_flame.tomography.output import write_reconstruction
    from lf_flame.tomography.soot import reconstruct_soot
    from lf_flame.tomography.soot_rounds import split_colours

    soot = reconstruct_soot(
        fit.light_field, fit.grid, calibration, seed=fit.facts["seed"], **of_soot, **fit.options
    )
    names = calibration.responses.names
    lights = split_colours(fit.light_field, names)
    facts, write = fit.facts | of_soot, write_reconstruction
    write_soot(soot, lights, names, fit.out, RECORD, fit.overwrite, write, fit.source, facts)
