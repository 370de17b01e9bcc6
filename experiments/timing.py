"""Seconds of calls made in turn, the bandwidth of memory, and the memory of a process."""

import resource
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from experiments import _kernels

ROUNDS, SHORT_S, LONG_S = 3, 0.3, 5.0
"""Usual rounds: this number; more until SHORT_S have passed, none that begins after LONG_S."""

BLOCK = (256, 2**18)
"""Rows and float32 elements of what is read to measure the bandwidth: 256 MiB, beyond caches."""

READINGS = 20

MOST_CALLS_IN_A_TURN = 100


@dataclass(frozen=True)
class Times:
    """Times of calls that were made in turn.

    `seconds` has the shape (calls, rounds), `results` hold what each call returned the last time,
    and `every` all times of each call, where calls are repeated in their turn.
    """

    seconds: np.ndarray
    results: list
    every: list

    @property
    def best(self) -> np.ndarray:
        """Shortest time of each call."""
        return self.seconds.min(axis=1)

    @property
    def spread(self) -> np.ndarray:
        """Distance of the lower quartile of each call from its shortest time, in seconds."""
        return np.percentile(self.seconds, 25, axis=1) - self.best

    def ratio(self, call: int, other: int) -> tuple[float, float, float]:
        """Time of a call over that of another in the same round: median and quartiles."""
        ratios = self.seconds[call] / self.seconds[other]
        median, low, high = np.percentile(ratios, (50, 25, 75)).tolist()
        return median, low, high


def in_turn(
    *calls: Callable[[], Any],
    rounds: int | None = None,
    least_s: float | None = None,
    turn_s: float = 0.0,
    warm_up: bool = True,
    timed: bool = False,
) -> Times:
    """Time calls in turn, round by round, so that other load on the machine hits all alike.

    At least so many rounds go on for `least_s` seconds; by default `ROUNDS` and `SHORT_S`, but for
    fewer where they take longer than `LONG_S`. In its turn a call is repeated for `turn_s` seconds,
    the shortest time counting: a short call is then not always timed with the caches that a long
    one has left. A warm-up is a first round that does not count, in which loops are compiled. Timed
    calls return their own seconds.
    """
    most_s = LONG_S if rounds is None else np.inf
    least_s = (SHORT_S if rounds is None else 0.0) if least_s is None else least_s
    rounds = ROUNDS if rounds is None else rounds
    if warm_up:
        _round(calls, 0.0, timed)
    found, started = [], time.perf_counter()
    every: list[list[float]] = [[] for _ in calls]
    while True:
        turns, results = zip(*_round(calls, turn_s, timed), strict=True)
        found.append([min(turn) for turn in turns])
        for times, turn in zip(every, turns, strict=True):
            times += turn
        spent = time.perf_counter() - started
        if spent >= most_s or (len(found) >= rounds and spent >= least_s):
            return Times(np.transpose(found), list(results), every)


def _round(calls, turn_s: float, timed: bool) -> list[tuple[list[float], Any]]:
    return [_turn(call, turn_s, timed) for call in calls]


def _turn(call: Callable, turn_s: float, timed: bool) -> tuple[list[float], Any]:
    times: list[float] = []
    while not times or (sum(times) < turn_s and len(times) < MOST_CALLS_IN_A_TURN):
        started = time.perf_counter()
        result = call()
        times.append(result if timed else time.perf_counter() - started)
    return times, result


def seconds(call: Callable) -> float:
    """Time that one call takes."""
    started = time.perf_counter()
    call()
    return time.perf_counter() - started


def measure_bandwidth() -> float:
    """Measure how fast all cores together read from memory, in bytes per second.

    Apart from other calls, because compiled loops leave threads that keep watch for a while.
    """
    rows, sums = np.ones(BLOCK, np.float32), np.empty(BLOCK[0], np.float32)
    (best,) = in_turn(lambda: _kernels.sum_rows(rows, sums), rounds=READINGS).best
    return rows.nbytes / best


def forget_peak_memory() -> None:
    """Leave out what it took to bring the light field here, where the system allows (Linux)."""
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")


def peak_memory() -> int:
    """Peak resident memory of this process in bytes."""
    status = Path("/proc/self/status")
    if status.exists():  # on Linux getrusage still counts what the parent had before it started us
        line = next(x for x in status.read_text().splitlines() if x.startswith("VmHWM"))
        return 1024 * int(line.split()[1])
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss  # macOS counts in bytes
