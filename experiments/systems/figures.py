"""Pictures of the benchmark (`experiments.systems.benchmark`)."""

import matplotlib
import numpy as np
import pandas as pd

from lf_flame._common.figures import subplots

SHOWN_DB = (15.0, 70.0)
"""Range of the axis; what is better, or exact, or worse stands at its edge as a triangle."""

PANELS = ("flames", "flames, order reversed", "flames, round aperture", "lytro_2067")
"""Test sets that are drawn: as in training, at other depths, another aperture, a photograph."""


def figure(scores: pd.DataFrame, costs: pd.DataFrame):
    """Draw the accuracy of each system: one row a system, the fastest first, one panel a test set.

    All test sets are in the table; the picture has those of `PANELS`, or the first four.

    Parameters
    ----------
    scores : DataFrame
        Columns as in `experiments.systems.benchmark.COLUMNS`; without noise.
    costs : DataFrame
        See `experiments.systems.report.text`.

    Returns
    -------
    matplotlib.figure.Figure
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
            colour = "tab:orange" if _is_ours(name) else "tab:blue"
            axis.plot(np.clip(value, *SHOWN_DB), row, marker, color=colour, clip_on=False)
        axis.set(xlim=SHOWN_DB, xlabel="PSNR (dB)")
        axis.set_title(test_set, fontsize=10)
        axis.grid(alpha=0.3)
    names = [f"{name}: {time:.3g} ms" for name, time in times.items()]
    axes[0, 0].set_yticks(range(len(times)), names, fontsize=9)
    axes[0, 0].invert_yaxis()
    return drawn


def noise_figure(scores: pd.DataFrame):
    """Draw PSNR against light: one panel a test set, one curve a system.

    Parameters
    ----------
    scores : DataFrame
        Columns as in `experiments.systems.benchmark.COLUMNS`; with noise.

    Returns
    -------
    matplotlib.figure.Figure
    """
    seen = scores[scores.psnr_db.notna()]
    sets, names = list(seen.test_set.unique()), list(scores.system.unique())
    drawn, axes = subplots(
        1, len(sets), figsize=(5.4 * len(sets), 7.0), sharey=True, squeeze=False,
        layout="constrained",
    )  # fmt: skip
    handles = {}
    for axis, test_set in zip(axes[0], sets, strict=True):
        rows = seen[seen.test_set == test_set]
        for k, name in enumerate(names):
            curve = rows[rows.system == name].groupby("electrons")["psnr_db"].mean()
            if len(curve):
                style = {"marker": "*", "markersize": 13, "lw": 2} if _is_ours(name) else {}
                style = {"marker": "o", "markersize": 5, "lw": 1.2} | style
                (handles[name],) = axis.plot(curve.index, curve, color=_colour(k), **style)
        axis.set(xscale="log", title=test_set, xlabel="electrons in a pixel at full scale")
        axis.grid(alpha=0.3)
    axes[0, 0].set_ylabel("PSNR against all views without noise (dB)")
    axes[0, 0].set_ylim(bottom=max(axes[0, 0].get_ylim()[0], SHOWN_DB[0]))
    drawn.legend(
        handles.values(), handles.keys(), ncols=2, loc="outside lower center", fontsize=9,
        frameon=False,
    )  # fmt: skip
    return drawn


def _is_ours(name: str) -> bool:
    return "(ours)" in name


def _colour(number: int):
    """Take one of twenty colours, the strong ones first; in all pictures a system has the same."""
    return matplotlib.colormaps["tab20"]((2 * number + number // 10) % 20)
