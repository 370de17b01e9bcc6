"""The command that takes profiles of emission: profiles.

As in `lf_flame.commands.cli`, heavy modules are imported inside the command.
"""

from pathlib import Path

import click
import cloup

from lf_flame._common.printable import printable
from lf_flame.commands.options import FOLDER, RUN, FiniteRange


@cloup.command()
@click.argument("folder", type=RUN)
@click.option("--across", type=float, help="Middle of the strip upwards, in mm (default: found).")
@click.option(
    "--width",
    type=FiniteRange(min=0),
    default=0.0,
    show_default=True,
    help="Of that strip, in mm; one column of pixels at least.",
)
@click.option("--height", type=float, help="Middle of the strip across, in mm (default: found).")
@click.option(
    "--thickness",
    type=FiniteRange(min=0),
    default=0.0,
    show_default=True,
    help="Of that strip, in mm; one row of pixels at least.",
)
@click.option("--out", type=FOLDER, help="Folder for the files; default profiles/FOLDER.")
def profiles(folder, out, **strips) -> None:
    """Take profiles of emission up a flame and across it, with bands of 95 %.

    FOLDER is one of `lf-flame reconstruct`. Places and heights are in mm from the optical axis, to
    the right and upwards; without any, the strips run through the middle of each plane's light.
    axial.csv and radial.csv hold a row for each place of each plane, profiles.png shows them.
    Standard deviations need the folder's draws (`--bootstrap` of reconstruct). They and the bands
    hold noise, penalty and the bias of the draws; of flames behind each other, nearer than the blur
    in depth, not all of how planes share light. Of a round flame, `lf-flame abel` gives profiles
    along the radius.

    \b
      lf-flame profiles reconstructed/flames
      lf-flame profiles reconstructed/flames --across 0 --width 1 --height -5 --thickness 2
    """  # noqa: D301 - click reads the backspace
    from lf_flame._common.output_folders import output_folder
    from lf_flame._common.recorded_paths import recorded_path
    from lf_flame.tomography.profile_output import (
        RECORD,
        Strips,
        read_emission,
        take_profiles,
        write_profiles,
    )

    emission = read_emission(folder)
    found = take_profiles(emission, Strips(**strips))
    with output_folder(out or Path("profiles") / folder.resolve().name, RECORD) as written:
        write_profiles(found, emission.depths_mm, written)
        written.facts |= {"source": recorded_path(folder, written.folder)}
        written.facts |= {"bootstrap": len(emission.draws), **strips}
    if not len(emission.draws):
        click.echo("Warning: the folder holds no draws, so the profiles have no bands.", err=True)
    click.echo(
        f"axial.csv, radial.csv, profiles.png and {RECORD} are in {printable(written.folder)}"
    )
