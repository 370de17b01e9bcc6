"""How fast refocusing is: ratios within one run, against named baselines, outputs compared.

    make benchmarks

All calls are timed in turn, again and again, and the best of each counts, so that what else the
machine does hits all alike. The baselines of `baselines.txt` run in a Python of their own
(`--baselines`), which times the call alone. A ratio is the baseline's time over ours; a difference
is the largest of any pixel, relative to the brightest.
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from importlib import metadata

import numba
import numpy as np
from scipy import ndimage

from experiments._kernels import sum_rows
from experiments.benchmarks.report import OtherPython, finish, ratio, run_cases
from experiments.timing import in_turn, seconds
from lf_flame._common.arrays import centred
from lf_flame.refocus import fourier_refocus, shift_and_sum

ALIKE = 1e-6
"""Largest difference, relative to the brightest pixel, of outputs that should be the same."""

ROUNDS = 5

TURN_S = 0.05
"""A call that takes less is repeated for so long in its turn."""

COLUMNS = {
    "what": ("what", ""),
    "baseline": ("baseline", ""),
    "threads": ("threads", ""),
    "ours ms": ("ours ms", ".4g"),
    "baseline ms": ("baseline ms", ".4g"),
    "ratio": ("ratio", ".3g"),
    "quartiles": ("quartiles", ""),
    "wanted": ("wanted", ""),
    "largest difference": ("largest difference", ""),
    "remarks": ("remarks", ""),
}


def read_once(views, slopes):
    """Sum all pixels; the same for any number of slopes."""
    sums = np.empty(views.shape[0] * views.shape[1], np.float32)
    sum_rows(views.reshape(sums.size, -1), sums)
    return sums.sum(dtype=np.float64)


def scipy_shift(views, slopes, order=1):
    """Shift view by view, each into the same array."""
    if views.ndim == 5:
        channels = [scipy_shift(views[..., c], slopes, order) for c in range(views.shape[4])]
        return np.stack(channels, axis=-1)
    images = np.zeros((len(slopes), *views.shape[2:]))
    moved = np.empty(views.shape[2:], np.float32)
    for image, slope in zip(images, slopes, strict=True):
        down, right = (-slope * centred(n) for n in views.shape[:2])
        for v, row in enumerate(views):
            for u, view in enumerate(row):
                ndimage.shift(view, (down[v], right[u]), moved, order, mode="nearest")
                image += moved
    return images / (views.shape[0] * views.shape[1])


def whole_shifts(lines, shifts):
    """Where to gather lines[k, line] shifted by the whole part, one line more; and the rest."""
    whole = np.floor(shifts).astype(int)
    places = np.clip(whole[:, None] + np.arange(lines.shape[1] + 1), 0, lines.shape[1] - 1)
    return places, (shifts - whole).astype(np.float32)


def sum_by_lerps(lines, shifts):
    """Gather and interpolate lines[k, line] one k after the other, into the same arrays."""
    total, part = np.zeros_like(lines[0]), np.empty_like(lines[0])
    for some, places, rest in zip(lines, *whole_shifts(lines, shifts), strict=True):
        moved = some[places]
        np.subtract(moved[1:], moved[:-1], out=part)
        part *= rest
        part += moved[:-1]
        total += part
    return total


def sum_by_product(lines, shifts):
    """Gather lines[k, line] for all k, then weigh and sum them in one matrix product."""
    places, rest = whole_shifts(lines, shifts)
    moved = lines[np.arange(len(lines))[:, None], places]
    near, far = np.tensordot(np.stack([1 - rest, rest]), moved, axes=1)
    return near[:-1] + far[1:]


def separable(views, slopes, shifted_sum):
    """Sum over v first, where the lines gathered are contiguous, then over u; float32."""
    images = np.empty((len(slopes), *views.shape[2:]), np.float32)
    for image, slope in zip(images, slopes, strict=True):
        down, right = (slope * centred(n) for n in views.shape[:2])
        sums = np.stack([shifted_sum(views[:, u], down) for u in range(views.shape[1])])
        image[:] = shifted_sum(sums.swapaxes(1, 2), right).swapaxes(0, 1)
    return images / np.float32(views.shape[0] * views.shape[1])


@dataclass(frozen=True)
class Opponent:
    """A method of refocusing, here by a function of views and slopes, or by a package elsewhere."""

    name: str
    remarks: str
    refocus: Callable | None = None
    package: str = ""
    threaded: bool = False
    """Runs on as many threads as we do."""
    same_output: bool = True


READ = Opponent("reading the light field once", "Numba, float32 sum; the floor", read_once,
                threaded=True, same_output=False)  # fmt: skip
LERPS = Opponent("NumPy, separable, tuned", "float32, contiguous gathers; one thread",
                 partial(separable, shifted_sum=sum_by_lerps))  # fmt: skip
PRODUCT = Opponent("NumPy, separable, matrix product", "float32, gathers; threads of its BLAS",
                   partial(separable, shifted_sum=sum_by_product))  # fmt: skip
SHIFT = Opponent("SciPy ndimage.shift", "order 1, one thread", scipy_shift)
SPLINE = Opponent("SciPy ndimage.shift, order 3", "a cubic B-spline: another image; one thread",
                  partial(scipy_shift, order=3), same_output=False)  # fmt: skip
FOURIER = Opponent("our fourier_refocus", "exact, periodic shifts: another image; threads of BLAS",
                   fourier_refocus, same_output=False)  # fmt: skip
PLENPY = Opponent("plenpy", "its slopes converted; one thread", package="plenpy")
PLENOPTICAM = Opponent("PlenoptiCam", "whole slopes and RGB only, float64; its output, N times "
                       "the mean, divided by N; one thread", package="plenopticam")  # fmt: skip


@dataclass(frozen=True)
class Case:
    """Light field and slopes, and against whom; `wanted` is the least ratio on all threads."""

    what: str
    shape: tuple[int, ...]
    slopes: tuple[float, ...]
    against: tuple[Opponent, ...]
    wanted: dict[Opponent, float] = field(default_factory=dict)
    frames_per_s: float | None = None
    interpolation: str = "linear"

    def light_field(self) -> np.ndarray:
        """Noise, on which any error of a shift shows."""
        return np.random.default_rng(0).random(self.shape, np.float32)


FOUR_SLOPES = (2.1, 1.15, 0.35, -1.25)
HERE = (READ, LERPS, PRODUCT, SHIFT)


def cases(small: bool) -> list[Case]:
    """Everything that is measured, or the same with few views of few pixels."""
    usual = (5, 5, 12, 18) if small else (15, 15, 90, 180)
    large = (5, 5, 27, 54) if small else (15, 15, 270, 540)
    stack = tuple(np.linspace(-2.05, 2.15, 15).tolist())
    return [
        Case("one plane", usual, (1.15,), (*HERE, FOURIER, PLENPY)),
        Case("four planes", usual, FOUR_SLOPES, (*HERE, PLENPY), {READ: 1 / 4, LERPS: 15}),
        Case("one plane, cubic", usual, (1.15,), (READ, SPLINE), interpolation="cubic"),
        Case("one plane, whole slope", usual, (1.0,), (*HERE, PLENPY)),
        Case("one plane, whole slope, RGB", (*usual, 3), (1.0,), (*HERE, PLENPY, PLENOPTICAM)),
        Case("15 planes", usual, stack, (READ, LERPS, PRODUCT, FOURIER, PLENPY), {PLENPY: 10}),
        Case("four planes, large", large, FOUR_SLOPES, (READ, LERPS, PRODUCT), frames_per_s=20),
    ]


THREADS = sorted({1, numba.config.NUMBA_NUM_THREADS})


def on_threads(count: int, call: Callable) -> Callable[[], float]:
    """Make a call on some threads that returns its seconds."""

    def clock() -> float:
        numba.set_num_threads(count)
        return seconds(call)

    return clock


def compared(baseline: Opponent, ours: np.ndarray, theirs: np.ndarray) -> str:
    """Difference of the images, which ends the program where they should be the same."""
    if baseline is READ:
        return ""
    found = float(np.abs(ours - theirs).max() / np.abs(theirs).max())
    if baseline.same_output and not found <= ALIKE:
        sys.exit(f"{baseline.name} must refocus as we do to {ALIKE:g}, but differs by {found:.1e}.")
    return f"{found:.1e}"


def measure(case: Case, small: bool, other: OtherPython | None) -> list[dict]:
    """Refocus by every method, compare the images, then time all in turn."""
    work = (case.light_field(), case.slopes)
    ours = partial(shift_and_sum, *work, interpolation=case.interpolation)
    images, differences = ours(), {}
    clocks = {("ours", n): on_threads(n, ours) for n in THREADS}
    for baseline in case.against:
        if baseline.refocus:
            theirs = baseline.refocus(*work)
            for n in THREADS if baseline.threaded else THREADS[-1:]:
                clocks[baseline, n] = on_threads(n, partial(baseline.refocus, *work))
        elif other and baseline.package in other.versions:
            theirs = other.refocus(baseline.package, *work)
            clocks[baseline, THREADS[-1]] = partial(other.seconds, baseline.package)
        else:
            continue
        differences[baseline] = compared(baseline, images, theirs)
    rounds, turn_s = (1, 0.0) if small else (ROUNDS, TURN_S)
    times = in_turn(*clocks.values(), timed=True, rounds=rounds, turn_s=turn_s)
    keys, what = list(clocks), f"{case.what}, {'x'.join(map(str, case.shape))}"
    rows = []
    for n in THREADS:
        at = keys.index(("ours", n))
        row = {"what": what, "threads": n, "ours ms": 1e3 * times.best[at]}
        all_threads = n == THREADS[-1]
        for baseline in case.against:
            row |= {"baseline": baseline.name, "remarks": baseline.remarks, "wanted": ""}
            if all_threads and baseline in case.wanted:
                row["wanted"] = f"at least {case.wanted[baseline]:g}"
            if baseline not in differences:
                missing = {"baseline ms": None, "ratio": None, "quartiles": None}
                missing["largest difference"] = ""
                rows.append(row | missing | {"remarks": f"not installed; {baseline.remarks}"})
                continue
            theirs = keys.index((baseline, n if baseline.threaded else THREADS[-1]))
            found = {"baseline ms": 1e3 * times.best[theirs], **ratio(times, theirs, at)}
            rows.append(row | found | {"largest difference": differences[baseline]})
        if case.frames_per_s:
            frame, took = 1e3 / case.frames_per_s, row["ours ms"]
            rows.append(row | {
                "baseline": f"{case.frames_per_s:g} frames/s", "baseline ms": frame,
                "ratio": frame / took, "wanted": "at least 1" if all_threads else "",
                "quartiles": "", "largest difference": "", "remarks": f"{1e3 / took:.3g} frames/s",
            })  # fmt: skip
    return rows


def main() -> None:
    """Measure, print and write."""
    asked, record = run_cases(__doc__, cases, measure)
    record |= {"scipy": metadata.version("scipy")}
    theirs = ", ".join(map(" ".join, record["baselines"].items())) or "none installed"
    notes = [
        "Threads are ours. Ratio: the baseline's time over ours, median and quartiles of the "
        "rounds; times are the best of them. Difference: of any pixel, relative to the brightest. "
        f"Baselines in a Python of their own: {theirs}."
    ]
    finish(asked.out, "refocusing", "Speed of refocusing", record, COLUMNS, notes)


if __name__ == "__main__":
    main()
