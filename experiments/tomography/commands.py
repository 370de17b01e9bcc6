"""The command that measures how well emission by depth is found: emission."""

import time
from pathlib import Path

import click
import cloup

from experiments.beside_reference import set_beside
from lf_flame.commands.options import FOLDER


@cloup.command()
@click.option("--out", type=FOLDER, default="results/tomography", show_default=True)
@click.option("--seed", default=1, show_default=True, help="Of the noise.")
def emission(out: Path, seed: int) -> None:
    """Find emission by depth in phantoms of known emission, in minutes.

    The paper's four flames at known depths, flames behind each other, at unknown depths, a flame
    that is round in depth, flames that absorb, and a camera that is not as was said; with refocused
    images, a fit cut off at zero and plain gradient steps as rivals.

    OUT gets emission.csv, .md and .json, the record, sheets.png and volume.png.

    \b
      python -m experiments emission --out results/tomography
    """  # noqa: D301 - click reads the backspace
    import numpy as np

    from experiments.tomography.report import write_report
    from experiments.tomography.tasks import TASKS
    from lf_flame._common.progress import step_bar

    begin, rows = time.perf_counter(), []
    rng = np.random.default_rng(seed)
    for task in step_bar(TASKS, 0, len(TASKS)):
        rows += list(task(rng))
    path = write_report(out, rows, time.perf_counter() - begin)
    click.echo(set_beside(path, f"tomography/{path.name}"))
