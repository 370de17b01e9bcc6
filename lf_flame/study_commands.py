"""The command of `lf-flame` that runs learning studies.

As in `lf_flame.cli`, heavy modules are imported inside the command.
"""

import logging
from pathlib import Path

import click

from lf_flame.errors import InputError
from lf_flame.keras_loading import load_keras
from lf_flame.light_field_commands import FILE, FOLDER


@click.command()
@click.argument("study", type=FILE)
@click.option("--out", type=FOLDER, required=True, help="Folder for the report.")
@click.option("--work", type=FOLDER, required=True, help="Folder for data sets and runs.")
@click.option("--only", multiple=True, metavar="NAME", help="Variant to run; may be repeated.")
@click.option("--workers", default=0, show_default=True, help="Simulation; 0 = one per core.")
@click.option("--paper", type=FILE, default="experiments/paper_values.toml", show_default=True)
def study(study: Path, out: Path, work: Path, only: tuple[str, ...], workers: int, paper) -> None:
    """Train the variants of a STUDY file, and set their scores side by side.

    A variant changes a data set, a model or a recipe; experiments/studies/ shows how. Each is
    simulated, trained and scored on the same test light fields, and goes on where it was cut off;
    what is done is not done again.

    OUT gets STUDY.csv, .md, .png and .json after each variant, those still to come as missing. If
    the variants have no place on an axis, STUDY_time.csv and .png show what accuracy costs in time.
    """
    if workers < 0:
        raise InputError(f"workers must be 0 (one per core) or more, got {workers}.")
    load_keras()
    # TensorFlow finds it odd that function after function is compiled: one network a variant.
    logging.getLogger("tensorflow").setLevel(logging.ERROR)
    from lf_flame.provenance import cpu_count
    from lf_flame.report import progress_bar
    from lf_flame.studies import run_study

    text = run_study(study, out, work, paper, only, workers or cpu_count(), progress_bar)
    click.echo(text.read_text(encoding="utf-8"))
