"""Milliseconds and memory of a refocusing system, in a process of its own.

This module imports nothing heavy, so that a process that runs no network does not load one.
"""

import os
from collections.abc import Callable
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import numpy as np

from experiments.timing import forget_peak_memory, in_turn, peak_memory
from lf_flame._common.workers import worker_pool
from lf_flame.systems.base import RefocusingSystem


def measure_cost(
    load: Callable[[], RefocusingSystem],
    views: np.ndarray,
    slopes: np.ndarray,
    block: tuple[int, int],
) -> dict[str, float]:
    """Time a system on a frame, in a process of its own that does nothing else.

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
    forget_peak_memory()
    system = load()
    times = in_turn(lambda: system.refocus(views, slopes, block), rounds=15, least_s=1.0)
    memory_mb = (peak_memory() - views.nbytes) / 1e6
    return {"milliseconds": 1e3 * float(times.best[0]), "memory_mb": memory_mb}
