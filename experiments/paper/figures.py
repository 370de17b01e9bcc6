"""Figures 7 and 8 of the paper, sharpness against slope, and how networks learn."""

import numpy as np
from matplotlib.font_manager import FontProperties
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter
from scipy.ndimage import uniform_filter

from lf_flame._common.figures import subplots
from lf_flame.lightfield import LightField
from lf_flame.refocus.figures import draw_searches, shown_slope

LENSLETS_ENLARGED = 12
"""Lenslets along each side of the part of the raw image that is shown enlarged."""


def enlarged_part(views: np.ndarray) -> tuple[int, int]:
    """Find the lenslets whose micro-images change most both ways: the corner (t, s) of the part."""
    down, across = (views.mean(axis=axis).std(axis=0) for axis in (1, 0))
    uneven = uniform_filter(down * across, LENSLETS_ENLARGED, mode="constant")
    places = zip(np.unravel_index(uneven.argmax(), uneven.shape), uneven.shape, strict=True)
    t, s = (
        int(np.clip(k - LENSLETS_ENLARGED // 2, 0, max(n - LENSLETS_ENLARGED, 0)))
        for k, n in places
    )
    return t, s


def result_figure(
    light_field: LightField, light_field_image, targets, predictions, depths_mm, title: str
):
    """Figures 7 and 8 of the paper: input, ground truth, prediction, and the error they leave out.

    Parameters
    ----------
    light_field : LightField
        Shown as the raw lenslet image, with a part enlarged in which micro-images are seen.
    light_field_image : ndarray, shape (h, w) or (h, w, 3), values in [0, 1]
        What the network is shown of it.
    targets, predictions : ndarray, shape (planes, h, w), values in [0, 1]
    """
    planes = len(targets)
    errors = predictions - targets
    limit = max(np.abs(errors).max(), 1e-6)
    figure, axes = subplots(3, planes + 1, figsize=(2.7 * (planes + 1), 4.9), layout="constrained")
    for axis in axes.flat:
        axis.set_xticks([])
        axis.set_yticks([])
    _draw_raw(axes[0, 0], axes[1, 0], light_field)
    axes[2, 0].imshow(light_field_image, cmap="gray", vmin=0, vmax=1)
    axes[2, 0].set_title("what the network sees", fontsize=10)
    for k, depth in enumerate(depths_mm):
        axes[0, k + 1].set_title(f"{depth:g} mm", fontsize=10)
        axes[0, k + 1].imshow(targets[k], cmap="gray", vmin=0, vmax=1)
        axes[1, k + 1].imshow(predictions[k], cmap="gray", vmin=0, vmax=1)
        error = axes[2, k + 1].imshow(errors[k], cmap="RdBu_r", vmin=-limit, vmax=limit)
    labels = ("(b) ground truth", "(c) prediction", "(d) error, (c) − (b)")
    for row, label in enumerate(labels):
        axes[row, 1].set_ylabel(label, fontsize=10)
    figure.colorbar(error, ax=axes[2, 1:], fraction=0.05, aspect=12)
    figure.suptitle(title, fontsize=11)
    return figure


def _draw_raw(whole, enlarged, light_field: LightField) -> None:
    """Draw a raw lenslet image, and enlarged its part in which micro-images change most."""
    raw, n = light_field.to_raw(), light_field.views.shape[0]
    whole.imshow(raw, cmap="gray", vmin=0, vmax=1, interpolation_stage="data")
    whole.set_title("(a) raw light-field image", fontsize=10)
    t, s = (n * k for k in enlarged_part(light_field.views))
    side = n * LENSLETS_ENLARGED
    whole.add_patch(Rectangle((s - 0.5, t - 0.5), side, side, fill=False, color="C1", lw=1.2))
    part = raw[t : t + side, s : s + side]
    enlarged.imshow(part, cmap="gray", vmin=0, vmax=max(float(part.max()), 1e-6))
    enlarged.set_title(f"{LENSLETS_ENLARGED} x {LENSLETS_ENLARGED} of its lenslets", fontsize=10)
    for spine in enlarged.spines.values():
        spine.set(color="C1", linewidth=1.2)


def sharpness_figure(panels):
    """Sharpness of layers against slope, with the slopes of the geometry and of the paper.

    Panels are layers by title: label, search, slope by geometry, slope in the paper (NaN: not
    printed).
    """
    figure, axes = subplots(
        len(panels),
        figsize=(11, 1 + 2.9 * len(panels)),
        sharex=True,
        squeeze=False,
        layout="constrained",
    )
    monospace = FontProperties(family="monospace", size=8.5)
    for axis, (title, layers) in zip(axes[:, 0], panels.items(), strict=True):
        width = max(len(label) for label, *_ in layers)
        rows = [
            f"{label:{width}}{shown_slope(search.slope, 3):>8}{shown_slope(there, 3):>10}"
            f"{shown_slope(printed, 2):>7}"
            for label, search, there, printed in layers
        ]
        draw_searches(axis, [search for _, search, *_ in layers], rows)
        for k, (_, _, there, printed) in enumerate(layers):
            _mark_slopes(axis, there, printed, f"C{k}")
        axis.set_ylim(0, 1.25)
        axis.set_title(title, fontsize=11, loc="left")
        legend = axis.legend(
            title=f"{'':{width + 4}}{'found':>8}{'geometry':>10}{'paper':>7}",
            prop=monospace,
            title_fontproperties=monospace,
            loc="upper left",
            bbox_to_anchor=(1.01, 1),
            handlelength=2,
        )
        legend.set_alignment("left")
    axes[-1, 0].set_xlabel("slope (lenslets per view step)")
    marks = {"found: peak of the curve": "o", "paper: as printed": "v"}
    handles = [Line2D([], [], color="black", linestyle="--", label="geometry: closed form")]
    handles += [
        Line2D([], [], color="black", linestyle="", marker=marker, label=label)
        for label, marker in marks.items()
    ]
    figure.legend(handles=handles, ncols=3, fontsize=9, loc="outside upper left")
    return figure


def _mark_slopes(axis, geometry: float, paper: float, color: str) -> None:
    """Mark both slopes above a curve, and by how much they differ if it is to be seen."""
    axis.plot([geometry] * 2, [0, 1.2], "--", color=color, linewidth=1)
    axis.plot([paper, geometry], [1.12] * 2, "-", color=color, linewidth=1.5)
    axis.plot(paper, 1.12, "v", color=color, markersize=9, markeredgecolor="black")
    if abs(paper - geometry) > 0.05:  # the step of the paper's search
        axis.annotate(
            f"paper {paper - geometry:+.2f}",
            (max(paper, geometry), 1.12),
            (5, 0),
            textcoords="offset points",
            color=color,
            va="center",
        )


FEW_EPOCHS = 60
"""Up to which each epoch is marked."""


def draw_learning(axis, curves: dict, names: dict[str, str] | None = None) -> None:
    """Draw validation PSNR against seconds, a line for each run, its best epoch marked.

    Curves have the columns ``seconds`` since the run was started, and ``val_psnr_db``. Names stand
    in the order of their colours; runs of one name have one colour.
    """
    names = {run: run for run in curves} if names is None else names
    colours = {name: f"C{k}" for k, name in enumerate(dict.fromkeys(names.values()))}
    for run, curve in curves.items():
        style = {"color": colours[names[run]], "lw": 1, "markersize": 3, "label": names[run]}
        marked = ".-" if len(curve) <= FEW_EPOCHS else "-"
        axis.plot(curve.seconds, curve.val_psnr_db, marked, **style)
        best = curve.loc[curve.val_psnr_db.idxmax()]
        axis.plot(best.seconds, best.val_psnr_db, "o", color=style["color"], markersize=6)
    axis.set_xscale("log")
    # 1 and 3 are half a decade apart, so that no two labels meet.
    axis.xaxis.set_major_locator(LogLocator(subs=(1, 3)))
    axis.xaxis.set_major_formatter(StrMethodFormatter("{x:,g}"))
    axis.xaxis.set_minor_formatter(NullFormatter())
    axis.set_xlabel("seconds since the run was started, the data set on disk")
    axis.set_ylabel("PSNR of the validation split (dB)")
    axis.grid(alpha=0.3, which="both")


def learning_figure(panels: dict, printed: dict, names: dict[str, str] | None = None):
    """Draw how runs learnt, one panel a data set, over what the paper prints for its planes.

    Panels are curves by run, see `draw_learning`, by title.
    """
    figure, axes = subplots(
        1, len(panels), figsize=(6.5 * len(panels), 5.8), squeeze=False, layout="constrained"
    )
    names = names or {run: run for curves in panels.values() for run in curves}
    shown: dict = {}
    for axis, (title, curves) in zip(axes[0], panels.items(), strict=True):
        low, high = min(printed[title]), max(printed[title])
        axis.axhspan(low, high, color="0.85", label="the paper's planes, on its test split")
        draw_learning(axis, curves, names)
        on = [
            f"{names[run]}: on {x}"
            for run, rows in curves.items()
            if (x := rows.attrs.get("devices"))
        ]
        axis.set_title("\n".join([title, *dict.fromkeys(on)]), fontsize=11)
        handles, labels = axis.get_legend_handles_labels()
        shown |= dict(zip(labels, handles, strict=True))
    figure.legend(shown.values(), shown, fontsize=9, ncols=4, loc="outside lower center")
    return figure
