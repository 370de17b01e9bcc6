"""The command that finds the emission of a round flame: abel.

As in `lf_flame.commands.cli`, heavy modules are imported inside the command.
"""

from pathlib import Path

import click
import cloup

from lf_flame._common.printable import printable
from lf_flame.commands.light_field_options import READING, Reading
from lf_flame.commands.options import FILE, FOLDER, PATH, SEED

FLAME = cloup.option_group(
    "Where the flame is",
    cloup.option("--camera", type=FILE, required=True, help="TOML file, or a simulation.json."),
    cloup.option(
        "--axis-mm", type=float, help="Of the axis, across, from the optical axis (default: found)."
    ),
    cloup.option(
        "--axis-depth", type=float, help="Of the axis, in mm from the focal plane (default: found)."
    ),
    cloup.option(
        "--radius", type=float, help="In mm; beyond it nothing glows (default: as the light shows)."
    ),
    cloup.option(
        "--burner",
        type=float,
        help="Height in mm, upwards from the optical axis, below which nothing glows.",
    ),
)

FITTING = cloup.option_group(
    "How it is fitted",
    cloup.option(
        "--block",
        type=click.IntRange(min=1),
        default=1,
        show_default=True,
        help="Lenslets along each axis that make one pixel.",
    ),
    cloup.option("--central", is_flag=True, help="Look at the middle view alone, as a camera's."),
    cloup.option(
        "--noise",
        type=click.FloatRange(min=0),
        help="Standard deviation of a pixel's noise (default: measured).",
    ),
    cloup.option(
        "--strength",
        type=click.FloatRange(min=0),
        help="Of the penalty on roughness (default: what the noise allows).",
    ),
    cloup.option(
        "--redraws",
        type=click.IntRange(min=0),
        default=20,
        show_default=True,
        help="Light fields drawn with new noise and fitted again, for the error bars; 0 for none.",
    ),
    cloup.option("--seed", type=SEED, default=0, show_default=True, help="Of those draws."),
)


@cloup.command()
@click.argument("source", type=PATH)
@FLAME
@FITTING
@READING
@click.option("--out", type=FOLDER, help="Folder for the files; default abel/SOURCE.")
def abel(source, camera, axis_mm, axis_depth, radius, burner, block, central, **options):
    """Find the emission of a flame that is round about an upright axis.

    Abel inversion from all views of a light field at once, with rays as the camera sees them and
    without negative light. SOURCE is read as by `lf-flame refocus`; it must be grey, linear
    in light, black at 0, divided by a white image. A flame that leans or is not round gets a
    warning, and the round flame most like it. For any other flame: `lf-flame reconstruct`.

    \b
      lf-flame abel flame.npz --camera camera.toml
      lf-flame abel raw.png --white white.png --camera camera.toml --burner -12.5 --radius 10
    """  # noqa: D301 - click reads the backspace
    import numpy as np

    from lf_flame._common.output_folders import output_folder
    from lf_flame._common.recorded_paths import recorded_path
    from lf_flame.commands.axisymmetric_output import RECORD, write_flame
    from lf_flame.formats.coding import notes_on_coding
    from lf_flame.scenes.scene_files import read_camera
    from lf_flame.tomography import AxisymmetricGrid, find_axis, reconstruct_axisymmetric
    from lf_flame.tomography.axisymmetric import check_roundness

    lens = read_camera(camera)
    reading = Reading(**{name: options.pop(name) for name in Reading.__dataclass_fields__})
    out, seed = options.pop("out"), options.pop("seed")
    light_field = reading.for_camera(source, lens).read(source)
    axis = find_axis(light_field, lens)
    grid = AxisymmetricGrid(
        lens,
        axis.across_mm if axis_mm is None else axis_mm,
        axis.depth_mm if axis_depth is None else axis_depth,
        axis.radius_mm if radius is None else radius,
        block,
        "central" if central else "all",
        burner,
    )
    notes = notes_on_coding(source)
    with output_folder(out or Path("abel") / source.stem, RECORD) as folder:
        rng = np.random.default_rng(seed)
        found = reconstruct_axisymmetric(light_field, grid, rng=rng, **options)
        warnings = [*check_roundness(axis), *found.warnings]
        write_flame(found, axis, folder)
        folder.facts |= {
            "source": recorded_path(source, folder.folder),
            "seed": seed,
            "redraws": options["redraws"],
            "warnings": warnings,
            "notes": notes,
        }
    for note in notes:
        click.echo(f"Note: {note}", err=True)
    for warning in warnings:
        click.echo(f"Warning: {warning}", err=True)
    click.echo(
        f"axis {grid.axis_mm:.2f} mm across, {grid.depth_mm:.2f} mm deep; noise "
        f"{found.noise:.3g} a pixel; radial.csv, axial.csv, section.tif, section.png and {RECORD} "
        f"are in {printable(folder.folder)}"
    )
