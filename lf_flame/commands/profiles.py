"""The command that takes profiles of emission: profiles.

As in `lf_flame.commands.cli`, heavy modules are imported inside the command.
"""

from pathlib import Path

import click
import cloup

from lf_flame._common.printable import printable
from lf_flame.commands.options import FOLDER, OVERWRITE, RUN, FiniteRange
from lf_flame.errors import InputError


@cloup.command()
@click.argument("folder", type=RUN)
@click.option("--across", type=float, help="Centre of the upright strip, in mm (default: found).")
@click.option(
    "--width",
    type=FiniteRange(min=0),
    default=0.0,
    show_default=True,
    help="Width of that strip, in mm; at least that of a pixel. Pixels count by their part inside.",
)
@click.option("--height", type=float, help="Centre of the level strip, in mm (default: found).")
@click.option(
    "--thickness",
    type=FiniteRange(min=0),
    default=0.0,
    show_default=True,
    help="Thickness of that strip, in mm; at least that of a pixel.",
)
@click.option("--out", type=FOLDER, help="Folder for the files; default profiles/FOLDER.")
@OVERWRITE
def profiles(folder, out, overwrite, **strips) -> None:
    """Take profiles of emission along a flame and across it, with 95 % bands.

    FOLDER is the output of `lf-flame reconstruct`. Positions and heights are in mm from the optical
    axis, to the right and upwards; by default, the strips run through the centre of the light in
    each depth plane. axial.csv and radial.csv hold a row for each position and depth plane,
    profiles.png shows them. Standard deviations need the folder's bootstrap draws (`--bootstrap` of
    reconstruct). They and the bands include noise, penalty and the bias of the draws; for flames
    one behind the other, nearer than the blur in depth, they do not include all of the exchange of
    light between planes. `lf-flame abel` gives profiles of axisymmetric flames along the radius.

    \b
      lf-flame profiles reconstructed/flames
      lf-flame profiles reconstructed/flames --across 0 --width 1 --height -5 --thickness 2
    """  # noqa: D301 - click reads the backspace
    from lf_flame._common.output_folders import output_folder, recorded_path
    from lf_flame.tomography import EmissionFolder
    from lf_flame.tomography.profiles import RECORD, Strips, take_profiles, write_profiles

    emission = EmissionFolder(folder)
    if emission.is_section:
        raise InputError(
            f"{folder} is of `lf-flame abel`, which has written its profiles: axial.csv and "
            f"radial.csv."
        )
    found = take_profiles(emission, Strips(**strips))
    out = out or Path("profiles") / folder.resolve().name
    with output_folder(out, RECORD, overwrite=overwrite) as written:
        write_profiles(found, emission.depths_mm, written)
        written.facts |= {"source": recorded_path(folder, written.folder)}
        written.facts |= {"bootstrap": len(emission.draws), **strips}
    if not len(emission.draws):
        click.echo("Warning: the folder holds no draws, so the profiles have no bands.", err=True)
    click.echo(
        f"axial.csv, radial.csv, profiles.png and {RECORD} are in {printable(written.folder)}"
    )
