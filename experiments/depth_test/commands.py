"""The command that asks networks for other depths: depth-test."""

from pathlib import Path

import click
import cloup

from experiments.beside_reference import set_beside
from experiments.command_parts import quiet_tensorflow
from lf_flame.commands.options import FOLDER
from lf_flame.learning.keras_loading import load_keras


@cloup.command("depth-test")
@click.argument("runs", nargs=-1, required=True, type=FOLDER)
@click.option("--out", type=FOLDER, default="results/depth_test", show_default=True)
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
    from experiments.command_parts import step_bar
    from experiments.depth_test.permutation import run_depth_test

    path = run_depth_test(runs, out, samples, step_bar)
    click.echo(set_beside(path, "depth_test/depth_test.md"))
