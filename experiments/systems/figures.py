"""Pictures of the benchmark (`experiments.systems.benchmark`)."""

import matplotlib
import numpy as np
import pandas as pd

from lf_flame._common.figures import subplots

SHOWN_DB = (15.0, 70.0)
"""Range of the axis; what is better, or exact, or worse stands at its edge as a triangle."""

PANELS = ("flames", "flames, order reversed", "flames, round aperture", "lytro_2067")
"""Test sets that are drawn: as in training, at other depths, another aperture, a photograph."""

TITLES = {"lytro_2067": "photograph (Lytro)"}
"""Titles of panels whose test set is named after a file."""


def figure(scores: pd.DataFrame, costs: pd.DataFrame):
    """Draw the accuracy of each system: one row a system, the fastest first, one panel a test set.

    All test sets are in the table; the picture has those of `PANELS`, or the first four. Scores
    have the columns of `experiments.systems.benchmark.COLUMNS`; without noise.
    """
    known = list(scores.test_set.unique())
    sets = [name for name in PANELS if name in known] or known[:4]
    times = costs.set_index("system").milliseconds.dropna().sort_values()
    drawn, axes = subplots(
        1, len(sets), figsize=(4.5 + 2.2 * len(sets), 1.2 + 0.3 * len(times)), sharey=True,
        squeeze=False, layout="constrained",
    )  # fmt: skip
    for axis, test_set in zip(axes[0], sets, strict=True):
        means = scores[scores.test_set == test_set].groupby("system")["psnr_db"].mean()
        for row, name in enumerate(times.index):
            value = means.get(name, np.nan)
            marker = "<" if value < SHOWN_DB[0] else ">" if value > SHOWN_DB[1] else "o"
            colour = "tab:orange" if "(ours)" in name else "tab:blue"
            axis.plot(np.clip(value, *SHOWN_DB), row, marker, color=colour, clip_on=False)
        axis.set(xlim=SHOWN_DB, xlabel="PSNR (dB); triangle: beyond")
        axis.set_title(TITLES.get(test_set, test_set), fontsize=10)
        axis.grid(alpha=0.3)
    names = [f"{name}: {time:.3g} ms" for name, time in times.items()]
    axes[0, 0].set_yticks(range(len(times)), names, fontsize=9)
    axes[0, 0].invert_yaxis()
    return drawn


def noise_figure(scores: pd.DataFrame):
    """Draw PSNR by light: one row a system, the best in little light first, a panel a test set."""
    means = scores.pivot_table("psnr_db", "system", ["test_set", "electrons"], sort=False)
    sets, light = list(means.columns.unique(0)), sorted(means.columns.unique(1))
    means = means.loc[means.xs(light[0], axis=1, level=1).mean(axis=1).sort_values().index]
    drawn, axes = subplots(
        1, len(sets), figsize=(4.5 + 3.2 * len(sets), 1.6 + 0.3 * len(means)), sharey=True,
        squeeze=False, layout="constrained",
    )  # fmt: skip
    colours = matplotlib.colormaps["viridis_r"](np.linspace(0.15, 1, len(light)))
    for axis, test_set in zip(axes[0], sets, strict=True):
        for electrons, colour in zip(light, colours, strict=True):
            values = means[test_set, electrons].clip(lower=SHOWN_DB[0])
            axis.plot(values, means.index, "o", color=colour, label=f"{electrons:g}", clip_on=False)
        low, high = means[test_set].min(axis=1), means[test_set].max(axis=1)
        axis.hlines(means.index, low.clip(lower=SHOWN_DB[0]), high, color="0.8", lw=1, zorder=0)
        axis.set(title=test_set, xlabel="PSNR against all views without noise (dB)")
        axis.grid(alpha=0.3)
    drawn.legend(
        *axes[0, 0].get_legend_handles_labels(), ncols=len(light), loc="outside upper center",
        title="electrons in a pixel at full scale", frameon=False,
    )  # fmt: skip
    return drawn
