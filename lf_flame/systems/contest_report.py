"""Table, text and picture of the contest (`lf_flame.systems.contest`)."""

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

MISSING = "missing"

SIXTEEN = ", RefNet's slopes"
"""Ends the names of test sets at the sixteen slopes of RefNet."""

CLAIMED_SSIM = 0.925
"""Of RefNet against the Fourier slice, as the paper reports it of Hedayati et al."""


def text(scores: pd.DataFrame, prices: pd.DataFrame, record: dict) -> str:
    """Put what came out into Markdown.

    Parameters
    ----------
    scores : DataFrame
        Columns as in `lf_flame.systems.contest.COLUMNS`.
    prices : DataFrame
        One row a system: system, views, parameters, training_s, milliseconds, memory_mb.
    record : dict
        As it is written.
    """
    clean = _clean(scores)
    missing = scores[scores.psnr_db.isna()].drop_duplicates(["system", "why_missing"])
    reasons = "\n".join(
        f"- {row.system}, {row.test_set}: {row.why_missing}" for row in missing.itertuples()
    )
    return f"""# Refocusing systems side by side

`{record["command"]}`, {record["date"]}, revision {record["git_revision"]}, {record["machine"]};
{record["wall_s"]:.0f} s.

Right is shift-and-sum of all views. PSNR in dB (peak 1), and SSIM: means over planes and light
fields; every plane is in compare.csv. Views are those that a system looks at; training in seconds,
with drawing the lessons; milliseconds and peak memory for a frame of
{record["frame"]["planes"]} planes of {record["frame"]["image"]} from {record["frame"]["views"]}
views in memory, each system in a process of its own.

{_prices(prices)}

## PSNR (dB)

{_pivot(clean, "psnr_db", "{:.2f}")}

## SSIM

{_pivot(clean, "ssim", "{:.3f}")}

## The weakest plane, PSNR (dB)

{_pivot(clean, "psnr_db", "{:.2f}", "min")}

{_sixteen(scores)}{_noise(scores)}## What is missing

{reasons or "Nothing."}
"""


def _clean(scores: pd.DataFrame) -> pd.DataFrame:
    """Keep the planes that all systems are for, in enough light."""
    return scores[np.isinf(scores.electrons) & ~scores.test_set.str.endswith(SIXTEEN)]


def _sixteen(scores: pd.DataFrame) -> str:
    """Write a table for the slopes of RefNet; nothing where they were not asked for."""
    seen = scores[scores.test_set.str.endswith(SIXTEEN)]
    if seen.empty:
        return ""
    names = seen.test_set.str.removesuffix(SIXTEEN) + ", " + seen.truth
    return f"""## SSIM at RefNet's sixteen slopes

Slope 1 - alpha, alpha from 0.125 to 2; right is shift-and-sum or the Fourier slice of all views.
RefNet is said to reach more than {CLAIMED_SSIM}, against the Fourier slice, on photographs.

{_pivot(seen.assign(test_set=names), "ssim", "{:.3f}")}

"""


def _noise(scores: pd.DataFrame) -> str:
    """Write a table for each test set that was seen in less light; nothing where none was."""
    seen = scores[np.isfinite(scores.electrons)]
    if seen.empty:
        return ""
    parts = [
        "## In less light, PSNR (dB)",
        "Shot noise of as many electrons as a pixel at full scale holds; right is what all views "
        "show without noise.",
    ]
    for name in seen.test_set.unique():
        rows = scores[scores.test_set == name]
        rows = rows.assign(test_set=[_light(value) for value in rows.electrons])
        parts += [f"### {name}", _pivot(rows, "psnr_db", "{:.2f}")]
    return "\n\n".join(parts) + "\n\n"


def _light(electrons: float) -> str:
    return "no noise" if np.isinf(electrons) else f"{electrons:g} electrons"


def noise_figure(scores: pd.DataFrame):
    """Draw PSNR against light: one panel a test set, one curve a system.

    Returns
    -------
    matplotlib.figure.Figure
    """
    seen = scores[np.isfinite(scores.electrons) & scores.psnr_db.notna()]
    sets = list(seen.test_set.unique())
    drawn, axes = plt.subplots(
        1, len(sets), figsize=(1.5 + 4.6 * len(sets), 5.5), sharey=True, squeeze=False,
        layout="constrained",
    )  # fmt: skip
    names = list(seen.system.unique())
    for axis, test_set in zip(axes[0], sets, strict=True):
        rows = seen[seen.test_set == test_set]
        for k, name in enumerate(names):
            curve = rows[rows.system == name].groupby("electrons")["psnr_db"].mean()
            axis.plot(curve.index, curve, "o-", color=_colour(k), label=name)
        axis.set_xscale("log")
        axis.set_title(test_set, fontsize=10)
        axis.set_xlabel("electrons in a pixel at full scale")
        axis.grid(alpha=0.3)
    axes[0, 0].set_ylabel("PSNR against all views without noise (dB)")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    drawn.legend(handles, labels, ncols=2, loc="outside lower center", fontsize=9)
    return drawn


def _prices(prices: pd.DataFrame) -> str:
    shown = prices.copy()
    for name, form in {"training_s": "{:.0f}", "milliseconds": "{:.1f}", "memory_mb": "{:.0f}",
                       "views": "{:.0f}", "parameters": "{:,.0f}"}.items():  # fmt: skip
        shown[name] = ["" if pd.isna(x) else form.format(x) for x in prices[name]]
    shown.columns = ["system", "views", "parameters", "training (s)", "ms a frame", "memory (MB)"]
    sides = ("left", *["right"] * (len(shown.columns) - 1))
    return shown.to_markdown(index=False, disable_numparse=True, colalign=sides)


def _pivot(scores: pd.DataFrame, measure: str, form: str, how: str = "mean") -> str:
    groups = scores.groupby(["system", "test_set"], sort=False)[measure]
    values = groups.min() if how == "min" else groups.mean()
    wide = values.unstack("test_set").loc[scores.system.unique(), scores.test_set.unique()]
    shown = wide.map(lambda value: MISSING if pd.isna(value) else form.format(value))
    sides = ("left", *["right"] * len(shown.columns))
    return shown.to_markdown(disable_numparse=True, colalign=sides)


def figure(scores: pd.DataFrame, prices: pd.DataFrame):
    """Draw accuracy against time: one panel a test set, one mark a system.

    Returns
    -------
    matplotlib.figure.Figure
    """
    scores = _clean(scores)
    sets = list(scores.test_set.unique())
    columns = min(len(sets), 3)
    rows = -(-len(sets) // columns)
    drawn, axes = plt.subplots(
        rows, columns, figsize=(4.6 * columns, 3.4 * rows + 1.4), sharex=True, squeeze=False,
        layout="constrained",
    )  # fmt: skip
    milliseconds = prices.set_index("system")["milliseconds"]
    trained = prices.set_index("system")["parameters"] > 0
    names = [name for name in scores.system.unique() if pd.notna(milliseconds.get(name))]
    for axis, test_set in zip(axes.flat, sets, strict=False):
        means = scores[scores.test_set == test_set].groupby("system")["psnr_db"].mean()
        for k, name in enumerate(names):
            axis.plot(
                milliseconds[name], means.get(name, float("nan")), "o" if trained[name] else "s",
                color=_colour(k), markersize=8, label=name,
            )  # fmt: skip
        axis.set_xscale("log")
        axis.set_title(test_set, fontsize=10)
        axis.grid(alpha=0.3)
    for axis in axes.flat[len(sets) :]:
        axis.axis("off")
    for axis in axes[:, 0]:
        axis.set_ylabel("PSNR against all views (dB)")
    for axis in axes[-1]:
        axis.set_xlabel("milliseconds for a frame")
    handles, labels = axes.flat[0].get_legend_handles_labels()
    drawn.legend(handles, labels, ncols=2, loc="outside lower center", fontsize=9)
    return drawn


def _colour(number: int):
    """Take one of twenty colours, the strong ones first."""
    return plt.get_cmap("tab20")((2 * number + number // 10) % 20)
