"""The report on emission by depth, whose parts are measured together or one by one."""

import json
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from experiments.emission import planes, soot, truth
from experiments.emission.rivals import refocused
from experiments.report import markdown, write_report
from lf_flame._common import provenance
from lf_flame._common.figures import subplots
from lf_flame.tomography import reconstruct


class Part(NamedTuple):
    """Title and text of a part, and the functions that measure the rows of its tables."""

    title: str
    text: str
    tables: dict[str, Callable[[np.random.Generator], Iterator[dict]]]


PARTS = {
    "planes": Part(
        "Emission by planes",
        "Light fields are traced by rays that share no line with the package. `reconstruct` is "
        "called as a user calls it; all other methods get the same light field, grid and noise. "
        "Refocused images are deconvolved with the strength, of six, of least true error, which no "
        "user could choose; SART and LSQR stop where the residual is the noise that `reconstruct` "
        "measured, or after 300 iterations. Errors are root-mean-square over all cells, relative "
        "to the truth's root mean square. Sheets, disc, square, hollow flame: 7 x 7 views of "
        "60 x 60 lenslets, mean of three draws of the noise, four planes 4 mm apart or nine 1 mm "
        "apart. Four flames: 15 x 15 views of 90 x 180 pixels. Noise is relative to the brightest "
        "pixel.",
        {"Error": planes.known_planes, "Flames at full size": planes.large_flames},
    ),
    "round": Part(
        "Axisymmetric flames",
        "15 x 15 views of 90 x 180 pixels; `abel` finds the axis, too. Errors are root-mean-square "
        "over the volume between 3 and 97 % of the flame's height, relative to the truth; one draw "
        "of the noise. Onion peeling and PyAbel invert the central view, or the mean of all views, "
        "row by row; Daun's penalty is that, of seven, of least true error.",
        {"Error of the volume": planes.round_flame},
    ),
    "soot": Part(
        "Soot temperature from one exposure",
        "One raw image of 14 x 14 pixels under each lenslet, behind a round lens and a colour "
        "filter array (rggb, three overlapping bands of 67 nm at half height), 12 bits, and a "
        "furnace at 1473 to 1873 K for calibration; 7 x 7 views of 72 x 52 lenslets. Temperatures "
        "count where emission in red is above 20 % of its peak. One draw of the noise; 20 "
        "bootstrap draws. Thickness: found over true.",
        {"Temperature": lambda rng: soot.temperatures(soot.SOOT, rng)},
    ),
    "measured": Part(
        "Flames after measured tables",
        "As above, one exposure by the same sensor. The methane slot flame (K. C. Smyth, NIST; "
        "github.com/firemodels/exp) has the temperatures of its table, by a thermocouple across "
        "the slot at nine heights from 3 to 19 mm; it is seeded evenly with soot of optical "
        "thickness 0.1 and 12 mm deep along the line of sight, which the table does not say, and "
        "sought on three planes, which the light field hardly separates; absorption is not sought "
        "there. The ethylene flame (FM Global's burner of 15.2 cm in air; "
        "github.com/MaCFP/macfp-db) has the radial means of soot volume fraction and temperature "
        "of its table at 1 to 3.5 diameters of height, seen from 3 m. Both end where their tables "
        "end. No camera has seen these flames.",
        {"Temperature": lambda rng: soot.temperatures(soot.measured_flames(), rng)},
    ),
    "bars": Part(
        "Error bars",
        "Share of cells whose truth is within the bar of 95 %, its standard error, and the "
        "method's error, means over ten draws of the noise. "
        "Flames a quarter in size, 15 x 15 views of 72 x 84 lenslets; cells count where the truth "
        "exceeds 5 % of the plane's peak.",
        {"Emission": planes.bars},
    ),
}


def percent(value: float | str) -> str:
    """Write a share as a percentage; what is already written stays."""
    return value if isinstance(value, str) else f"{100 * value:g} %"


COLUMNS = {
    "noise": ("noise", percent),
    "error": ("error", ".3g"),
    "rms_K": ("rms (K)", ".1f"),
    "mean_K": ("bias (K)", "+.1f"),
    "scatter_K": ("scatter (K)", ".1f"),
    "covered": ("in bars of 95 %", ".1%"),
    "standard_error": ("standard error", ".1%"),
    "thickness": ("thickness", ".2f"),
}
"""Headings and formats of the columns of numbers."""


def run(out: Path, parts: list[str], seed: int) -> Path:
    """Measure parts, and write the report; other parts that OUT's report has stay in it."""
    for part in parts:
        began, rng = time.perf_counter(), np.random.default_rng(seed)
        rows = {name: list(measure(rng)) for name, measure in PARTS[part].tables.items()}
        known = provenance.environment()
        made = {name: known[name] for name in ("command", "date", "git_revision")}
        made |= {"seconds": round(time.perf_counter() - began), "tables": rows}
        pictures = {"slices": slices_figure(seed)} if part == "planes" else {}
        record = out / "emission.json"
        done = json.loads(record.read_text(encoding="utf-8"))["parts"] if record.is_file() else {}
        done[part] = made
        path = write(out, {name: done[name] for name in PARTS if name in done}, pictures)
    return path


def write(out: Path, done: dict, pictures: dict[str, Figure]) -> Path:
    """Write the report of all parts that were measured."""
    every = [
        pd.DataFrame(rows).assign(part=part, table=name)
        for part, made in done.items()
        for name, rows in made["tables"].items()
    ]
    return write_report(
        out, "emission", "Emission by depth", {"parts": done}, body({"parts": done}),
        tables={"emission": pd.concat(every)}, pictures=pictures, dpi=110,
    )  # fmt: skip


def body(record: dict) -> list[str]:
    """Text and tables of a record."""
    text = []
    for part, made in record["parts"].items():
        origin = f"`{made['command']}`, {made['date']}, {made['seconds']} s."
        text += [f"## {PARTS[part].title}", PARTS[part].text, origin]
        for name, rows in made["tables"].items():
            text += [f"### {name}", table(rows)]
    return [*text, "No real flame has been measured."]


def table(rows: list[dict]) -> str:
    """Write rows; where they hold only errors, with a column for each method."""
    frame = pd.DataFrame(rows)
    columns = {name: COLUMNS.get(name, (name, "")) for name in frame}
    if list(frame) == ["flame", "noise", "method", "error"]:
        methods = frame["method"].unique()
        frame = frame.pivot_table("error", ["flame", "noise"], "method", sort=False)
        frame = frame.reindex(columns=methods).reset_index()
        columns = {"flame": ("flame", ""), "noise": COLUMNS["noise"]}
        columns |= {method: (method, ".4f") for method in methods}
    return markdown(frame, columns)


def slices_figure(seed: int) -> Figure:
    """Draw flames behind each other, and the section of an axisymmetric flame, at 1 % of noise."""
    rng = np.random.default_rng(seed)
    case = planes.traced("", planes.PAPER, planes.behind(), planes.DEPTHS)
    light_field = planes.noisy(case.views, 0.01, rng)
    lines = {
        "truth": case.truth,
        "reconstruct": reconstruct(light_field, case.grid).emission,
        "refocused": refocused(light_field, case.grid, 0.0)[0],
    }
    widths = 1, 1, 1, 1, 1.5
    figure, axes = subplots(3, 5, figsize=(12, 8), layout="constrained", width_ratios=widths)
    for line, (word, stack) in zip(axes, lines.items(), strict=True):
        white = max(case.truth.max(), stack.max() if word == "refocused" else 0)
        for axis, plane, depth in zip(line, stack, planes.DEPTHS, strict=False):
            drawn = axis.imshow(plane[:, 55:130], cmap="inferno", vmin=0, vmax=white)
            axis.set_title(f"{word}, {depth:+g} mm", fontsize=9)
            axis.axis("off")
        figure.colorbar(drawn, ax=list(line[:4]), shrink=0.85, label="radiance")
    found = dict(planes.sections(planes.noisy(planes.round_views(), 0.01, rng)))
    heights, radii, section = found["abel, all views"][0]
    wanted = truth.round_glow(heights[:, None] / planes.HEIGHT + 0.5, radii[None], planes.RADIUS)
    for axis, word, values in zip(axes[:, 4], ("truth", "abel"), (wanted, section), strict=False):
        extent = (0, radii[-1], heights[-1], heights[0])
        drawn = axis.imshow(values, cmap="inferno", vmin=0, vmax=wanted.max(), extent=extent)
        axis.set(xlim=(0, 9), ylim=(-14, 14), facecolor="k")
        axis.set(xlabel="radius (mm)", ylabel="height (mm)")
        axis.set_title(f"axisymmetric, {word}", fontsize=9)
        figure.colorbar(drawn, ax=axis, label="emission per mm")
    axis, row = axes[2, 4], int(np.argmin(np.abs(heights)))
    axis.plot(radii, wanted[row], "k", label="truth")
    for method in ("abel, all views", "onion peeling, central view"):
        rows, places, values = found[method][0]
        axis.plot(places, values[np.argmin(np.abs(rows))], linewidth=1, label=method)
    axis.set(xlim=(0, 9), xlabel="radius (mm), at 0 mm of height", ylabel="emission per mm")
    axis.legend(fontsize=7, loc="lower left")
    return figure
