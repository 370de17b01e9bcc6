"""The command that trains variants and sets them side by side: study.

As in `lf_flame.commands.cli`, heavy modules are imported inside the command.
"""

from pathlib import Path

import click
import cloup

from experiments.beside_reference import set_beside
from experiments.command_parts import quiet_tensorflow
from experiments.paths import PAPER_VALUES
from lf_flame.commands.options import FILE, FOLDER
from lf_flame.errors import InputError
from lf_flame.learning.keras_loading import load_keras


@cloup.command()
@click.argument("study", type=FILE)
@click.option("--out", type=FOLDER, default="results/studies", show_default=True)
@click.option(
    "--work",
    type=FOLDER,
    default="runs/studies",
    show_default=True,
    help="Folder for data sets and runs.",
)
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
    from lf_flame._common.progress import progress_bar
    from lf_flame._common.provenance import cpu_count

    workers = workers or cpu_count()
    text = run_study(study, out, work, paper, only, workers, progress_bar, imagenet)
    kind = "costs" if "costs" in text.stem else "studies"
    click.echo(set_beside(text, f"{kind}/{text.name}"))
