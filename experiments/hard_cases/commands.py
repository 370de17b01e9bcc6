"""The command that computes hard cases three ways: hard-cases."""

from pathlib import Path

import click
import cloup

from experiments.beside_reference import set_beside
from lf_flame.commands.options import FOLDER
from lf_flame.learning.keras_loading import load_keras


@cloup.command()
@click.option("--out", type=FOLDER, default="results/hard_cases", show_default=True)
def hard_cases(out: Path) -> None:
    """Compute hard cases exactly, by the obvious formula, and by this package.

    OUT gets hard_cases.csv, .md, .png and .json, the record.
    """
    load_keras()
    from experiments.command_parts import step_bar
    from experiments.hard_cases.report import run_hard_cases

    path = run_hard_cases(out, step_bar)
    click.echo(set_beside(path, f"hard_cases/{path.name}"))
