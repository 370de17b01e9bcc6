"""The command that takes pictures of the viewer: screenshots."""

from pathlib import Path

import click
import cloup

from lf_flame.commands.options import FILE, FOLDER


@cloup.command()
@click.option("--out", type=FOLDER, default="results/screenshots", show_default=True)
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
