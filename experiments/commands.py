"""Commands that measure, and write a report into a folder of results.

As in `lf_flame.commands.cli`, heavy modules are imported inside the commands. Every report is
NAME.md, tables NAME.csv, pictures NAME.png, and the record NAME.json.
"""

import logging
from dataclasses import replace
from pathlib import Path

import click
import cloup

from lf_flame.commands.options import (
    ABOVE_0,
    FILE,
    FOLDER,
    PATH,
    RUN,
    SEED,
    UsablePath,
    flag,
    option,
)
from lf_flame.learning.keras_loading import load_keras

COUNT = click.IntRange(min=1)
MARKDOWN = UsablePath(dir_okay=False, path_type=Path)


def show(report: Path) -> None:
    """Print a report that was just written."""
    click.echo(report.read_text(encoding="utf-8"))


def out_option(folder: str):
    """Make the option that names the folder of a report; its default is below ``results``."""
    return option("--out", "Folder of the report.", FOLDER, default=f"results/{folder}")


def start_networks() -> None:
    """Load Keras, without TensorFlow's messages that each network is compiled."""
    load_keras()
    logging.getLogger("tensorflow").setLevel(logging.ERROR)


@cloup.command()
@click.argument("configs", type=FILE, nargs=-1, required=True)
@option("--out", "Folder for slopes.csv, .md and .json.", FOLDER)
def slopes(configs: tuple[Path, ...], out: Path | None) -> None:
    """Search the slope of sharpest focus of each object in data-set CONFIGS.

    Printed with the slope from the camera's geometry, and the paper's. OUT also gets the paper's
    Figures 5 and 6, the objects at their depths before the camera.
    """
    from experiments.paper.evaluation import slope_report
    from lf_flame.datasets.config import read_config

    click.echo(slope_report([read_config(path) for path in configs], out))


@cloup.command()
@click.argument("run", type=FOLDER)
@option("--out", "Results folder.", FOLDER, required=True)
def evaluate(run: Path, out: Path) -> None:
    """Score the test split of a finished RUN, and write its table and figure.

    OUT gets table1.csv, .json, table1_history.csv and figure7.png; for flames table2 and figure8.
    """
    load_keras()
    from experiments.paper.evaluation import evaluate_run

    evaluate_run(run, out)


@cloup.command()
@click.argument("data", type=FOLDER)
@click.argument("config", type=FILE)
@option("--out", "Results folder.", FOLDER, required=True)
@option("--seed", "Seed of the split, in place of CONFIG's.", SEED)
def baselines(data: Path, config: Path, out: Path, seed: int | None) -> None:
    """Score the mean training image, and a ridge regression, on the test split of a DATA set.

    CONFIG is the training whose split is used. OUT gets TABLE_baselines.csv, .md and .json.
    """
    from experiments.paper.evaluation import baseline_report
    from lf_flame.learning.training_config import read_training_config

    settings = read_training_config(config)
    settings = settings if seed is None else replace(settings, seed=seed)
    click.echo(baseline_report(data, settings, out))


@cloup.command()
@click.argument("results", type=FOLDER, nargs=-1, required=True)
@option("--out", "File NAME.md; numbers and a figure are written next to it.", MARKDOWN)
def tables(results: tuple[Path, ...], out: Path | None) -> None:
    """Print Tables I and II of RESULTS folders with the paper's values.

    Runs in one folder of results that differ only in their seed are pooled.
    """
    from experiments.paper.tables import report_tables

    click.echo(report_tables(results, out))


@cloup.command()
@out_option("effects")
@option("--scenes", "Number of random scenes.", COUNT, default=40)
@option("--seed", "Seed of the random scenes.", SEED, default=0)
def effects(out: Path, scenes: int, seed: int) -> None:
    """Compare every effect with a reference tracer, and bounds with random scenes.

    For the paper's camera and two that were sold; then as many random SCENES, on which no change
    may exceed its bound. It takes minutes.
    """
    from experiments.effects.effects import run_effects

    show(run_effects(out, scenes, seed))


@cloup.command()
@out_option("hard_cases")
def hard_cases(out: Path) -> None:
    """Compute hard cases exactly, by the obvious formula, and by this package.

    OUT gets hard_cases.csv, .md, .png and .json, the record. It takes about half a minute.
    """
    from experiments.hard_cases.report import run_hard_cases

    show(run_hard_cases(out))


@cloup.command("slope-maps")
@option("--real", "Folder that may contain stilllife_3x3 and lytro_2067.", FOLDER,
        default=Path("../shared/lightfields"))  # fmt: skip
@out_option("slope_maps")
def slope_maps(real: Path, out: Path) -> None:
    """Compare the slope map, and the plainest method, with true slopes; about ten minutes.

    Real scenes first, then rendered table tops, then photographs on surfaces.
    """
    from experiments.slope_maps.measuring import measure, write

    show(write(out, *measure(real)))


EMISSION = "planes", "round", "soot", "measured", "bars"


@cloup.command()
@out_option("emission")
@option("--part", "Part to measure; a report in OUT keeps its other parts.",
        click.Choice([*EMISSION, "all"]), default="all")  # fmt: skip
@option("--seed", "Seed of the noise.", SEED, default=1)
def emission(out: Path, part: str, seed: int) -> None:
    """Measure emission by depth, axisymmetric flames and soot temperature on traced flames.

    planes: flames behind each other and thick flames. round: an axisymmetric flame. soot:
    temperature from one raw image. measured: the same of two flames after published tables. bars:
    how often error bars cover the truth. Simple methods are measured, too.
    """
    from experiments.emission.report import run

    show(run(out, list(EMISSION) if part == "all" else [part], seed))


@cloup.command()
@click.argument("runs", type=RUN)
@out_option("compare")
@option("--data", "Data set to refocus (default: the paper's two); may be repeated.",
        FILE, multiple=True)  # fmt: skip
@option("--light-fields", "Number of light fields in a test set.", COUNT, default=8)
@option("--photograph photographs", "Light field, and slopes such as -1,0,1; may be repeated.",
        (PATH, str), multiple=True, metavar="LIGHT_FIELD SLOPES")  # fmt: skip
@option("--refocusnet-weights", "The authors' trained weights (.npz).", FILE)
def compare(runs, out, data, light_fields, photographs, refocusnet_weights) -> None:
    """Compare refocusing systems: accuracy, views, training, time and memory.

    RUNS contains the networks of `lf-flame train-system` and `make tables`; the table names missing
    ones. Test sets are light fields that no network was trained on, the same scenes with their
    objects at other depths, and photographs. The reference is shift-and-sum of all views. Run it on
    a machine that does nothing else.
    """
    start_networks()
    from experiments.systems.compared import select_entries, select_sets
    from experiments.systems.comparison import run_comparison

    test_sets = select_sets(runs, data, light_fields, photographs)
    show(run_comparison(select_entries(runs, refocusnet_weights), test_sets, out))


@cloup.command()
@click.argument("study", type=FILE)
@out_option("studies")
@option("--work", "Folder for data sets and runs.", FOLDER, default="runs/studies")
@option("--workers", "Number of processes that simulate; 0: one per core.", SEED, default=0)
def study(study: Path, out: Path, work: Path, workers: int) -> None:
    """Compare the variants of a STUDY file on the same test samples.

    experiments/studies/ shows what a variant may change. With a preset a network is trained for
    each. The command resumes where it was stopped, and reports after each variant.
    """
    start_networks()
    from experiments.studies.study import run_study
    from lf_flame._common.provenance import cpu_count

    show(run_study(study, out, work, workers or cpu_count()))


@cloup.command("depth-test")
@click.argument("folders", nargs=-1, required=True, type=FOLDER)
@out_option("depth_test")
@option("--samples", "Number of scenes for each scenario.", COUNT, default=16)
def depth_test(folders: tuple[Path, ...], out: Path, samples: int) -> None:
    """Test whether networks, and the ridge regression, see depth or have memorised it.

    FOLDERS are runs of `lf-flame train`, or data sets (.zarr) for the regression alone, all of the
    same kind of scenes. Here objects exchange their depths, all move, or one is alone.
    """
    start_networks()
    from experiments.depth_test.permutation import run_depth_test

    show(run_depth_test(folders, out, samples))


@cloup.command()
@out_option("costs")
@option("--chapter", "What to measure.", click.Choice(["all", "simulation", "refocusing"]),
        default="all")  # fmt: skip
@option("--budget-s", "Seconds for the methods of integration.", ABOVE_0, default=150.0)
@option("--run", "Folder of trained networks, RUN/shapes and RUN/flames.", FOLDER,
        default="runs/paper")  # fmt: skip
def costs(out: Path, chapter: str, budget_s: float, run: Path) -> None:
    """Measure what accuracy costs in time, on a machine that does nothing else.

    Simulation: error against seconds for each method of integration, and what each effect adds, on
    one thread. Refocusing: SSIM and PSNR against the exact result over milliseconds, on all cores.
    """
    from experiments.costs import rendering

    if chapter != "refocusing":
        show(rendering.write(out, rendering.measure_costs(budget_s)))
    if chapter != "simulation":
        load_keras()
        from experiments.costs import refocusing

        show(refocusing.write(out, refocusing.measure_refocusing(run)))


@cloup.command()
@out_option("bench")
@flag("--small", "Small inputs, to try the command.")
def bench(out: Path, small: bool) -> None:
    """Time refocusing, decoding, rendering and training against floors and rivals.

    Run it on a machine that does nothing else. Outputs are compared, too.
    """
    start_networks()
    from experiments.bench import measure, write

    show(write(out, measure(small)))
