"""Pictures of the benchmark (`experiments.systems.benchmark`)."""

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, NullFormatter

from lf_flame._common.figures import subplots

SHOWN_DB = (15.0, 70.0)
"""Range of the axis; what is better, or exact, or worse stands at its edge as a triangle."""

COLUMNS = 4


def figure(scores: pd.DataFrame, costs: pd.DataFrame):
    """Draw accuracy against time: one panel a test set, one mark a system.

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
    sets = list(scores.test_set.unique())
    rows = -(-len(sets) // COLUMNS)
    drawn, axes = subplots(
        rows, COLUMNS, figsize=(3.6 * COLUMNS, 3.3 * rows + 1.4), sharex=True, sharey=True,
        squeeze=False, layout="constrained",
    )  # fmt: skip
    axes = axes.ravel()
    numbered = costs.assign(number=range(len(costs))).set_index("system")
    shown = numbered.dropna(subset="milliseconds")
    for axis, test_set in zip(axes, sets, strict=False):
        means = scores[scores.test_set == test_set].groupby("system")["psnr_db"].mean()
        _panel(axis, means, shown)
        axis.set_title(test_set, fontsize=10)
    for k, axis in enumerate(axes):
        if k % COLUMNS == 0:
            axis.set_ylabel("PSNR against all views (dB)")
        if len(sets) - COLUMNS <= k < len(sets):  # the last of its column
            axis.set_xlabel("milliseconds for a frame")
            axis.tick_params(labelbottom=True)
        if k >= len(sets):
            axis.axis("off")
    handles = [
        Line2D([], [], ls="", label=name, **_mark(name, shown, 0.5 * sum(SHOWN_DB)))
        for name in shown.index
    ]
    drawn.legend(handles=handles, ncols=3, loc="outside lower center", frameon=False, fontsize=10)
    return drawn


def _panel(axis, means: pd.Series, shown: pd.DataFrame) -> None:
    for name in shown.index:
        value = means.get(name, np.nan)
        axis.plot(
            shown.milliseconds[name], np.clip(value, *SHOWN_DB), ls="", clip_on=False, zorder=3,
            **_mark(name, shown, value),
        )  # fmt: skip
    axis.set(xscale="log", ylim=SHOWN_DB)
    axis.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axis.xaxis.set_major_formatter("{x:g}")
    axis.xaxis.set_minor_formatter(NullFormatter())
    axis.grid(alpha=0.3)


def _mark(name: str, shown: pd.DataFrame, value: float) -> dict:
    """Choose how a system is drawn: ours as stars, formulas as squares, networks as dots."""
    style = {"color": _colour(shown.number[name]), "markersize": 8, "markeredgecolor": "black"}
    style["markeredgewidth"] = 0.5
    if _is_ours(name):
        style |= {"marker": "*", "markersize": 16}
    else:
        style["marker"] = "s" if shown.parameters[name] == 0 else "o"
    if not SHOWN_DB[0] <= value <= SHOWN_DB[1]:
        style["marker"] = "^" if value > SHOWN_DB[1] else "v"
    return style


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
