"""Options and arguments that several commands share."""

from pathlib import Path

import click

FILE = click.Path(exists=True, dir_okay=False, path_type=Path)
FOLDER = click.Path(file_okay=False, path_type=Path)
RUN = click.Path(exists=True, file_okay=False, path_type=Path)
PATH = click.Path(path_type=Path)

HELP = {"help_option_names": ["-h", "--help"], "max_content_width": 100}
"""Settings of a program's outermost group."""


def quiet_tensorflow() -> None:
    """Keep TensorFlow from remarking that network after network is compiled."""
    import logging

    logging.getLogger("tensorflow").setLevel(logging.ERROR)
