"""Progress bars for long work, and a line of text for work without steps.

The library shows nothing unless a program calls `show`. Most bars then appear only for work that
takes longer than `PATIENCE`, and go when it ends: bars of quick work would hide what matters.
"""

import logging
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager
from threading import Timer
from typing import Any, TypeVar

from tqdm import tqdm

T = TypeVar("T")

PATIENCE = 0.5
"""Time in seconds after which a bar or a line appears."""

report = logging.getLogger(__name__).info
"""Log a line, which programs print on standard error, above the bars."""

_program = {"shows": False}


def show(shows: bool = True) -> None:
    """Switch progress of the library's long work on or off; for programs."""
    _program["shows"] = shows


@contextmanager
def bar(
    what: str, total: int | None = None, unit: str = "step", *, stays: bool = False, **options: Any
) -> Iterator[tqdm]:
    """Progress bar to be updated by the caller, with further options of `tqdm`.

    It appears if the work exceeds `PATIENCE`, and goes at the end; or it `stays`, from the start.
    """
    shown = tqdm(
        desc=what, total=total, unit=unit, delay=0 if stays else PATIENCE, leave=stays,
        disable=total == 0 or not _program["shows"], **options,
    )  # fmt: skip
    # tqdm looks at the clock only at the end of a step, and the first may take minutes.
    with shown, _after(shown.refresh):
        yield shown


def steps(
    work: Iterable[T], what: str, total: int, unit: str = "step", *, stays: bool = False
) -> Iterator[T]:
    """Iterate over work with a `bar`."""
    with bar(what, total, unit, stays=stays) as shown:
        for step in work:
            yield step
            shown.update()


def stage(what: str, only_if: Callable[[], bool] = lambda: True) -> AbstractContextManager[None]:
    """Log what is being done if it takes longer than `PATIENCE` and `only_if` then holds."""
    return _after(lambda: report(f"{what} ...") if only_if() else None)


@contextmanager
def _after(act) -> Iterator[None]:
    timer = Timer(PATIENCE, act)
    timer.daemon = True
    if _program["shows"]:
        timer.start()
    try:
        yield
    finally:
        timer.cancel()
