"""Table and picture of the hard cases (`experiments.hard_cases.case`)."""

import importlib
import math
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from experiments.command_parts import step_bar
from experiments.hard_cases.case import CASES, HardCase, measure
from experiments.report import markdown, write_report
from lf_flame._common import figures

TOPICS = ("optics", "light", "refocusing", "tomography", "learning")
"""Modules of this folder that hold cases, in the table's order."""

FAILED, ROUNDING = 1e3, 1e-17
"""Where the picture shows errors that are no number, and those of 0."""


def all_cases() -> list[HardCase]:
    """Gather the cases of all topics."""
    for topic in TOPICS:
        importlib.import_module(f"experiments.hard_cases.{topic}")
    return CASES


def run_hard_cases(out: Path) -> Path:
    """Compute all cases and write the report."""
    started, cases = time.perf_counter(), all_cases()
    rows = [_row(case) for case in step_bar(cases)]
    record = {"cases": rows, "wall_s": time.perf_counter() - started}
    return write_report(
        out, "hard_cases", "Hard cases", record, body(record),
        tables={"hard_cases": pd.DataFrame(rows)}, pictures={"hard_cases": figure(rows)},
    )  # fmt: skip


def _row(case: HardCase) -> dict[str, Any]:
    found = measure(case)
    return {
        "topic": case.find.__module__.rpartition(".")[2],
        "case": case.name,
        "exact": found["exact"],
        "obvious_formula": case.obvious,
        "obvious": found["obvious"],
        "obvious_error": found["obvious_error"],
        "here": case.here,
        "ours": found["ours"],
        "our_error": found["our_error"],
    }


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


def body(record: dict) -> list[str]:
    """Write the table, and what it means, as Markdown."""
    return [
        "Each line computes a case three times: exactly, by rational arithmetic or a closed form "
        "without the package; by the formula that suggests itself; and by the package. Values are "
        "those of the place where the obvious formula is worst; errors are the largest of all "
        "places, relative to the value or, where that may be 0, to a unit.",
        markdown(record["cases"], COLUMNS),
    ]


def figure(rows: Sequence[dict[str, Any]]) -> Figure:
    """Draw both errors of each case."""
    drawn, axis = figures.subplots(figsize=(9, 0.8 + 0.23 * len(rows)), layout="constrained")
    y = np.arange(len(rows))
    marks = (("obvious_error", "#D55E00", "X", "obvious formula"),
             ("our_error", "#0072B2", "o", "lf_flame"))  # fmt: skip
    ends = [np.clip([row[column] for row in rows], ROUNDING, FAILED) for column, *_ in marks]
    axis.hlines(y, *ends, color="0.8", linewidth=1, zorder=0)
    for errors, (_, colour, marker, label) in zip(ends, marks, strict=True):
        axis.plot(errors, y, marker, color=colour, label=label, markersize=6)
    axis.set_xscale("log")
    ticks = [ROUNDING, 1e-15, 1e-12, 1e-9, 1e-6, 1e-3, 1, FAILED]
    axis.set_xticks(ticks, ["0", *(f"{tick:g}" for tick in ticks[1:-1]), "fails"])
    axis.set_yticks(y, [row["case"] for row in rows], fontsize=7)
    axis.set_ylim(len(rows) - 0.4, -0.6)
    axis.set_xlabel("error")
    axis.grid(axis="x", alpha=0.25)
    axis.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, frameon=False)
    return drawn
