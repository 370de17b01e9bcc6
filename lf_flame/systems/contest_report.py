"""Table, text and picture of the contest (`lf_flame.systems.contest`)."""

import matplotlib.pyplot as plt
import pandas as pd

MISSING = "missing"


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

{_pivot(scores, "psnr_db", "{:.2f}")}

## SSIM

{_pivot(scores, "ssim", "{:.3f}")}

## The weakest plane, PSNR (dB)

{_pivot(scores, "psnr_db", "{:.2f}", "min")}

## What is missing

{reasons or "Nothing."}
"""


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
                color=f"C{k % 10}", markersize=8, label=name,
            )  # fmt: skip
        axis.set_xscale("log")
        axis.set_title(test_set, fontsize=10)
        axis.grid(alpha=0.3)
    for axis in axes.flat[len(sets) :]:
        axis.axis("off")
    for axis in axes[:, 0]:
        axis.set_ylabel("PSNR against all views (dB)")
    for axis in axes[-1]:
        axis.set_xlabel("milliseconds for four planes")
    handles, labels = axes.flat[0].get_legend_handles_labels()
    drawn.legend(handles, labels, ncols=2, loc="outside lower center", fontsize=9)
    return drawn
