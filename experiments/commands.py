"""Commands that measure, and write a report into a folder of results: bounds to latency.

As in `lf_flame.commands.cli`, heavy modules are imported inside the commands.
"""

from pathlib import Path

import click
import cloup

from experiments.beside_reference import show
from experiments.command_parts import quiet_tensorflow
from experiments.paths import PAPER_VALUES
from lf_flame.commands.options import FILE, FOLDER, PATH
from lf_flame.errors import InputError
from lf_flame.learning.keras_loading import load_keras


def out_option(folder: str):
    """Make the option that names the folder of a report; its default is below ``results``."""
    return click.option("--out", type=FOLDER, default=f"results/{folder}", show_default=True)


@cloup.command()
@out_option("bounds")
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
    from lf_flame._common.provenance import cpu_count

    show(run_bounds(scenes, seed, out, workers or cpu_count()), "bounds")


@cloup.command("dataset-making")
@out_option("dataset_making")
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
    from experiments.dataset_making.report import run_dataset_making
    from lf_flame._common.provenance import cpu_count

    processes = processes or cpu_count()
    show(run_dataset_making(samples, processes, rounds, out), "dataset_making")


@cloup.command()
@out_option("emission")
@click.option(
    "--part",
    type=click.Choice(["planes", "round", "soot", "bars", "all"]),
    default="all",
    show_default=True,
    help="Part to measure; a report in OUT keeps its other parts.",
)
@click.option("--seed", default=1, show_default=True, help="Seed of the noise.")
def emission(out: Path, part: str, seed: int) -> None:
    """Measure emission by depth, axisymmetric flames and soot temperature on traced flames.

    planes: flames behind each other and thick flames, with refocused images, their deconvolution,
    SART and LSQR beside the fit. round: an axisymmetric flame, with onion peeling and, where it is
    installed, PyAbel. soot: temperature from one raw image of a colour camera. bars: how often
    error bars cover the truth. All together take half an hour on two cores. OUT gets emission.md,
    .csv and .json, the record, and two pictures.
    """
    from experiments.emission.report import run

    parts = ["planes", "round", "soot", "bars"] if part == "all" else [part]
    click.echo(run(out, parts, seed).read_text(encoding="utf-8"))


@cloup.command("depth-test")
@click.argument("runs", nargs=-1, required=True, type=FOLDER)
@out_option("depth_test")
@click.option("--samples", default=16, show_default=True, help="Scenes for each scenario.")
def depth_test(runs: tuple[Path, ...], out: Path, samples: int) -> None:
    """Test whether trained networks see depth, or have memorised it.

    In training every object stands at a depth of its own. Here two change places, all move, or one
    stands alone, scaled so that the central view stays as it was. Shift-and-sum is the reference; a
    network that has memorised the depths draws what is no longer there.

    RUNS are run folders of `lf-flame train` that were trained on the same kind of scenes. OUT gets
    depth_test.csv, .md, .png and .json, and a picture of each scenario.

    \b
      python -m experiments depth-test runs/closed-form/flames
    """  # noqa: D301 - click reads the backspace
    load_keras()
    quiet_tensorflow()
    from experiments.depth_test.permutation import run_depth_test

    show(run_depth_test(runs, out, samples), "depth_test")


@cloup.command()
@out_option("effects")
def effects(out: Path) -> None:
    """Set every effect of the simulator beside a reference tracer, in minutes.

    For the paper's camera and two that were sold: what the library gives, what a slow tracer gives
    that shares no optics with it, the tracer's own error, the largest change that the effect makes,
    and the bound that the plan knew beforehand. Run it from a checkout's root: the tracer is that
    of the tests.

    OUT gets absolute.csv, .md and .json, the record.
    """
    from experiments.effects.absolute import measure_effects
    from experiments.effects.report import write

    show(write(out, measure_effects()), "effects")


@cloup.command()
@out_option("hard_cases")
def hard_cases(out: Path) -> None:
    """Compute hard cases exactly, by the obvious formula, and by this package.

    OUT gets hard_cases.csv, .md, .png and .json, the record.
    """
    load_keras()
    from experiments.hard_cases.report import run_hard_cases

    show(run_hard_cases(out), "hard_cases")


@cloup.command()
@out_option("screenshots")
@click.option("--jupyter", type=FILE, help="JupyterLab's program (default: that on the PATH).")
def screenshots(out: Path, jupyter: Path | None) -> None:
    """Take pictures of the viewer, in a headless browser.

    Needs Chromium (on Debian, apt-get install chromium-headless-shell) and the extra [test]. The
    picture of a notebook needs JupyterLab, which is large, and may stand in an environment of its
    own; lf_flame is installed there too:

    \b
      python -m venv .venv-jupyter
      .venv-jupyter/bin/pip install jupyterlab '.[jupyter]'
      python -m experiments screenshots --jupyter .venv-jupyter/bin/jupyter-lab
    """  # noqa: D301 - click reads the backspace
    from experiments.screenshots.notebook import find_jupyter
    from experiments.screenshots.taking import take_screenshots

    jupyter = jupyter or find_jupyter()
    if jupyter is None:
        click.echo("There is no JupyterLab: no picture of a notebook is taken.", err=True)
    for path in take_screenshots(out, jupyter):
        click.echo(path)


@cloup.command("slope-maps")
@out_option("slope_maps")
def slope_maps(out: Path) -> None:
    """Compare the slope map, and three plain methods, with the truth, in minutes.

    On photographs on slanted, curved, thin, occluding, shadowed and glossy surfaces, with noise,
    JPEG and uneven views; the true slopes follow from the geometry.

    OUT gets slope_maps.csv, .md, .png and .json, the record.
    """
    from experiments.slope_maps.measuring import measure
    from experiments.slope_maps.report import write

    show(write(out, *measure()), "slope_maps")


@cloup.command()
@click.argument("study", type=FILE)
@out_option("studies")
@click.option(
    "--work", type=FOLDER, default="runs/studies", show_default=True,
    help="Folder for data sets and runs.",
)  # fmt: skip
@click.option("--only", multiple=True, metavar="NAME", help="Variant to run; may be repeated.")
@click.option("--workers", default=0, show_default=True, help="Simulation; 0 = one per core.")
@click.option(
    "--imagenet", type=FILE, help="Weights where a variant asks for ImageNet's (default: Keras's)."
)
@click.option(
    "--paper", type=FILE, default=PAPER_VALUES, show_default="experiments/paper_values.toml"
)
def study(
    study: Path, out: Path, work: Path, only: tuple[str, ...], workers: int, imagenet, paper
) -> None:
    """Train the variants of a STUDY file, and set their scores side by side.

    A variant changes a data set, a model or a recipe; experiments/studies/ shows how. Each is
    simulated, trained and scored on the same test light fields, and goes on where it was cut off;
    what is done is not done again.

    OUT gets STUDY.csv, .md, .png and .json after each variant, those still to come as missing. Of
    a study that is timed, STUDY_time.csv and .png show what accuracy costs in time.
    """
    if workers < 0:
        raise InputError(f"workers must be 0 (one per core) or more, got {workers}.")
    load_keras()
    quiet_tensorflow()
    from experiments.studies.study import run_study
    from lf_flame._common.provenance import cpu_count

    crew = workers or cpu_count()
    path = run_study(study, out, work, paper, only=only, workers=crew, imagenet=imagenet)
    show(path, "costs" if "costs" in path.stem else "studies")


@cloup.command()
@out_option("costs")
@click.option(
    "--chapter", type=click.Choice(["all", "simulation", "refocusing"]), default="all",
    show_default=True,
)  # fmt: skip
@click.option(
    "--budget-s", default=420.0, show_default=True,
    help="Seconds for the methods of integration; effects take a minute or two on top.",
)  # fmt: skip
@click.option(
    "--run", type=FOLDER, default="runs/closed-form", show_default=True,
    help="Folder of trained networks, RUN/shapes and RUN/flames, to set beside refocusing.",
)  # fmt: skip
def costs(out: Path, chapter: str, budget_s: float, run: Path) -> None:
    """Measure what accuracy costs in time; run it on a machine that does nothing else.

    Simulation: error against seconds for each method of integration, on the shape scene, a flame
    and an occluding scene; for each effect the seconds that it adds and the error of leaving it
    out. On one thread.

    Refocusing: SSIM and PSNR against the exact result over milliseconds, for each interpolation,
    for fewer views, for light fields stored in fewer bits, in the Fourier domain, and for the
    trained networks. On all cores, in two or three minutes.
    """
    from experiments.costs import rendering_report
    from experiments.costs.rendering import measure_costs

    if not budget_s > 0:
        raise InputError(f"budget-s must be above 0 seconds, got {budget_s}.")
    if chapter != "refocusing":
        show(rendering_report.write_reports(out, measure_costs(budget_s)), "costs")
    if chapter != "simulation":
        load_keras()
        from experiments.costs import refocusing_report
        from experiments.costs.refocusing import measure_refocusing

        show(refocusing_report.write(out, measure_refocusing(run)), "costs")


@cloup.command()
@click.argument("networks", type=PATH, nargs=-1, required=True)
@out_option("costs")
@click.option("--repeats", default=30, show_default=True, help="Rounds that count; 3 or more.")
@click.option(
    "--seed", type=click.IntRange(min=0), default=0, show_default=True,
    help="Seed of the random raw image.",
)  # fmt: skip
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
    from experiments.costs import latency_report
    from experiments.costs.latency import measure_latency

    show(latency_report.write(out, measure_latency(networks, repeats, seed)), "costs")
