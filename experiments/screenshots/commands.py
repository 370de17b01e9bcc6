"""The command that takes pictures of the viewer: screenshots."""

from pathlib import Path

import click
import cloup

from lf_flame.commands.options import FOLDER


@cloup.command()
@click.option("--out", type=FOLDER, default="results/screenshots", show_default=True)
def screenshots(out: Path) -> None:
    """Take pictures of the viewer's page in a headless browser.

    Needs Chromium (on Debian, apt-get install chromium-headless-shell) and the extra [test].
    """
    from experiments.screenshots.taking import take_screenshots

    for path in take_screenshots(out):
        click.echo(path)
