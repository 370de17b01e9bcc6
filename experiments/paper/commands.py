"""Commands for the paper's tables: slopes, evaluate and tables."""

from pathlib import Path

import click
import cloup

from experiments.beside_reference import set_beside
from experiments.command_parts import PlainName
from experiments.paths import PAPER_VALUES
from lf_flame.commands.options import FILE, FOLDER, UsablePath
from lf_flame.learning.keras_loading import load_keras


@cloup.command()
@click.argument("configs", type=FILE, nargs=-1, required=True)
@click.option(
    "--paper", type=FILE, default=PAPER_VALUES, show_default="experiments/paper_values.toml"
)
@click.option("--out", type=FOLDER, help="Folder for slopes.csv, .md, .json and .png.")
def slopes(configs: tuple[Path, ...], paper: Path, out: Path | None) -> None:
    """Search the slope of sharpest focus of each object in data-set CONFIGS.

    Printed beside the slope that the camera's geometry gives and the paper's.
    """
    from experiments.paper.slopes import slope_report
    from lf_flame.datasets.config import read_config

    text = slope_report([read_config(path) for path in configs], paper, out)
    click.echo(set_beside(out / "slopes.md", "paper/slopes.md") if out else text)


@cloup.command()
@click.argument("run", type=FOLDER)
@click.option("--table", required=True, type=click.Choice(["table1", "table2"]))
@click.option(
    "--figure",
    type=PlainName(),
    required=True,
    help="Name of the figure's PNG file, without its ending.",
)
@click.option(
    "--paper", type=FILE, default=PAPER_VALUES, show_default="experiments/paper_values.toml"
)
@click.option("--out", type=FOLDER, required=True, help="Results folder.")
def evaluate(run: Path, table: str, figure: str, paper: Path, out: Path) -> None:
    """Score the test split of a finished RUN and write its table and figure."""
    load_keras()
    from experiments.paper.tables import evaluate_run

    evaluate_run(run, table, figure, paper, out)


@cloup.command()
@click.argument("results", type=FOLDER, nargs=-1, required=True)
@click.option(
    "--paper", type=FILE, default=PAPER_VALUES, show_default="experiments/paper_values.toml"
)
@click.option(
    "--out",
    type=UsablePath(dir_okay=False, path_type=Path),
    help="Keep this in an .md file; numbers in a .csv, the learning in a .png beside.",
)
def tables(results: tuple[Path, ...], paper: Path, out: Path | None) -> None:
    """Print Tables I and II of RESULTS folders; a run that is missing shows as missing.

    Several folders are set side by side; runs of one recipe that differ in their seed alone are
    pooled into mean and standard deviation over the seeds.
    """
    from experiments.paper.comparison import report_tables

    click.echo(report_tables(results, paper, out))
