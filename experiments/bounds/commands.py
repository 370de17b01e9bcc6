"""The command that holds bounds against images: bounds."""

from pathlib import Path

import click
import cloup

from experiments.beside_reference import set_beside
from lf_flame.commands.options import FOLDER


@cloup.command()
@click.option("--out", type=FOLDER, default="results/bounds", show_default=True)
@click.option("--scenes", type=click.IntRange(min=1), default=1000, show_default=True)
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True)
@click.option("--workers", type=click.IntRange(min=1), help="Processes; default: one per core.")
def bounds(out: Path, scenes: int, seed: int, workers: int | None) -> None:
    """Hold the effect plan's bounds against the images of random scenes.

    Scenes of flames, rough textures and cards before cameras with every imperfection. Each effect
    that arises is forced against what the plan decided, and the largest change of a pixel is set
    beside the bound. OUT gets bounds.csv, .md and .json, the record; a run that was stopped goes
    on from it.
    """
    from experiments.bounds.report import run_bounds
    from experiments.command_parts import step_bar
    from lf_flame._common.provenance import cpu_count

    path = run_bounds(scenes, seed, out, step_bar, workers or cpu_count())
    click.echo(set_beside(path, f"bounds/{path.name}"))
