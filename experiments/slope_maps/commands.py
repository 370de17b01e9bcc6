"""The command that sets slope maps beside the truth: slope-maps."""

from pathlib import Path

import click
import cloup

from experiments.beside_reference import set_beside
from lf_flame.commands.options import FOLDER


@cloup.command("slope-maps")
@click.option("--out", type=FOLDER, default="results/slope_maps", show_default=True)
def slope_maps(out: Path) -> None:
    """Compare the slope map, and three plain methods, with the truth, in minutes.

    On photographs on slanted, curved, thin, occluding, shadowed and glossy surfaces, with noise,
    JPEG and uneven views; the true slopes follow from the geometry.

    OUT gets slope_maps.csv, .md, .png and .json, the record.

    \b
      python -m experiments slope-maps --out results/slope_maps
    """  # noqa: D301 - click reads the backspace
    from experiments.command_parts import step_bar
    from experiments.slope_maps.measuring import measure
    from experiments.slope_maps.report import write

    path = write(out, *measure(step_bar))
    click.echo(set_beside(path, f"slope_maps/{path.name}"))
