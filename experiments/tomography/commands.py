"""Commands that measure how well emission by depth is found: emission, rivals, soot."""

import time
from pathlib import Path

import click
import cloup

from experiments.beside_reference import show
from lf_flame.commands.options import FOLDER, RUN


@cloup.command()
@click.option("--out", type=FOLDER, default="results/tomography", show_default=True)
@click.option("--seed", default=1, show_default=True, help="Of the noise.")
@click.option(
    "--network",
    "networks",
    type=RUN,
    multiple=True,
    help="Instead of all that: take the planes of this run of the paper's network on its "
    "flames for sections; may be repeated.",
)
@click.option(
    "--bars",
    type=click.IntRange(min=2),
    help="Instead of all that: count how often error bars hold the truth in so many draws of the "
    "noise, six kinds of each.",
)
def emission(out: Path, seed: int, networks: tuple[Path, ...], bars: int | None) -> None:
    """Find emission by depth in phantoms of known emission, in minutes.

    The paper's four flames at known depths, flames behind each other, at unknown depths, a flame
    that is round in depth, flames that absorb, and a camera that is not as was said; with refocused
    images and a fit cut off at zero as rivals (more: rivals). A round flame's half section,
    with PyAbel as the rival where it is installed. Soot in two colours, and a video at full size.

    OUT gets emission.csv, .md and .json, the record, and pictures; with --network, networks.csv,
    .md and .json; with --bars, bars.csv, .md and .json.

    \b
      python -m experiments emission --network runs/paper/flames
      python -m experiments emission --bars 50
    """  # noqa: D301 - click reads the backspace
    from functools import partial

    import numpy as np

    from experiments.command_parts import step_bar
    from experiments.tomography.bands import count_held
    from experiments.tomography.colours import two_colours
    from experiments.tomography.networks import networks_as_sections
    from experiments.tomography.report import BARS, EMISSION, NETWORKS, write
    from experiments.tomography.round_flames import round_flame
    from experiments.tomography.tasks import TASKS
    from experiments.tomography.video import video

    begin, rows = time.perf_counter(), []
    rng = np.random.default_rng(seed)
    tasks = [*TASKS, round_flame, two_colours, video]
    name = BARS if bars else NETWORKS if networks else EMISSION
    if name != EMISSION:
        tasks = [partial(count_held, bars) if bars else partial(networks_as_sections, networks)]
    for task in step_bar(tasks):
        rows += list(task(rng))
    seconds = time.perf_counter() - begin
    show(write(out, name, rows, seconds), "tomography")


@cloup.command()
@click.option("--out", type=FOLDER, default="results/tomography", show_default=True)
@click.option("--seed", default=1, show_default=True, help="Of the noise.")
@click.option(
    "--draws",
    type=click.IntRange(min=2),
    default=50,
    show_default=True,
    help="Draws of the noise over which error bars are held against the truth.",
)
def soot(out: Path, seed: int, draws: int) -> None:
    """Find temperatures of sooty flames from one raw image of a colour camera.

    The raw images, of a camera with a round lens and colour filters, are traced by rays that share
    nothing with the reconstruction; flames are hollow, thin, thick, full, and deeper than wide. A
    furnace calibrates the colours. OUT gets soot.md, .json, the record, and a picture; it takes
    some minutes, and a quarter of an hour for 50 draws.
    """
    from experiments.tomography.soot import run_soot

    show(run_soot(out, seed, draws), "tomography")


@cloup.command()
@click.option("--out", type=FOLDER, default="results/tomography", show_default=True)
@click.option("--seed", default=1, show_default=True, help="Of the noise.")
def rivals(out: Path, seed: int) -> None:
    """Set SART, MLEM, LSQR, NNLS and total variation beside the penalised fit.

    On flames traced by rays that share nothing with them: sheets behind each other, on the planes,
    off them, and of a camera with a wrong pitch; sharp edges; a hollow and an elliptic flame; and a
    printed profile, beside printed errors. OUT gets rivals.csv, .md, .json, the record, and a
    picture; it takes some minutes.
    """
    from experiments.tomography.rivals import run_rivals

    show(run_rivals(out, seed), "tomography")
