"""Parts that commands of several experiments share."""

import logging
from collections.abc import Iterable
from pathlib import Path
from typing import TypeVar

import click
from tqdm import tqdm

T = TypeVar("T")


class PlainName(click.ParamType):
    """The name of a file, not a path, in a folder that another option names."""

    name = "name"

    def convert(self, value, param, ctx):
        """Refuse an empty name, or a path."""
        if value != Path(value).name or not value.strip(" .") or "\0" in value:
            self.fail(f"{value!r} is no plain name of a file.", param, ctx)
        return value


def step_bar(steps: Iterable[T], total: int | None = None, done: int = 0) -> Iterable[T]:
    """Progress bar over steps, of which some may be done; `total` where they have no length."""
    return tqdm(steps, "measuring", total, initial=done, unit="step")


def quiet_tensorflow() -> None:
    """Suppress TensorFlow's messages that each network is compiled."""
    logging.getLogger("tensorflow").setLevel(logging.ERROR)
