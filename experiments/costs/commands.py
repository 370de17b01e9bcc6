"""Commands for what accuracy costs in time: costs and latency."""

from pathlib import Path

import click
import cloup

from experiments.beside_reference import set_beside
from experiments.command_parts import quiet_tensorflow
from lf_flame.commands.options import FOLDER, PATH
from lf_flame.errors import InputError
from lf_flame.learning.keras_loading import load_keras


@cloup.command()
@click.option("--out", type=FOLDER, default="results/costs", show_default=True)
@click.option(
    "--chapter",
    type=click.Choice(["all", "simulation", "refocusing"]),
    default="all",
    show_default=True,
)
@click.option(
    "--budget-s",
    default=420.0,
    show_default=True,
    help="Seconds for the methods of integration; effects take a minute or two on top.",
)
@click.option(
    "--run",
    type=FOLDER,
    default="runs/closed-form",
    show_default=True,
    help="Folder of trained networks, RUN/shapes and RUN/flames, to set beside refocusing.",
)
def costs(out: Path, chapter: str, budget_s: float, run: Path) -> None:
    """Measure what accuracy costs in time; run it on a machine that does nothing else.

    Simulation: error against seconds for each method of integration, on the shape scene, a flame
    and an occluding scene; for each effect the seconds that it adds and the error of leaving it
    out. On one thread.

    Refocusing: SSIM and PSNR against the exact result over milliseconds, for each interpolation,
    for fewer views, for light fields stored in fewer bits, in the Fourier domain, and for the
    trained networks. On all cores, in two or three minutes.
    """
    from experiments.command_parts import step_bar
    from experiments.costs import rendering_report
    from experiments.costs.rendering import measure_costs

    if not budget_s > 0:
        raise InputError(f"budget-s must be above 0 seconds, got {budget_s}.")
    if chapter != "refocusing":
        path = rendering_report.write_reports(out, measure_costs(step_bar, budget_s))
        click.echo(set_beside(path, f"costs/{path.name}"))
    if chapter != "simulation":
        load_keras()
        from experiments.costs import refocusing_report
        from experiments.costs.refocusing import measure_refocusing

        path = refocusing_report.write(out, measure_refocusing(run, step_bar))
        click.echo(set_beside(path, f"costs/{path.name}"))


@cloup.command()
@click.argument("networks", type=PATH, nargs=-1, required=True)
@click.option("--out", type=FOLDER, default="results/costs", show_default=True)
@click.option("--repeats", default=30, show_default=True, help="Rounds that count; 3 or more.")
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    default=0,
    show_default=True,
    help="Seed of the random raw image.",
)
def latency(networks: tuple[Path, ...], out: Path, repeats: int, seed: int) -> None:
    """Time trained NETWORKS on one picture; run it on a machine that does nothing else.

    A NETWORK is a run folder, or a .keras file that `lf-flame export` wrote. The clock runs from a
    raw lenslet image in memory, of the size of the network's camera, to the refocused images:
    stage by stage (resize, backbone, decoder) and in one go, at batch 1.

    Each network is timed in float32, bfloat16 and float16, and with its dense layers in int8 (Keras
    has no convolutions in int8), compiled by each compiler that the backend has. Fewer bits cost
    accuracy: beside each time stands how far the images are from float32's (PSNR in dB, higher is
    closer), and from the truth where a run folder names its test split. What this machine cannot do
    shows as missing, with the reason. Fewer bits need not be faster: that takes a processor, and a
    library, with arithmetic for them.

    The floor is the time to read weights and raw image once, at the bandwidth measured meanwhile.

    OUT gets latency.csv, .md, .png and .json, the record.

    \b
      python -m experiments latency runs/closed-form/flames --out latency
      python -m experiments latency flames.keras runs/closed-form/shapes --out latency --repeats 100
    """  # noqa: D301 - click reads the backspace
    load_keras()
    quiet_tensorflow()
    from experiments.command_parts import step_bar
    from experiments.costs import latency_report
    from experiments.costs.latency import measure_latency

    path = latency_report.write(out, measure_latency(networks, repeats, seed, step_bar))
    click.echo(set_beside(path, f"costs/{path.name}"))
