"""What the benchmarks share: times taken in turn, and the files of a table."""

import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pandas as pd

from lf_flame.files import write_json, write_text

MOST_CALLS_IN_A_TURN = 100


def seconds(call: Callable) -> float:
    """Time that one call takes."""
    started = time.perf_counter()
    call()
    return time.perf_counter() - started


def best_of(rounds: int, *calls: Callable) -> list[float]:
    """Shortest times of some calls, in seconds, made in turn after one round of warming up."""
    return best_times(rounds, 0.0, [partial(seconds, call) for call in calls])


def best_times(rounds: int, turn_s: float, clocks: list[Callable[[], float]]) -> list[float]:
    """Shortest times of calls that time themselves, in turn after one round of warming up.

    A call is repeated until its turn has lasted `turn_s`, so that a short one is not always timed
    with the caches that a long one has left.
    """
    times = [[] for _ in clocks]
    for round_ in range(rounds + 1):
        for clock, found in zip(clocks, times, strict=True):
            shortest = _turn(clock, turn_s)
            if round_:
                found.append(shortest)
    return [min(found) for found in times]


def _turn(clock: Callable[[], float], turn_s: float) -> float:
    found = [clock()]
    while sum(found) < turn_s and len(found) < MOST_CALLS_IN_A_TURN:
        found.append(clock())
    return min(found)


def write_table(
    stem: Path,
    title: str,
    table: pd.DataFrame,
    formats: tuple,
    record: dict,
    missing: str = "nan",
    notes: str = "",
) -> None:
    """Write a table as Markdown, CSV and, with the record of its making, JSON; print the first."""
    known = table.astype(object).where(table.notna(), None)
    text = (
        f"### {title}\n\n"
        + known.to_markdown(index=False, floatfmt=formats, missingval=missing)
        + f"\n\n{notes}Best of some rounds in turn; {record['machine']}, revision "
        f"{record['git_revision']}. Command: `make benchmarks`.\n"
    )
    write_text(stem.with_suffix(".md"), text)
    write_text(stem.with_suffix(".csv"), table.to_csv(index=False))
    write_json(stem.with_suffix(".json"), {**record, "rows": known.to_dict("records")})
    sys.stdout.write(text)
