"""The command that finds the emission of an axisymmetric flame: abel.

As in `lf_flame.commands.cli`, heavy modules are imported inside the command.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Any

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
    from lf_flame._common.output_folders import OutputFolder
    from lf_flame.lightfield import LightField
    from lf_flame.optics.lens import Lens
    from lf_flame.tomography import AxisymmetricFlame, AxisymmetricGrid, FlameAxis

FLAME = cloup.option_group(
    "Where the flame is",
    camera_option(required=True),
    cloup.option(
        "--axis-mm",
        type=float,
        help="Position of the axis across, in mm from the optical axis (default: found).",
    ),
    cloup.option(
        "--axis-depth",
        type=float,
        help="Depth of the axis, in mm from the focal plane, or from the zero of a calibration "
        "(default: found; required for a single picture).",
    ),
    cloup.option(
        "--radius",
        type=float,
        help="Radius in mm beyond which there is no emission (default: found from the light).",
    ),
    cloup.option(
        "--burner",
        type=float,
        help="Height in mm, upwards from the optical axis, below which there is no emission.",
    ),
)

FITTING = cloup.option_group(
    "How it is fitted",
    cloup.option(
        "--block",
        type=click.IntRange(min=1),
        default=1,
        show_default=True,
        help="Number of lenslets along each axis that make one pixel.",
    ),
    cloup.option("--central", is_flag=True, help="Use the central view alone."),
    cloup.option(
        "--noise",
        type=FiniteRange(min=0),
        help="Standard deviation of the noise of a pixel (default: measured).",
    ),
    cloup.option(
        "--strength",
        type=FiniteRange(min=0),
        help="Strength of the penalty on roughness (default: chosen from the noise).",
    ),
    cloup.option(
        "--bootstrap",
        type=click.IntRange(min=0),
        default=20,
        show_default=True,
        help="Number of bootstrap draws (of noise and prior) for the error bars; 0: none.",
    ),
    cloup.option("--seed", type=SEED, default=0, show_default=True, help="Seed of those draws."),
    *SOOT,
)


@cloup.command()
@click.argument("source", type=PATH)
@FLAME
@FITTING
@READING
@click.option("--out", type=FOLDER, help="Folder for the files; default abel/SOURCE.")
@OVERWRITE
def abel(source, camera, axis_mm, axis_depth, radius, burner, block, central, **options):
    """Find the emission of an axisymmetric flame with an upright axis.

    It is an Abel inversion from all views of a light field at once, along the camera's rays,
    without negative emission. SOURCE is read as by `lf-flame refocus`; it must be grey, linear in
    light, black at 0, and divided by a white image. For other flames use `lf-flame reconstruct`.

    The assumptions are checked on the light field. A warning is printed if the axis leans, is not
    straight or is at another place, if there is light outside the radius, if the halves differ, or
    if the flame is deeper than wide. The last, and a lean in depth, are visible only by parallax; a
    note says if noise, a small aperture or a single view would hide them.

    One picture of an ordinary camera is enough, with --axis-depth and a camera file that says
    views = 1, the pixel pitch as lenslet pitch, and that pitch times the f-number (image distance
    over aperture) as lenslet focal length.

    \b
      lf-flame abel flame.npz --camera camera.toml
      lf-flame abel raw.png --white white.png --camera camera.toml --burner -12.5 --radius 10
      lf-flame abel photograph.png --camera one_view.toml --axis-depth 0
      lf-flame abel raw.tif --bayer rggb --white white.tif --camera camera.toml \\
          --colours colours.toml
    """  # noqa: D301 - click reads the backspace
    from lf_flame.calibration import read_lens
    from lf_flame.formats.coding import notes_on_coding
    from lf_flame.tomography import AxisymmetricGrid
    from lf_flame.tomography.axisymmetric.output import RECORD, write_flame
    from lf_flame.tomography.axisymmetric.reconstruction import check_fit_options
    from lf_flame.tomography.axisymmetric.soot import reconstruct_axisymmetric_soot
    from lf_flame.tomography.data_checks import check_range
    from lf_flame.tomography.soot_rounds import split_colours

    # Reading and compiling are slow, so everything that can be refused at once comes first.
    check_fit_options(options["noise"], options["strength"], options["bootstrap"])
    lens = read_lens(camera)
    if radius is not None and not 0 < radius <= lens.focus_distance_mm:
        raise InputError(
            f"--radius must be above 0 and at most the camera's focus distance, "
            f"{lens.focus_distance_mm:g} mm, got {radius:g}."
        )
    reading = pick(Reading, options)
    out, seed = options.pop("out") or Path("abel") / source.stem, options.pop("seed")
    overwrite = options.pop("overwrite")
    colours, thin = options.pop("colours"), options.pop("thin")
    of_soot = soot_options(colours, thin, options.pop("soot_exponent"))
    calibration, notes = read_exposed_colours(colours, source) if colours else (None, [])
    if calibration is not None:
        check_colour_folders(out, calibration.responses.names, RECORD, overwrite)
    light_field, lens = _read_views(source, reading, lens)
    check_range(light_field.views, options["noise"])
    grey = light_field if calibration is None else light_field.grey()
    axis = _look_for_axis(source, grey, lens, axis_depth)
    grid = AxisymmetricGrid(
        lens,
        axis.across_mm if axis_mm is None else axis_mm,
        axis.depth_mm if axis_depth is None else axis_depth,
        axis.radius_mm if radius is None else radius,
        block,
        "central" if central else "all",
        burner,
    )
    facts = {
        "seed": seed,
        "bootstrap": options["bootstrap"],
        "notes": notes + notes_on_coding(source),
    }
    if calibration is None:
        facts["source"] = source
        _fit_grey(light_field, grid, axis, out, overwrite, facts, options)
        return
    soot = reconstruct_axisymmetric_soot(
        light_field, grid, calibration, **of_soot, seed=seed, **options
    )
    facts |= of_soot
    lights = split_colours(light_field, calibration.responses.names)
    names = calibration.responses.names

    def write(found: "AxisymmetricFlame", _: "LightField", folder: "OutputFolder") -> None:
        write_flame(found, axis, folder)

    write_soot(soot, lights, names, out, RECORD, overwrite, write, source, facts)


def _fit_grey(
    light_field: "LightField",
    grid: "AxisymmetricGrid",
    axis: "FlameAxis",
    out: Path,
    overwrite: bool,
    facts: dict[str, Any],
    options: dict[str, Any],
) -> None:
    """Fit a grey light field, write the section, and print what was found."""
    from lf_flame._common.output_folders import output_folder, recorded_path
    from lf_flame.tomography import reconstruct_axisymmetric
    from lf_flame.tomography.axisymmetric.output import RECORD, write_flame

    with output_folder(out, RECORD, overwrite=overwrite) as folder:
        found = reconstruct_axisymmetric(light_field, grid, rng=facts["seed"], **options)
        write_flame(found, axis, folder)
        notes = [*facts["notes"], *found.unseen]
        source = recorded_path(facts["source"], folder.folder)
        folder.facts |= facts | {"source": source, "warnings": found.warnings, "notes": notes}
    tell_all("Warning", found.warnings)
    tell_all("Note", notes)
    click.echo(
        f"axis {grid.axis_mm:.2f} mm across, {grid.depth_mm:.2f} mm deep; noise "
        f"{found.noise:.3g} a pixel; radial.csv, axial.csv, section.tif, section.png and {RECORD} "
        f"are in {printable(folder.folder)}"
    )


def _read_views(source: Path, reading: Reading, lens: "Lens") -> "tuple[LightField, Lens]":
    """Read a light field of a camera, or any picture if the camera has a single view."""
    from lf_flame.formats.view_files.folder import is_view_folder

    if lens.views == 1 and reading == Reading() and not is_view_folder(source):
        reading = Reading(views=1)
    light_field, lens = reading.read_of_camera(source, lens)  # type: ignore[assignment]
    return light_field, lens


def _look_for_axis(
    source: Path, light_field: "LightField", lens: "Lens", depth_mm: float | None
) -> "FlameAxis":
    """Find the axis; its depth too where there are enough view columns."""
    from lf_flame.tomography import find_axis

    columns = light_field.views.shape[1]
    if columns >= 3:
        return find_axis(light_field, lens, None)
    if depth_mm is None:
        raise InputError(
            f"{source} holds {columns} view columns, which do not tell the axis' depth: state it, "
            f"--axis-depth."
        )
    return find_axis(light_field, lens, depth_mm)
