"""Parts that commands of several experiments share."""

import logging
from collections.abc import Iterable
from typing import TypeVar

from tqdm import tqdm

T = TypeVar("T")


def step_bar(steps: Iterable[T], total: int | None = None, done: int = 0) -> Iterable[T]:
    """Show a progress bar over steps, `done` of them before; `total` if they have no length."""
    return tqdm(steps, "measuring", total, initial=done, unit="step")


def quiet_tensorflow() -> None:
    """Suppress TensorFlow's messages that each network is compiled."""
    logging.getLogger("tensorflow").setLevel(logging.ERROR)
