"""The list of hard cases, how each is measured, and the table and picture of all of them."""

import importlib
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from experiments.report import markdown, step_bar, write_report
from lf_flame._common import figures

UNIT, UNIT32 = 2.0**-53, 2.0**-24
"""Unit roundoffs of float64 and of float32."""

as_exact = np.frompyfunc(Fraction, 1, 1)


class Values(NamedTuple):
    """Numbers or arrays of one shape, found in three ways.

    Errors are relative to the scale; default: the size of each exact value.
    """

    exact: Any
    obvious: Any
    ours: Any
    scale: Any = None


@dataclass
class hard_case:  # a decorator
    """A case: what is hard, the formula that suggests itself, and what the package does instead.

    `allowed` is the largest error of the package; the error of the obvious formula exceeds it by
    `fails_by`.
    """

    name: str
    obvious: str
    here: str
    allowed: float
    fails_by: float = 1e3

    def __call__(self, find: Callable[[], Values]) -> Callable[[], Values]:
        """Enter the function that finds the values."""
        self.find = find
        CASES.append(self)
        return find


CASES: list[hard_case] = []

SUBJECTS = {"optics": "Optics", "light": "Simulated light", "refocusing": "Refocusing"}
"""Modules of this folder with cases, in the table's order, and their topics."""


def all_cases() -> list[hard_case]:
    """Gather the cases of all subjects."""
    for subject in SUBJECTS:
        importlib.import_module(f"experiments.hard_cases.{subject}")
    return CASES


def measure(case: hard_case) -> dict[str, Any]:
    """Compute a case.

    Returns ``exact``, ``obvious`` and ``ours``, the values where the obvious formula is worst, as
    text; ``obvious_error`` and ``our_error``, the largest of all values, infinite where a value is
    not finite.
    """
    with np.errstate(all="ignore"):
        values = case.find()
        exact = np.atleast_1d(values.exact)
        scale = np.abs(exact) if values.scale is None else values.scale
        parts = [_errors(np.atleast_1d(x), exact, scale).astype(float) for x in values[1:3]]
    errors = [float(part.max()) for part in parts]
    place = np.unravel_index(parts[0].argmax(), exact.shape)
    texts = [f"{float(np.broadcast_to(x, exact.shape)[place]) + 0.0:.6g}" for x in values[:3]]
    names = ("exact", "obvious", "ours", "obvious_error", "our_error")
    return dict(zip(names, (*texts, *errors), strict=True))


def _error(found: Any, exact: Any, scale: Any) -> float:
    if not np.isfinite(float(found)) or not np.isfinite(float(exact)):
        return 0.0 if float(found) == float(exact) else math.inf
    difference = abs(Fraction(float(found)) - Fraction(exact))
    return float(difference / Fraction(scale)) if difference else 0.0


_errors = np.frompyfunc(_error, 3, 1)


def run_hard_cases(out: Path) -> Path:
    """Compute all cases and write the report."""
    started = time.perf_counter()
    rows = [
        {"subject": case.find.__module__.rpartition(".")[2], "case": case.name}
        | {"obvious_formula": case.obvious, "here": case.here, **measure(case)}
        for case in step_bar(all_cases())
    ]
    record = {"cases": rows, "wall_s": time.perf_counter() - started}
    return write_report(
        out, "hard_cases", "Hard cases", record, body(record),
        tables={"hard_cases": pd.DataFrame(rows)}, pictures={"hard_cases": _figure(rows)},
    )  # fmt: skip


def _written(error: float | None) -> str:
    if error is None or not math.isfinite(error):
        return "fails"
    return f"{error:.0e}" if error else "0"


COLUMNS = {
    "case": ("case", ""),
    "exact": ("exact", ""),
    "obvious_formula": ("obvious formula", ""),
    "obvious": ("gives", ""),
    "obvious_error": ("error", _written),
    "here": ("here", ""),
    "ours": ("gives", ""),
    "our_error": ("error", _written),
}


def _by_subject(rows: Sequence[dict]) -> dict[str, list[dict]]:
    """Gather the cases below the title of their subject."""
    subjects = [subject for subject in SUBJECTS if any(row["subject"] == subject for row in rows)]
    return {SUBJECTS[one]: [row for row in rows if row["subject"] == one] for one in subjects}


def body(record: dict) -> list[str]:
    """Write the table, and what it means, as Markdown."""
    parts = [
        "Each line computes a case three times: exactly, by rational arithmetic, a closed form or "
        "the reference tracer; by the formula that suggests itself; and by the package. Values are "
        "those of the place where the obvious formula is worst; errors are the largest of all "
        "places, relative to the value or, where that may be 0, to a unit.",
        "![Errors of the obvious formula and of lf_flame in each case](hard_cases.png)",
    ]
    for title, rows in _by_subject(record["cases"]).items():
        parts += [f"## {title}", markdown(rows, COLUMNS)]
    return parts


FAILS, NONE = 1e3, 1e-17
"""Places on the picture's axis for errors that are larger or not finite, and for those of 0."""


def _figure(cases: Sequence[dict]) -> Figure:
    """Draw both errors of each case, a panel for each subject."""
    groups = _by_subject(cases)
    counts = [len(rows) for rows in groups.values()]
    drawn, axes = figures.subplots(
        len(groups), 1, sharex=True, squeeze=False, layout="constrained",
        figsize=(11, 1.2 + 0.32 * sum(counts) + 0.35 * len(groups)), height_ratios=counts,
    )  # fmt: skip
    marks = (("obvious_error", "X", "#D55E00", "obvious formula"),
             ("our_error", "o", "#0072B2", "lf_flame"))  # fmt: skip
    for axis, (title, rows) in zip(axes[:, 0], groups.items(), strict=True):
        y = np.arange(len(rows))
        ends = [np.clip([row[error] for row in rows], NONE, FAILS) for error, *_ in marks]
        axis.hlines(y, *ends, color="0.8", linewidth=1.5, zorder=0)
        for errors, (_, marker, colour, label) in zip(ends, marks, strict=True):
            axis.plot(errors, y, marker, color=colour, ms=8, label=label)
        axis.set(xscale="log", ylim=(len(rows) - 0.4, -0.6))
        axis.set_yticks(y, [row["case"] for row in rows], fontsize=9)
        axis.set_title(title, loc="left", fontsize=10, fontweight="bold")
        axis.grid(axis="x", alpha=0.3)
    ticks = [NONE, 1e-15, 1e-12, 1e-9, 1e-6, 1e-3, 1, FAILS]
    axes[-1, 0].set_xticks(ticks, ["0", *(f"{tick:g}" for tick in ticks[1:-1]), ">= 1000"])
    axes[-1, 0].set_xlabel("largest relative error")
    legend = axes[0, 0].get_legend_handles_labels()
    drawn.legend(*legend, loc="outside upper center", ncols=2, frameon=False, fontsize=10)
    return drawn
