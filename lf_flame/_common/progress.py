"""Progress bars over long work."""

from collections.abc import Iterable
from typing import TypeVar

from tqdm import tqdm

T = TypeVar("T")


def progress_bar(finished: Iterable[T], done: int, total: int) -> Iterable[T]:
    """Show a bar with the time left over samples that are already done and those to come."""
    return tqdm(finished, "simulating", total, initial=done, unit="sample", smoothing=0.1)


def step_bar(finished: Iterable[T], done: int, total: int) -> Iterable[T]:
    """Show a bar over the steps of a study."""
    return tqdm(finished, "measuring", total, initial=done, unit="step")


def frame_bar(frames: Iterable[T], total: int) -> Iterable[T]:
    """Show a bar over the frames of a video."""
    return tqdm(frames, "measuring", total, unit="frame")
