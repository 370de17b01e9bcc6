"""The command that measures how data sets are made: dataset-making."""

from pathlib import Path

import click
import cloup

from experiments.beside_reference import set_beside
from lf_flame.commands.options import FOLDER


@cloup.command("dataset-making")
@click.option("--out", type=FOLDER, default="results/dataset_making", show_default=True)
@click.option("--samples", type=click.IntRange(min=64), default=1600, show_default=True)
@click.option("--processes", type=click.IntRange(1, 64), help="Default: one per core.")
@click.option("--rounds", type=click.IntRange(min=1), default=3, show_default=True)
def dataset_making(out: Path, samples: int, processes: int | None, rounds: int) -> None:
    """Time how data sets are made; needs the extra [dask].

    The paper's two data sets are made by one process, by a pool, and by a Dask cluster on this
    machine, in turn; and an eighth of each straight from the scenes, through light fields in closed
    form and by traced rays, with how far apart the images are. Run it on a machine that does
    nothing else; it takes some minutes. OUT gets dataset_making.md and .json, the record.
    """
    from experiments.command_parts import step_bar
    from experiments.dataset_making.report import run_dataset_making
    from lf_flame._common.provenance import cpu_count

    processes = processes or cpu_count()
    path = run_dataset_making(samples, processes, rounds, out, step_bar)
    click.echo(set_beside(path, f"dataset_making/{path.name}"))
