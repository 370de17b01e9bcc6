"""Table, text and figures of a learning study (`experiments.studies.study`)."""

import math
from collections.abc import Sequence
from pathlib import Path
from textwrap import fill

import numpy as np
import pandas as pd

from experiments.histories import read_history
from experiments.paper.figures import draw_learning
from experiments.paper.paper_values import read_paper_values
from experiments.report import write_report
from experiments.studies.pca_bound import MOST_SAMPLES
from lf_flame._common.config import to_json
from lf_flame._common.figures import subplots

HEADROOM_DB = 15.0
"""How far above the curves the figure follows the bound, which has no end where nothing varies."""

PAPER_TABLES = {"shapes": "table1", "flames": "table2"}
"""Table of the paper for each kind of data set."""

MEASURES = ["ssim", "psnr_db", "psnr_foreground_db", "bound_db"]
RUN = ["training_samples", "epochs", "best_epoch", "start_s", "train_s"]
COLUMNS = ["variant", "series", "x", "depth_mm", "object", *RUN, *MEASURES]
MEAN = "mean"
"""What stands under "object" where a row is the mean over the planes."""

SCORES = {"psnr_db": "PSNR (dB)", "ssim": "SSIM"}
"""What the figures show, and how they call it."""

FORMATS = {"psnr_db": "{:.2f}", "ssim": "{:.3f}"}
"""How they are written."""


def write(path: Path, study, trials: Sequence, runs: Path, paper: Path, out: Path) -> Path:
    """Write a study's table, text, figures and record; variants not yet done show as missing.

    NAME is the study file's name. ``NAME.csv`` has `COLUMNS`, one row a variant and plane, and one
    for the mean over the planes; ``NAME.md`` and ``NAME.png`` show it; of a timed study
    ``NAME_time.csv`` and ``NAME_time.png`` show validation PSNR against seconds; ``NAME.json`` is
    the record.
    """
    name, kind = path.stem, trials[0].data.kind
    printed = read_paper_values(paper, PAPER_TABLES[kind])
    scores = [trial.read_score(runs) for trial in trials]
    rows = tabulate(study.variants, scores)
    record = {
        "study": to_json(study),
        "results": {v.name: found for v, found in zip(study.variants, scores, strict=True)},
        "paper": printed["source"],
    }
    figure = bar_figure(study.title, rows, printed) if study.x is None else None
    tables = {name: rows.round(4)}
    pictures = {name: figure or curve_figure(study, rows, printed)}
    if study.timed:
        curves = read_curves(study.variants, scores, runs)
        pictures[f"{name}_time"] = time_figure(study.title, curves)
        tables[f"{name}_time"] = curves.round(4)
    written = body(study, rows, scores, printed)
    return write_report(out, name, study.title, record, written, tables=tables, pictures=pictures)


def tabulate(variants: Sequence, scores: Sequence[dict | None]) -> pd.DataFrame:
    """Put scores into a table of `COLUMNS`; a variant that is missing has a mean of NaN."""
    rows = []
    for variant, found in zip(variants, scores, strict=True):
        found = found or {"planes": []}
        about = {"variant": variant.name, "series": variant.series, "x": variant.x}
        about |= {name: found.get(name) for name in RUN}
        rows += [{**about, **plane} for plane in found["planes"]]
        means = pd.DataFrame(found["planes"], columns=MEASURES, dtype=float).mean()
        rows.append({**about, "object": MEAN, **means})
    return pd.DataFrame(rows, columns=COLUMNS).astype(dict.fromkeys(RUN, float))


def read_curves(variants: Sequence, scores: Sequence[dict | None], runs: Path) -> pd.DataFrame:
    """Read validation PSNR of each epoch and the seconds since the run was started.

    The seconds begin with the data set on disk: they hold the backbone's features and the start of
    the decoder. Columns ``variant``, ``epoch``, ``seconds``, ``val_psnr_db``.
    """
    curves = [pd.DataFrame(columns=["variant", "epoch", "seconds", "val_psnr_db"])]
    for variant, found in zip(variants, scores, strict=True):
        if found is not None:
            history = read_history(runs / variant.folder / "history.csv", found["epochs"])
            curves.append(history.assign(variant=variant.name)[curves[0].columns])
    return pd.concat(curves[1:] or curves)


def body(study, rows: pd.DataFrame, scores: Sequence, paper: dict) -> list[str]:
    """Write the table, and how it came about, as Markdown."""
    done = [found for found in scores if found is not None]
    tests = " or ".join(sorted({str(found["test_samples"]) for found in done}))
    notes = [
        f"Means over the same {tests or 0} test light fields of each data set; at each depth: the "
        f"planes at {', '.join(f'{z:g}' for z in paper['depth_mm'])} mm; foreground: over the "
        f"pixels that are foreground in the truth.",
        "Bound: the test images projected on the first 256 principal components of the training "
        f"images, {MOST_SAMPLES:,} at most (`experiments.studies.pca_bound`), what a decoder of "
        "256 pictures could reach if it were told the best numbers.",
        *["Seconds: reading the data set, backbone and start of the decoder + all epochs."]
        * study.timed,
        _origin(done),
    ]
    found = [] if study.x is None else _findings(study, rows, np.mean(paper["psnr_db"]))
    said = ["\n".join(f"- {line}" for line in found)] if found else []
    return [_markdown(study, rows, paper), *notes, *said]


def _markdown(study, rows: pd.DataFrame, paper: dict) -> str:
    """One row a variant, and one for what the paper prints."""
    means = rows[rows["object"] == MEAN].set_index("variant")
    planes = rows[rows["object"] != MEAN].groupby("variant")["psnr_db"].apply(list)
    shown = pd.DataFrame(
        {
            "variant": means.index,
            "training light fields": _shown(means["training_samples"], "{:.0f}"),
            "epochs (best)": [
                f"{epochs:.0f} ({best:.0f})" if epochs == epochs else "missing"
                for epochs, best in zip(means["epochs"], means["best_epoch"], strict=True)
            ],
            "seconds": [
                "missing" if math.isnan(s) else f"{b:.0f} + {s:.0f}"
                for b, s in zip(means["start_s"], means["train_s"], strict=True)
            ],
            "PSNR (dB)": _shown(means["psnr_db"], FORMATS["psnr_db"]),
            "at each depth": [_joined(planes.get(name, []), "{:.1f}") for name in means.index],
            "foreground": _shown(means["psnr_foreground_db"], "{:.2f}"),
            "SSIM": _shown(means["ssim"], FORMATS["ssim"]),
            "bound (dB)": _shown(means["bound_db"], "{:.2f}"),
        }
    )
    if not study.timed:
        shown = shown.drop(columns="seconds")
    if study.x is not None:
        shown.insert(1, study.x.label, [f"{x:g} {study.x.unit}".strip() for x in means["x"]])
    printed = {
        "variant": "*printed in the paper*",
        "PSNR (dB)": FORMATS["psnr_db"].format(np.mean(paper["psnr_db"])),
        "at each depth": _joined(paper["psnr_db"], "{:.1f}"),
        "SSIM": FORMATS["ssim"].format(np.mean(paper["ssim"])),
    }
    shown.loc[len(shown)] = {**dict.fromkeys(shown, ""), **printed}
    sides = ("left", *["right"] * (shown.shape[1] - 1))
    return shown.to_markdown(index=False, disable_numparse=True, colalign=sides)


def _shown(values: pd.Series, form: str) -> list[str]:
    return ["missing" if math.isnan(x) else form.format(x) for x in values.astype(float)]


def _joined(values: Sequence[float], form: str) -> str:
    return " / ".join(form.format(x) for x in values) or "missing"


def _origin(done: Sequence[dict]) -> str:
    """Say with which weights and on which machine the runs were made."""
    if not done:
        return "No variant is done yet."
    weights, machines = (
        "; ".join(dict.fromkeys(found[name] for found in done))
        for name in ("backbone_weights", "machine")
    )
    return f"Backbone weights: {weights}. Trained on {machines}."


def _findings(study, rows: pd.DataFrame, level: float) -> list[str]:
    """Say of each curve where it is above the paper's mean."""
    found = []
    for name, curve in _curves(rows):
        above, where = f"{name}: above the paper's mean of {level:.2f} dB", ""
        along = curve["x"].to_numpy(), curve["psnr_db"].to_numpy()
        falls = find_crossing(*along, level)
        rises = find_crossing(*(values[::-1] for values in along), level)
        if not math.isnan(falls):
            where = f"up to {_two_digits(falls)} {study.x.unit}".rstrip()
        elif not math.isnan(rises):
            where = f"from {_two_digits(rises)} {study.x.unit}".rstrip() + " on"
        elif (curve["psnr_db"] >= level).all():
            where = "everywhere"
        elif (curve["psnr_db"] < level).all():
            where = "nowhere"
        found.append(f"{above} {where}.")
    return found


def _two_digits(x: float) -> str:
    return f"{float(f'{x:.2g}'):,g}"


def find_crossing(x: np.ndarray, y: np.ndarray, level: float) -> float:
    """Find where a curve first falls through a level, linear between points; NaN: nowhere."""
    falls = np.flatnonzero((y[:-1] >= level) & (y[1:] < level))
    if not len(falls):
        return math.nan
    k = falls[0]
    return float(x[k] + (y[k] - level) / (y[k] - y[k + 1]) * (x[k + 1] - x[k]))


def _curves(rows: pd.DataFrame):
    """Each series with the rows of its means that are there, by growing x."""
    means = rows[(rows["object"] == MEAN) & rows["psnr_db"].notna()]
    return means.sort_values("x").groupby("series", sort=False)


def curve_figure(study, rows: pd.DataFrame, paper: dict):
    """Draw PSNR and SSIM against x, one curve a series, the range over the planes as bars."""
    figure, axes = subplots(2, figsize=(8, 8), sharex=True, layout="constrained")
    planes = rows[rows["object"] != MEAN].groupby("variant")
    for axis, (name, label) in zip(axes, SCORES.items(), strict=True):
        low, high = planes[name].min(), planes[name].max()
        for k, (series, curve) in enumerate(_curves(rows)):
            mean = curve.set_index("variant")[name]
            reach = mean - low[mean.index], high[mean.index] - mean
            axis.errorbar(curve["x"], mean, reach, fmt="o-", color=f"C{k}", capsize=3, label=series)
        axis.axhspan(min(paper[name]), max(paper[name]), color="0.85", label="the paper's planes")
        axis.set_ylabel(f"{label}, mean and range of the planes")
        axis.grid(alpha=0.3)
    bound = rows[rows["object"] == MEAN].groupby("x")["bound_db"].max().dropna()
    top = axes[0].get_ylim()[1] + HEADROOM_DB
    axes[0].plot(bound.index, bound, "k--", label="bound of 256 pictures")
    axes[0].set_ylim(top=min(top, axes[0].get_ylim()[1]))
    if study.x.scale == "log":  # linear below the first point, because x may be 0
        ticks = sorted({variant.x for variant in study.variants})
        least = min((x for x in ticks if x > 0), default=1.0)
        axes[1].set_xscale("symlog", linthresh=least, linscale=0.4)
        axes[1].set_xticks(ticks, [f"{x:g}" for x in ticks])
        axes[1].set_xlim(-least / 4 if ticks[0] == 0 else least / 1.3, 1.3 * ticks[-1])
    axes[1].set_xlabel(f"{study.x.label} ({study.x.unit})" if study.x.unit else study.x.label)
    figure.suptitle(study.title, fontsize=11)
    handles = axes[0].get_legend_handles_labels()
    figure.legend(*handles, ncols=2, fontsize=9, loc="outside lower center")
    return figure


def bar_figure(title: str, rows: pd.DataFrame, paper: dict):
    """Draw PSNR and SSIM of each variant: a point the mean, a bar the range over the planes."""
    names = list(rows["variant"].unique())[::-1]
    means = rows[rows["object"] == MEAN].set_index("variant").loc[names]
    planes = rows[rows["object"] != MEAN].groupby("variant")
    figure, axes = subplots(
        1, 2, figsize=(12, 2 + 0.5 * len(names)), sharey=True, layout="constrained"
    )
    at = range(len(names))
    for axis, (name, label) in zip(axes, SCORES.items(), strict=True):
        low, high = (extreme.reindex(names) for extreme in (planes[name].min(), planes[name].max()))
        axis.use_sticky_edges = False  # leave room beyond the first and the last bar
        axis.barh(at, high - low, left=low, height=0.5, alpha=0.35, label="range of the planes")
        axis.plot(means[name], at, "o", color="C0", label="mean")
        axis.axvline(np.mean(paper[name]), color="black", ls="--", lw=1, label="the paper's mean")
        for place, number in zip(at, _shown(means[name], FORMATS[name]), strict=True):
            axis.annotate(number, (1.01, place), xycoords=("axes fraction", "data"), va="center")
        axis.set_yticks(at, [fill(name, 32) for name in names])
        axis.set_xlabel(label)
        axis.grid(axis="x", alpha=0.3)
    figure.suptitle(title, fontsize=11)
    figure.legend(*axes[0].get_legend_handles_labels(), ncols=3, loc="outside lower center")
    return figure


def time_figure(title: str, curves: pd.DataFrame):
    """Draw validation PSNR against seconds, one line a variant; columns as of `read_curves`."""
    figure, axis = subplots(figsize=(9, 5), layout="constrained")
    draw_learning(axis, dict(iter(curves.groupby("variant", sort=False))))
    axis.set_title(title, fontsize=11)
    if len(curves):
        # Names stand in the order of the best epochs, as the points do.
        best = curves.groupby("variant")["val_psnr_db"].max()
        handles, names = axis.get_legend_handles_labels()
        order = sorted(zip(names, handles, strict=True), key=lambda pair: -best[pair[0]])
        shown = [handle for _, handle in order], [fill(name, 30) for name, _ in order]
        figure.legend(*shown, fontsize=9, loc="outside right upper")
    return figure
