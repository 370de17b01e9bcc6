"""Time refocusing, rendering and the slope search while other processes want the cores too.

    python -m experiments.benchmarks.busy --out results/benchmarks

Each operation runs beside 0, 1, 2 and 4 processes that count without end; medians and 90th
percentiles of many calls. The baseline is the same code with its loops as Numba's own parallel
ones, on the threading layer that Numba takes here; both run in turn beside the same load, and their
images are compared bit by bit. With --passive OpenMP's threads sleep at once instead of spinning,
as the programs of this package had them do before they went without.
"""

import inspect
import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from unittest.mock import patch

import numba
import numpy as np
from numba import njit
from tqdm import tqdm

from experiments.benchmarks.report import command_line, finish
from experiments.timing import in_turn, seconds
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

SECONDS = 16.0
"""For each row."""

TURN_S = 0.5
"""Time for which one way is called before the other's turn."""

VIEWS = (15, 15, 90, 180)

LOOPS = {
    refocus_kernels: ("shift_and_sum",),
    search_kernels: ("add_product",),
    render_kernels: ("integrate_columns", "integrate_rows"),
}
"""The loops that the operations share out, by the module that holds them."""

COLUMNS = {
    "operation": ("operation", ""),
    "busy processes": ("busy processes", ""),
    "median": ("median", ".3g"),
    "90th percentile": ("90th percentile", ".3g"),
    "of idle": ("of idle", ".2f"),
    "Numba's median": ("Numba's median", ".3g"),
    "Numba's 90th": ("Numba's 90th", ".3g"),
    "Numba's of idle": ("Numba's of idle", ".2f"),
    "same bits": ("same bits", ""),
}


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


def measure(loads: Sequence[int], least_s: float) -> list[dict]:
    """Time every operation beside every load, for so many seconds."""
    theirs = {m: {name: numbas_own(m, name) for name in names} for m, names in LOOPS.items()}
    rows: list[dict] = []
    for operation, call in operations().items():
        image = call()
        with numbas_loops(theirs):
            same = bool(np.array_equal(image, call()))

        def by_numba(call=call) -> float:
            with numbas_loops(theirs):
                return seconds(call)

        idle = None
        for load in tqdm(loads, operation):
            with beside(load):
                clocks = partial(seconds, call), by_numba
                times = in_turn(*clocks, timed=True, rounds=2, least_s=least_s, turn_s=TURN_S)
            ms = [1e3 * np.percentile(some, (50, 90)) for some in times.every]
            idle = ms if idle is None else idle
            row = {"operation": operation, "busy processes": load, "same bits": same}
            for names, found, first in zip(
                (("median", "90th percentile", "of idle"),
                 ("Numba's median", "Numba's 90th", "Numba's of idle")),
                ms, idle, strict=True,
            ):  # fmt: skip
                row |= dict(zip(names, (*found.tolist(), float(found[0] / first[0])), strict=True))
            rows.append(row)
    return rows


def main() -> None:
    """Measure, print and write."""
    parser = command_line(__doc__)
    parser.add_argument("--passive", action="store_true", help="OpenMP's threads sleep, not spin")
    asked = parser.parse_args()
    if asked.passive:
        os.environ["OMP_WAIT_POLICY"] = "PASSIVE"  # which OpenMP reads as it is loaded, below
    rows = measure(*((LOADS[:2], 0.2) if asked.small else (LOADS, SECONDS)))
    record = {"rows": rows, "threads": numba.get_num_threads(), "layer": numba.threading_layer()}
    passive = ", passive" if asked.passive else ""
    notes = [
        f"Milliseconds on {record['threads']} threads. Numba's: the same code with Numba's own "
        f"parallel loops, on its layer {record['layer']}{passive}."
    ]
    name = "busy_passive" if asked.passive else "busy"
    finish(asked.out, name, "Speed beside busy processes", record, COLUMNS, notes)


if __name__ == "__main__":
    main()
