"""Seconds of calls made in turn, how fast memory is read, and what a system costs in a process.

This module loads no network, so that a process that runs none stays small.
"""

import os
import resource
import time
from collections.abc import Callable
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numba
import numpy as np

from lf_flame._common.workers import worker_pool
from lf_flame.systems.base import RefocusingSystem

ROUNDS, SHORT_S, LONG_S = 3, 0.3, 5.0
"""Usual number of rounds; more until SHORT_S have passed, none that begins after LONG_S."""


@dataclass(frozen=True)
class Times:
    """Seconds of calls made in turn, shape (calls, rounds), and what each returned last."""

    seconds: np.ndarray
    results: list

    @property
    def best(self) -> np.ndarray:
        """Shortest time of each call."""
        return self.seconds.min(axis=1)

    def ratio(self, call: int, other: int) -> tuple[float, float, float]:
        """Time of a call over that of another in the same round: median and quartiles."""
        ratios = self.seconds[call] / self.seconds[other]
        median, low, high = np.percentile(ratios, (50, 25, 75)).tolist()
        return median, low, high


def in_turn(
    *calls: Callable[[], Any],
    rounds: int | None = None,
    least_s: float | None = None,
    warm_up: bool = True,
) -> Times:
    """Time calls in turn, round by round, so that other load on the machine slows all equally.

    At least `rounds` rounds, and more until `least_s` seconds have passed; by default `ROUNDS` and
    `SHORT_S`, fewer where they take longer than `LONG_S`. A warm-up round compiles, uncounted.
    """
    most_s = LONG_S if rounds is None else np.inf
    least_s = (SHORT_S if rounds is None else 0.0) if least_s is None else least_s
    rounds = ROUNDS if rounds is None else rounds
    for call in calls if warm_up else ():
        call()
    found, started = [], time.perf_counter()
    while True:
        turns, results = [time.perf_counter()], []
        for call in calls:
            results.append(call())
            turns.append(time.perf_counter())
        found.append(np.diff(turns))
        spent = time.perf_counter() - started
        if spent >= most_s or (len(found) >= rounds and spent >= least_s):
            return Times(np.transpose(found), results)


@numba.njit(parallel=True, cache=True)
def _sum_parts(words, sums):
    size = words.size // sums.size
    for k in numba.prange(sums.size):
        total = np.uint64(0)
        for i in range(k * size, (k + 1) * size):
            total += words[i]
        sums[k] = total


def read_once(array: np.ndarray) -> None:
    """Read an array once on all cores, but for some bytes at its end: the floor of its use."""
    words = array.reshape(-1).view(np.uint8)[: array.nbytes // 8 * 8].view(np.uint64)
    _sum_parts(words, np.empty(min(64, words.size), np.uint64))


def measure_cost(
    load: Callable[[], RefocusingSystem], views: np.ndarray, slopes: np.ndarray, block
) -> dict[str, float]:
    """Time a system on a frame, in a separate process that does nothing else.

    Returns ``milliseconds``, and ``memory_mb``, the peak less the light field; NaN where the
    process died.
    """
    with worker_pool(1) as pool:
        try:
            return pool.submit(_measure, load, views, slopes, block).result()
        except BrokenProcessPool:  # killed, as for want of memory
            return {"milliseconds": float("nan"), "memory_mb": float("nan")}


def _measure(load, views, slopes, block) -> dict[str, float]:
    """Take the fastest of 15 repeats, or of as many as a second holds: networks speed up."""
    with Path(os.devnull).open("w") as nowhere:  # TensorFlow's messages; errors are still raised
        os.dup2(nowhere.fileno(), 2)
    with suppress(OSError):  # Linux keeps the peak of memory, and resets it so
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
    system = load()
    times = in_turn(lambda: system.refocus(views, slopes, block), rounds=15, least_s=1.0)
    memory_mb = (_peak_memory() - views.nbytes) / 1e6
    return {"milliseconds": 1e3 * float(times.best[0]), "memory_mb": memory_mb}


def _peak_memory() -> int:
    """Peak resident memory of this process in bytes."""
    status = Path("/proc/self/status")
    if status.exists():  # on Linux getrusage still counts what the parent had before it started us
        line = next(x for x in status.read_text().splitlines() if x.startswith("VmHWM"))
        return 1024 * int(line.split()[1])
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss  # macOS counts in bytes
