"""Tables and figures of the study of costs (`experiments.costs.rendering`), from its record."""

import math
from fractions import Fraction
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.lines import Line2D

from experiments.costs.integration_methods import METHODS
from experiments.report import markdown, write_report
from lf_flame._common.figures import subplots

LEVELS = (0.1, 0.01, 0.001)
"""Errors for which the table gives the seconds."""

MARKED_LEVEL = 0.01
"""Error at which the figure gives the seconds."""

STYLES = {
    "midpoint": ("#009E73", "^"),
    "thin": ("#0072B2", "D"),
    "exact": ("#000000", "*"),
}
"""Colour and marker of each method, told apart by colour-blind readers as well."""

EFFECTS = {
    "effect": ("effect", ""),
    "bound": ("bound", lambda x: f"{math.inf if pd.isna(x) else x:.2g}"),
    "error_max": ("largest change", ".2g"),
    "error_rms": ("rms change", ".2g"),
    "seconds_off": ("without (s)", ".4f"),
    "seconds_on": ("with (s)", ".4f"),
    "seconds_added": ("adds (s)", "+.4f"),
    "seconds_spread": ("spread (s)", ".4f"),
    "seconds_planned": ("plan says (s)", ".4f"),
    "integrator": ("integrator", ""),
    "criterion": ("criterion", ""),
}

WHOLE = {
    "data": ("data set", ""),
    "integrator": ("integrator", ""),
    "tolerance": ("tolerance", "g"),
    "pixels": ("million pixels", lambda n: f"{n / 1e6:.1f}"),
    "cores": ("cores", "g"),
    "seconds": ("took (s)", ".2f"),
    "seconds_planned": ("plan says (s)", ".2f"),
    "error": ("error", ".1e"),
}

SETTINGS = {
    "scene": ("scene", ""),
    "method": ("method", ""),
    "rays_per_pixel": ("rays_per_pixel", "g"),
    "seconds": ("seconds", ".3g"),
    "error": ("error", ".2e"),
}


def measured_exponent(points: pd.DataFrame) -> float:
    """Fit the exponent with which the error falls with the rays, over the finer half of settings.

    For rows of one scene and method, with columns rays_per_pixel and error; NaN for fewer than two.
    """
    fine = points.iloc[len(points) // 2 :] if len(points) > 3 else points
    if len(fine) < 2:
        return math.nan
    return float(-np.polyfit(np.log(fine["rays_per_pixel"]), np.log(fine["error"]), 1)[0])


def seconds_for(points: pd.DataFrame, level: float) -> tuple[float, str]:
    """Seconds that a method takes for an error, read off its curve between two settings.

    For rows of one scene and method, by growing rays, with columns rays_per_pixel, seconds and
    error. NaN where the error does not fall. The sign is "" where measured; "<" where the coarsest
    of several settings errs less; "~" where none does, and the curve is continued with its own
    exponent.
    """
    seconds, errors = points["seconds"].to_numpy(), points["error"].to_numpy()
    below = np.flatnonzero(errors <= level)
    if below.size == 0:
        exponent = measured_exponent(points)
        if not exponent > 0.1:
            return math.nan, ""
        return seconds[-1] * (errors[-1] / level) ** (1 / exponent), "~"
    k = below[0]
    if k == 0:
        return seconds[0], "<" if points["rays_per_pixel"].iloc[0] else ""
    share = math.log(errors[k - 1] / level) / math.log(errors[k - 1] / errors[k])
    return seconds[k - 1] * (seconds[k] / seconds[k - 1]) ** share, ""


def write_reports(out: Path, record: dict) -> Path:
    """Write ``costs.md``, its tables, picture and record, and ``light_field.*``."""
    title = "Accuracy against time for a whole light field"
    write_report(out, "light_field", title, {"whole": record["whole"]}, light_field_body(record))
    accuracy, effects = pd.DataFrame(record["accuracy"]), pd.DataFrame(record["effects"])
    return write_report(
        out, "costs", "What accuracy costs in time", record, body(record),
        tables={"accuracy": accuracy, "effects": effects},
        pictures={"costs": accuracy_figure(record)},
    )  # fmt: skip


def body(record: dict) -> list[str]:
    """Write the tables and what they rest on as Markdown."""
    studies = record["studies"]
    scenes = "\n".join(
        f"- {name}: {study['title']}; {_size(study)[0]} of {study['camera']['lenslets'][0]} x "
        f"{study['camera']['lenslets'][1]} lenslets, {_size(study)[1]:.3g} million pixels"
        for name, study in studies.items()
    )
    return [
        scenes,
        """On one thread. Error: root-mean-square over the image, relative to its brightest pixel,
against the closed form in float64, whose own error is rounding (below 1e-12). Seconds: from scene
to image, the fastest of a few runs, compiled beforehand.""",
        "## Seconds to reach an error",
        """Read off the line between two settings. `<`: the coarsest setting errs less; `~`: no
setting got there, and the curve is continued with its own exponent. Exponent: the error falls as
the number of rays to minus this, fitted over the finer half of the settings, and by theory for a
picture with edges out of focus. (Midpoints lie on a lattice, which some numbers of rays make
uneven.)""",
        _levels_table(studies, pd.DataFrame(record["accuracy"])),
        "The whole light field, on all cores: [light_field.md](light_field.md).",
        "## Effects",
        """A small flame with what calls for the effect: `render` with the effect forced on and
forced off, all else as planned, with planning and the choice of the number of rays. Changes are
relative to the brightest pixel; the bound is the plan's, for any pixel (for noise:
root-mean-square; `inf`: where something opaque may hide all, the plan knows no brightest pixel).
Spread: by how much the runs differ.""",
        markdown(record["effects"], EFFECTS),
        "## All settings",
        markdown(record["accuracy"], SETTINGS),
    ]


def light_field_body(record: dict) -> list[str]:
    """Write the times and errors of whole light fields as Markdown."""
    return [
        """A scene of each data set as its camera records it, on all cores, from scene to light
field: with planning and, for rays, the search for their number. The plan's estimate is for one
core, divided by their number. Error: root-mean-square relative to the brightest pixel, against the
closed form.""",
        markdown(record["whole"], WHOLE, missing="no closed form"),
    ]


def _size(study: dict) -> tuple[str, float]:
    """Give the views in words, and millions of pixels."""
    views = study["camera"]["views"]
    return f"{views} x {views} views", views**2 * math.prod(study["camera"]["lenslets"]) / 1e6


def _theory(study: dict, name: str) -> float | None:
    """Exponent by theory for a scene, in which layers hide others or not."""
    hides = any(layer["opaque"] for layer in study["layers"])
    return (hides and METHODS[name].theory_hidden) or METHODS[name].theory


def _points(accuracy: pd.DataFrame, scene: str, name: str) -> pd.DataFrame:
    return accuracy[(accuracy["scene"] == scene) & (accuracy["method"] == name)]


def _levels_table(studies: dict, accuracy: pd.DataFrame) -> str:
    rows = []
    for scene, study in studies.items():
        for name, method in METHODS.items():
            points = _points(accuracy, scene, name)
            row = {"scene": scene, "method": method.label}
            for level in LEVELS:
                seconds, sign = seconds_for(points, level)
                row[f"{level:g}"] = f"{sign}{_brief(seconds)} s" if seconds > 0 else "out of reach"
            row["smallest error"] = f"{points['error'].min():.1e}"
            row["exponent"] = f"{measured_exponent(points):.2f}" if len(points) > 1 else ""
            row["theory"] = f"{_theory(study, name):.3g}" if method.theory else ""
            rows.append(row)
    return markdown(rows)


def _brief(value: float) -> str:
    """Two digits, without an exponent where that is short."""
    return f"{value:.1e}" if value >= 1e5 else f"{float(f'{value:.2g}'):g}"


def accuracy_figure(record: dict):
    """Draw error against seconds, one panel a scene, with the slopes that theory gives."""
    studies, accuracy = record["studies"], pd.DataFrame(record["accuracy"])
    figure, axes = subplots(
        1, len(studies), figsize=(5.0 * len(studies), 6.4), sharex=True, sharey=True, squeeze=False,
        layout="constrained",
    )  # fmt: skip
    span = accuracy["seconds"].min() / 2, 5 * accuracy["seconds"].max()
    for (scene, study), axis in zip(studies.items(), axes[0], strict=True):
        axis.set_xscale("log")
        axis.set_yscale("log")
        axis.axhline(MARKED_LEVEL, color="0.5", linewidth=0.8, linestyle=":")
        curves = {name: _points(accuracy, scene, name) for name in METHODS}
        for name, points in curves.items():
            _draw_theory(axis, _theory(study, name), points, span[1])
            _draw_curve(axis, name, points)
        _list_seconds(axis, curves)
        views, millions = _size(study)
        axis.set_title(f"{study['title']}\n{views}, {millions:.2g} million pixels", fontsize=10)
        axis.set_xlabel("seconds on one thread")
        axis.grid(which="major", alpha=0.25)
    axes[0, 0].set_xlim(*span)
    axes[0, 0].set_ylim(min(1e-9, accuracy["error"].min() / 3), 3 * accuracy["error"].max())
    axes[0, 0].set_ylabel("root-mean-square error, relative to the brightest pixel")
    shown = [name for name in STYLES if (accuracy["method"] == name).any()]
    handles = [
        Line2D(
            [], [], color=STYLES[n][0], marker=STYLES[n][1], label=METHODS[n].label,
            linestyle="-" if METHODS[n].theory else "",
        )
        for n in shown
    ]  # fmt: skip
    handles.append(Line2D([], [], color="0.6", linewidth=0.8, label="slope by theory"))
    figure.legend(handles=handles, loc="outside lower center", ncols=6, fontsize=9, frameon=False)
    return figure


def _draw_curve(axis, name: str, points: pd.DataFrame) -> None:
    colour, marker = STYLES[name]
    size = 12 if marker == "*" else 4.5
    axis.plot(points["seconds"], points["error"], color=colour, marker=marker, markersize=size)
    seconds, sign = seconds_for(points, MARKED_LEVEL)
    if METHODS[name].theory and seconds > 0 and sign != "<":
        axis.plot(seconds, MARKED_LEVEL, "|", color=colour, markersize=11)


def _list_seconds(axis, curves: dict[str, pd.DataFrame]) -> None:
    """Write what each method takes for the marked error, where no curve is."""
    lines = {}
    for name, points in curves.items():
        seconds, sign = seconds_for(points, MARKED_LEVEL)
        if seconds > 0:
            lines[f"{METHODS[name].label}: {sign}{_brief(seconds)} s"] = STYLES[name][0]
    lines = {f"to an error of {MARKED_LEVEL:.0%} (~ extrapolated)": "0.3", **lines}
    for k, (line, colour) in enumerate(reversed(lines.items())):
        axis.text(
            0.97, 0.02 + 0.03 * k, line, transform=axis.transAxes, fontsize=8, color=colour,
            horizontalalignment="right",
        )  # fmt: skip


def _draw_theory(axis, exponent: float | None, points: pd.DataFrame, until: float) -> None:
    """Draw the slope of theory through the middle of a curve's finer half."""
    if exponent is None or len(points) < 2:
        return
    fine = points.iloc[len(points) // 2 :]
    seconds, error = (np.exp(np.log(fine[column]).mean()) for column in ("seconds", "error"))
    ends = np.array([points["seconds"].iloc[0], until])
    errors = error * (ends / seconds) ** -exponent
    axis.plot(ends, errors, color="0.6", linewidth=0.8, zorder=0)
    axis.annotate(
        f"$N^{{-{Fraction(exponent)}}}$", (ends[1], errors[1]), (3, 0), textcoords="offset points",
        fontsize=9, color="0.4", verticalalignment="center", annotation_clip=False,
    )  # fmt: skip
