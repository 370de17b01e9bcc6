"""The commands of `lf-flame` that study what networks learn: study and swap-test.

As in `lf_flame.commands.cli`, heavy modules are imported inside the command.
"""

import logging
from pathlib import Path

import click

from lf_flame._common.keras_loading import load_keras
from lf_flame.commands.light_fields import FILE, FOLDER
from lf_flame.errors import InputError


@click.command()
@click.argument("study", type=FILE)
@click.option("--out", type=FOLDER, required=True, help="Folder for the report.")
@click.option("--work", type=FOLDER, required=True, help="Folder for data sets and runs.")
@click.option("--only", multiple=True, metavar="NAME", help="Variant to run; may be repeated.")
@click.option("--workers", default=0, show_default=True, help="Simulation; 0 = one per core.")
@click.option(
    "--imagenet", type=FILE, help="Weights where a variant asks for ImageNet's (default: Keras's)."
)
@click.option("--paper", type=FILE, default="experiments/paper_values.toml", show_default=True)
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
    # TensorFlow finds it odd that function after function is compiled: one network a variant.
    logging.getLogger("tensorflow").setLevel(logging.ERROR)
    from experiments.recipes.study import run_study
    from lf_flame._common.progress import progress_bar
    from lf_flame._common.provenance import cpu_count

    workers = workers or cpu_count()
    text = run_study(study, out, work, paper, only, workers, progress_bar, imagenet)
    click.echo(text.read_text(encoding="utf-8"))


@click.command("swap-test")
@click.argument("runs", nargs=-1, required=True, type=FOLDER)
@click.option("--out", type=FOLDER, required=True, help="Folder for the report.")
@click.option("--samples", default=16, show_default=True, help="Scenes for each case.")
def swap_test(runs: tuple[Path, ...], out: Path, samples: int) -> None:
    """Test whether trained networks see depth, or know it by heart.

    In training every object stands at a depth of its own. Here two change places, all move, or one
    stands alone, scaled so that the central view stays as it was. Shift-and-sum is right by
    construction; a network that has learnt the depths by heart draws what is no longer there.

    RUNS are run folders of `lf-flame train` that were trained on the same kind of scenes. OUT gets
    swap_test.csv, .md, .png and .json, and a picture of each case.

    \b
      lf-flame swap-test runs/quick/flames --out swap
    """  # noqa: D301 - click reads the backspace
    load_keras()
    logging.getLogger("tensorflow").setLevel(logging.ERROR)
    from experiments.depth_test.permutation import run_swap_test
    from lf_flame._common.progress import step_bar

    click.echo(run_swap_test(runs, out, samples, step_bar).read_text(encoding="utf-8"))
