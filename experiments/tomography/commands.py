"""The command that measures how well emission by depth is found: emission."""

import time
from pathlib import Path

import click
import cloup

from experiments.beside_reference import set_beside
from lf_flame.commands.options import FOLDER, RUN


@cloup.command()
@click.option("--out", type=FOLDER, default="results/tomography", show_default=True)
@click.option("--seed", default=1, show_default=True, help="Of the noise.")
@click.option(
    "--network",
    "networks",
    type=RUN,
    multiple=True,
    help="Run of the paper's network on its flames, whose planes are taken for sections; may be "
    "repeated.",
)
def emission(out: Path, seed: int, networks: tuple[Path, ...]) -> None:
    """Find emission by depth in phantoms of known emission, in minutes.

    The paper's four flames at known depths, flames behind each other, at unknown depths, a flame
    that is round in depth, flames that absorb, and a camera that is not as was said; with refocused
    images, a fit cut off at zero and plain gradient steps as rivals. A round flame's half section,
    with PyAbel as the rival where it is installed. The paper's network, where runs of it are given.

    OUT gets emission.csv, .md and .json, the record, and pictures.

    \b
      python -m experiments emission --network runs/paper/flames
    """  # noqa: D301 - click reads the backspace
    from functools import partial

    import numpy as np

    from experiments.tomography.report import write_report
    from experiments.tomography.round_flames import round_flame
    from experiments.tomography.tasks import TASKS, networks_as_sections
    from lf_flame._common.progress import step_bar

    begin, rows = time.perf_counter(), []
    rng = np.random.default_rng(seed)
    tasks = [*TASKS, round_flame, partial(networks_as_sections, networks)]
    for task in step_bar(tasks, 0, len(tasks)):
        rows += list(task(rng))
    path = write_report(out, rows, time.perf_counter() - begin)
    click.echo(set_beside(path, f"tomography/{path.name}"))
