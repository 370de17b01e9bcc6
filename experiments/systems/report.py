"""The text of the benchmark (`experiments.systems.benchmark`)."""

import numpy as np
import pandas as pd

from experiments.report import markdown
from experiments.systems.compared_sets import SIXTEEN
from experiments.systems.learning import learning_text

MISSING = "missing"

CLAIMED_SSIM = 0.925
"""SSIM of RefNet against the Fourier slice, as the paper reports it of Hedayati et al."""


COSTS = {
    "system": ("system", ""),
    "views": ("views", ".0f"),
    "parameters": ("parameters", ",.0f"),
    "steps": ("steps", ",.0f"),
    "training_s": ("training (s)", ".0f"),
    "milliseconds": ("ms a frame", ".1f"),
    "memory_mb": ("memory (MB)", ".0f"),
}


def body(scores: pd.DataFrame, costs: pd.DataFrame, record: dict) -> list[str]:
    """Write what came out as Markdown: scores, and costs with the columns of `COSTS`."""
    clean, frame = without_noise(scores), record["frame"]
    text = f"""The reference is shift-and-sum of all views, or of those in a round aperture where a
test set is called so; networks have learnt the former where their name says nothing else. PSNR in
dB (peak 1), and SSIM: means over planes and light fields; every plane is in compare.csv. Views are
those that a system looks at; training is given in steps of the optimiser, and in seconds at the
pace of the median epoch, without drawing the training samples (a ResNet-50 that a regression sets
at the start takes its seconds there); milliseconds and peak memory for a frame of
{frame["planes"]} planes of {frame["image"]} from {frame["views"]} views in memory, each system in a
process of its own. Squares of 3 x 3 and 7 x 7 views stand in the middles of equal parts of the
aperture, a cross reaches its edges. In the pictures ours are stars, other networks dots and
formulas squares; what is exact, or beyond the axis, stands at its edge as a triangle.

{markdown(costs, COSTS)}

## PSNR (dB)

{_pivot(clean, "psnr_db", "{:.2f}")}

## SSIM

{_pivot(clean, "ssim", "{:.3f}")}

## The weakest plane, PSNR (dB)

{_pivot(clean, "psnr_db", "{:.2f}", "min")}

{_sixteen(scores)}{_noise(scores)}{learning_text(record["systems"])}## What is missing

{_missing(scores)}"""
    return [text]


def without_noise(scores: pd.DataFrame) -> pd.DataFrame:
    """Keep the planes that all systems are for, in enough light."""
    return scores[np.isinf(scores.electrons) & ~scores.test_set.str.endswith(SIXTEEN)]


def _missing(scores: pd.DataFrame) -> str:
    """List what is missing: systems that were refused for the same reason, and the first time."""
    rows = scores[scores.psnr_db.isna()].drop_duplicates(["system", "why_missing"])
    reasons = [
        row.why_missing.removeprefix(row.system).removeprefix(f"{row.system.split(',')[0]} ")
        for row in rows.itertuples()
    ]
    lines = [
        f"- {test_set}: {reason.strip()} ({'; '.join(some.system)})"
        for (test_set, reason), some in rows.groupby(["test_set", pd.Series(reasons, rows.index)])
    ]
    return "\n".join(lines) or "Nothing."


def _sixteen(scores: pd.DataFrame) -> str:
    """Write a table for the slopes of RefNet; nothing where they were not asked for."""
    seen = scores[scores.test_set.str.endswith(SIXTEEN)]
    if seen.empty:
        return ""
    names = seen.test_set.str.removesuffix(SIXTEEN) + ", " + seen.truth
    return f"""## SSIM at RefNet's sixteen slopes

Slope 1 - alpha, alpha from 0.125 to 2; the reference is shift-and-sum or the Fourier slice of all
views. The paper reports more than {CLAIMED_SSIM} of RefNet itself, against the Fourier slice, on
other data.

{_pivot(seen.assign(test_set=names), "ssim", "{:.3f}")}

"""


def _noise(scores: pd.DataFrame) -> str:
    """Write a table for each test set that was seen in less light; nothing where none was."""
    seen = scores[np.isfinite(scores.electrons)]
    if seen.empty:
        return ""
    parts = [
        "## In less light, PSNR (dB)",
        "Shot noise of as many electrons as a pixel at full scale holds; the reference is what all "
        "views show without noise. Only the system that says so has learnt from noisy samples.",
    ]
    for name in seen.test_set.unique():
        rows = scores[scores.test_set == name]
        rows = rows.assign(test_set=[_light(value) for value in rows.electrons])
        parts += [f"### {name}", _pivot(rows, "psnr_db", "{:.2f}")]
    return "\n\n".join(parts) + "\n\n"


def _light(electrons: float) -> str:
    if np.isinf(electrons):
        return "no noise"
    return f"{electrons:g} electron" + "s" * (electrons != 1)


def _pivot(scores: pd.DataFrame, measure: str, form: str, how: str = "mean") -> str:
    groups = scores.groupby(["system", "test_set"], sort=False)[measure]
    values = groups.min() if how == "min" else groups.mean()
    wide = values.unstack("test_set").loc[scores.system.unique(), scores.test_set.unique()]
    shown = wide.map(lambda value: _number(value, form))
    sides = ("left", *["right"] * len(shown.columns))
    return shown.to_markdown(disable_numparse=True, colalign=sides)


def _number(value: float, form: str) -> str:
    if np.isinf(value):
        return "exact"
    return MISSING if pd.isna(value) else form.format(value)
