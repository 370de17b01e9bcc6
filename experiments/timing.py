"""Seconds of calls made in turn, the bandwidth of memory, and the memory of a process."""

import resource
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path

import numpy as np

from experiments import _kernels

REPETITIONS, SHORT_S, LONG_S = 3, 0.3, 5.0
"""Runs of which the fastest counts; more until SHORT_S have passed, no further one after LONG_S."""

BLOCK = (256, 2**18)
"""Rows and float32 elements of what is read to measure the bandwidth: 256 MiB, beyond caches."""

READINGS = 20

MOST_CALLS_IN_A_TURN = 100


def race(*calls: Callable[[], np.ndarray]) -> tuple[np.ndarray, list[np.ndarray]]:
    """Run calls in turn a few times: seconds[call, run] in rising order, and the images."""
    rounds, spent = [], 0.0
    while (len(rounds) < REPETITIONS or spent < SHORT_S) and spent < LONG_S:
        seconds, images = [], []
        for call in calls:
            start = time.perf_counter()
            images.append(call())
            seconds.append(time.perf_counter() - start)
        rounds.append(seconds)
        spent += sum(seconds)
    return np.sort(np.transpose(rounds), axis=1), images


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


def measure_bandwidth() -> float:
    """Measure how fast all cores together read from memory, in bytes per second: the best of some.

    Apart from the rounds, because compiled loops leave threads that keep watch for a while.
    """
    rows, sums, seconds = np.ones(BLOCK, np.float32), np.empty(BLOCK[0], np.float32), []
    for _ in range(READINGS):
        begun = time.perf_counter()
        _kernels.sum_rows(rows, sums)
        seconds.append(time.perf_counter() - begun)  # the first compiles, and is not the best
    return rows.nbytes / min(seconds)


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
