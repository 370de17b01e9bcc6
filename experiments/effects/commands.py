"""The command that sets every effect beside its reference: effects."""

from pathlib import Path

import click
import cloup

from experiments.beside_reference import set_beside
from lf_flame.commands.options import FOLDER


@cloup.command()
@click.option("--out", type=FOLDER, default="results/effects", show_default=True)
def effects(out: Path) -> None:
    """Set every effect of the simulator beside a reference tracer, in minutes.

    For the paper's camera and two that were sold: what the library gives, what a slow tracer gives
    that shares no optics with it, the tracer's own error, the largest change that the effect makes,
    and the bound that the plan knew beforehand. Run it from a checkout's root: the tracer is that
    of the tests.

    OUT gets absolute.csv, .md and .json, the record.

    \b
      python -m experiments effects --out results/effects
    """  # noqa: D301 - click reads the backspace
    from experiments.command_parts import step_bar
    from experiments.effects.absolute import measure_effects
    from experiments.effects.report import write

    path = write(out, measure_effects(step_bar))
    click.echo(set_beside(path, f"effects/{path.name}"))
