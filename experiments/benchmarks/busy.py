"""Time refocusing, rendering and the slope search while other processes want the cores too.

    python -m experiments.benchmarks.busy --out results/benchmarks

Each operation runs beside 0, 1, 2 and 4 processes that count without end; medians and 90th
percentiles of many calls. The baseline is the same code with its loops as Numba's own parallel
ones, on the threading layer that Numba takes here; both run in turn beside the same load, and their
images are compared bit by bit. With --passive OpenMP's threads sleep at once instead of spinning,
as the programs of this package had them do before they went without.
"""

import argparse
import inspect
import os
import re
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from unittest.mock import patch

import numba
import numpy as np
import pandas as pd
from numba import njit
from tqdm import tqdm

from experiments.benchmarks.report import write_table
from lf_flame._common.provenance import environment
from lf_flame.datasets.config import read_config
from lf_flame.refocus import _kernels as refocus_kernels
from lf_flame.refocus import _semblance_kernels as search_kernels
from lf_flame.refocus import find_sharpest_slopes, shift_and_sum
from lf_flame.simulation import _exact_kernels as render_kernels
from lf_flame.simulation.rendering import render_plan

LOADS = (0, 1, 2, 4)
"""Processes beside."""

COUNTING = """
import os, sys
while os.getppid() == int(sys.argv[1]):  # not left over where this program was killed
    for _ in range(10**6): pass
"""

SECONDS = 8.0
"""For each way of each row."""

TURN_S = 0.5
"""Time for which one way is called before the other's turn."""

VIEWS = (15, 15, 90, 180)

LOOPS = {
    refocus_kernels: ("shift_and_sum",),
    search_kernels: ("add_product",),
    render_kernels: ("integrate_columns", "integrate_rows"),
}
"""The loops that the operations share out, by the module that holds them."""

COLUMNS = ["operation", "busy processes", "median", "90th percentile", "of idle", "Numba's median",
           "Numba's 90th", "Numba's of idle", "same bits"]  # fmt: skip


def numbas_own(module, name: str) -> Callable:
    """Compile a shared loop as one of Numba's parallel loops instead."""
    source = inspect.getsource(getattr(module, f"_{name}"))
    loop = source.replace("in pieces(queue, ", "in numba.prange(")
    plain = re.sub(r"\(\s*queue, ", "(", loop, count=1)
    names = {**vars(module), "numba": numba}
    exec(plain, names)  # our own code, but for its loop
    return njit(parallel=True)(names[f"_{name}"])


@contextmanager
def beside(processes: int) -> Iterator[None]:
    """Let so many processes count."""
    counting = [sys.executable, "-c", COUNTING, str(os.getpid())]
    started = [subprocess.Popen(counting) for _ in range(processes)]
    try:
        yield
    finally:
        for process in started:
            process.kill()
            process.wait()


@contextmanager
def numbas_loops(theirs: dict) -> Iterator[None]:
    """Put Numba's loops in the place of ours."""
    with (
        patch.multiple(refocus_kernels, **theirs[refocus_kernels]),
        patch.multiple(search_kernels, **theirs[search_kernels]),
        patch.multiple(render_kernels, **theirs[render_kernels]),
    ):
        yield


def operations() -> dict[str, Callable[[], np.ndarray]]:
    """List what is timed."""
    views = np.random.default_rng(0).random(VIEWS, np.float32)
    config = read_config("data_gen/shapes.toml")
    scene, _ = config.draw(None)
    few = views[:9, :9]
    return {
        "four planes of 15 x 15 x 90 x 180": lambda: shift_and_sum(views, [2.3, 1.2, 0.0, -1.2]),
        "a shape scene, exact integrator": lambda: (
            render_plan(scene, config.camera, config.plan).views
        ),
        "slope search, 9 x 9 views, 3 x 3 tiles": lambda: np.array(
            [s.sharpness for s in find_sharpest_slopes(few, np.linspace(-1, 1, 21), tiles=(3, 3))]
        ),
    }


def call_for(seconds: float, call: Callable) -> list[float]:
    """Call again and again for so long, and list the times."""
    times: list[float] = []
    while sum(times) < seconds:
        started = time.perf_counter()
        call()
        times.append(time.perf_counter() - started)
    return times


def measure(loads: Sequence[int], seconds: float) -> list[dict]:
    """Time every operation beside every load, for so many seconds each way."""
    theirs = {m: {name: numbas_own(m, name) for name in names} for m, names in LOOPS.items()}
    rows: list[dict] = []
    idle: dict[tuple[str, str], float] = {}
    calls = operations()
    for operation, load in tqdm([(o, n) for o in calls for n in loads], "measuring"):
        call, ours, others = calls[operation], [], []
        image = call()
        with numbas_loops(theirs):
            same = bool(np.array_equal(image, call()))
        with beside(load):
            while sum(ours) < seconds or sum(others) < seconds:
                ours += call_for(TURN_S, call)
                with numbas_loops(theirs):
                    others += call_for(TURN_S, call)
        row = {"operation": operation, "busy processes": load, "same bits": same}
        for who, times in (("", ours), ("Numba's ", others)):
            median, late = np.percentile(times, [50, 90]) * 1e3
            if load == 0:
                idle[operation, who] = float(median)
            names = ("Numba's median", "Numba's 90th") if who else ("median", "90th percentile")
            row |= dict(zip(names, (float(median), float(late)), strict=True))
            row[f"{who}of idle"] = float(median) / idle[operation, who]
        rows.append(row)
    return rows


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results/benchmarks"))
    parser.add_argument("--small", action="store_true", help="for a moment, to try the program")
    parser.add_argument("--passive", action="store_true", help="OpenMP's threads sleep, not spin")
    asked = parser.parse_args()
    if asked.passive:
        os.environ["OMP_WAIT_POLICY"] = "PASSIVE"  # which OpenMP reads as it is loaded, below
    loads, seconds = (LOADS[:2], 0.1) if asked.small else (LOADS, SECONDS)
    table = pd.DataFrame(measure(loads, seconds), columns=COLUMNS)
    record = {**environment(), "threads": numba.get_num_threads(), "layer": numba.threading_layer()}
    notes = (
        f"Milliseconds on {record['threads']} threads. Numba's: the same code with Numba's own "
        f"parallel loops, on its layer {record['layer']}{', passive' if asked.passive else ''}. "
    )
    formats = ("", "", ".3g", ".3g", ".2f", ".3g", ".3g", ".2f", "")
    title = "Speed beside busy processes"
    write_table(
        asked.out / f"busy{'_passive' if asked.passive else ''}",
        title,
        table,
        formats,
        record,
        notes=notes,
    )


if __name__ == "__main__":
    main()
