"""Measurements of a flame in the frames of a video: their table, flicker, figure and record."""

import csv
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np

from lf_flame._common import figures
from lf_flame._common.output_folders import OutputFolder
from lf_flame.errors import InputError
from lf_flame.flame_video import processing
from lf_flame.flame_video.flame_shape import DOUBTS, row_error
from lf_flame.flame_video.flicker import Flicker, find_flicker, find_outliers

RECORD, TABLE, PICTURE = "flicker.json", "flame.csv", "flicker.png"

MEASURES = ("height", "tip_row", "width", "area", "brightness")

REPEATED = (
    "The picture is the same as the one before in every pixel: the frame was repeated, and another "
    "one is probably lost; times by the frame rate, and so frequencies, are then wrong."
)

OUTLIER = "The height is far from that of neighbouring frames: it is left out of the frequency."

MOST_REPEATED = 0.05
"""Largest fraction of repeated frames with which times by the frame rate are used."""

CONTOURS = 5
"""Number of frames with contours in the figure."""


@dataclass
class FlameSeries:
    """Measurements of all frames, and a few contours with their times.

    `measures` has the columns `MEASURES`, NaN without a flame, and `doubts` the sentences on each
    frame. Lengths are in pixels if `pixel_mm` is None.
    """

    times_s: np.ndarray
    names: Sequence[str]
    pixel_mm: float | None
    level: float
    measures: dict[str, list[float]]
    doubts: list[list[str]]
    repeated: list[bool]
    contours: list[tuple[float, np.ndarray]] = field(default_factory=list)

    @property
    def unit(self) -> str:
        """Unit of lengths."""
        return "px" if self.pixel_mm is None else "mm"

    @property
    def heights(self) -> np.ndarray:
        """Heights of the frames."""
        return np.array(self.measures["height"])

    def warnings(self) -> list[str]:
        """Sentences on what is doubtful, each with the number of frames."""
        frames: dict[str, list[str]] = {}
        for name, doubts in zip(self.names, self.doubts, strict=True):
            for doubt in doubts:
                frames.setdefault(doubt, []).append(name)
        count = len(self.names)
        return [f"{len(x)} of {count} frames, first {x[0]}: {y}" for y, x in frames.items()]


def read_series(path: Path, frames_per_second: float | None = None) -> FlameSeries:
    """Read the measurements of a video that was processed with the step ``height``."""
    group = processing.open_video(path)
    if "height" not in group:
        raise InputError(f"{path} holds no heights: process it with the step height.")
    if processing.count_frames(group, path).counts["to_do"]:  # refuses lost files, too
        raise InputError(f"{path} is not finished: repeat the command that makes it.")
    columns = {x: processing.read_array(group, x, path).tolist() for x in MEASURES}
    state, bits, sums, times = (
        processing.read_array(group, x, path) for x in ("state", "doubts", "fingerprint", "time")
    )
    counted = group["time"].attrs.get("units") != "s"
    if counted != (frames_per_second is not None):
        raise InputError(
            f"{path} counts frames: state --frames-per-second."
            if counted
            else f"{path} holds the times of its frames: leave out --frames-per-second."
        )
    times = times / (frames_per_second or 1.0)
    frames, options = dict[str, Any](group.attrs)["frames"], dict[str, Any](group["height"].attrs)
    doubts = [[x for k, x in enumerate(DOUBTS.values()) if bit >> k & 1] for bit in bits]
    for number in np.flatnonzero(state > processing.MISSING):
        doubts[number].append(f"The frame is {processing.STATES[state[number]].replace('_', ' ')}.")
    series = FlameSeries(
        times,
        [name or f"frame {number}" for number, name in enumerate(frames)],
        options.get("pixel_mm"),
        options.get("level", 0.5),
        columns,
        doubts,
        [False, *(sums[1:] == sums[:-1]).tolist()],
    )
    if "contour" in group:
        seen = np.flatnonzero(np.isfinite(series.heights))
        some = seen[np.linspace(0, len(seen) - 1, min(CONTOURS, len(seen))).round().astype(int)]
        contours = processing.read_array(group, "contour", path)
        series.contours = [(float(times[number]), contours[number]) for number in some]
    return series


def write_flicker(
    series: FlameSeries, folder: OutputFolder, *, times_stated: bool = False
) -> tuple[Flicker | None, list[str]]:
    """Find the flicker; write the table, the figure and the facts of the record; give warnings.

    The flicker is None if too few frames have a height, or, unless each frame's time was stated,
    more than `MOST_REPEATED` of them repeat the one before.
    """
    heights, side, found = series.heights, series.pixel_mm or 1.0, None
    outliers, repeated = find_outliers(heights, least=side), np.array(series.repeated)
    repeated &= not repeated[1:].all()  # of one picture alone, nothing moves
    for numbers, doubt in ((repeated, REPEATED), (outliers, OUTLIER)):
        for number in np.flatnonzero(numbers):
            series.doubts[number].append(doubt)
    left_out, warnings = outliers | repeated, series.warnings()
    resolvable = row_error(series.level) * side
    try:
        if np.mean(repeated) > MOST_REPEATED and not times_stated:
            raise InputError(
                f"{np.count_nonzero(repeated)} of {len(repeated)} frames repeat the one before, so "
                f"that others are probably lost and times by the frame rate wrong: no frequency is "
                f"given. State the time of each frame by --timestamps FILE."
            )
        kept = np.where(left_out, np.nan, heights)
        found = find_flicker(series.times_s, kept, resolvable=resolvable)
    except InputError as error:  # the heights are useful without a frequency
        warnings.append(str(error))
    _write_table(series, folder.path(TABLE))
    figures.save(_figure(series, found, left_out), folder.path(PICTURE))
    known = heights[np.isfinite(heights)]
    folder.facts |= {
        "frames": len(heights),
        "frames_with_flame": len(known),
        "outliers": [x for x, is_one in zip(series.names, outliers, strict=True) if is_one],
        "repeated": [x for x, is_one in zip(series.names, repeated, strict=True) if is_one],
        "level": series.level,
        "pixel_mm": series.pixel_mm,
        "unit": series.unit,
        "mean_height": float(known.mean()) if len(known) else None,
        "standard_deviation_of_height": float(known.std()) if len(known) else None,
        "flicker": None if found is None else _facts(found),
        "warnings": warnings,
    }
    return found, warnings


def _facts(found: Flicker) -> dict:
    sines = {name: getattr(found, name) for name in ("lines", "swings", "unresolved")}
    names = ("frequency_hz", "resolution_hz", "false_alarm", "peak_hz", "amplitude", "resolvable")
    return {
        **{name: getattr(found, name) for name in names},
        **{name: [asdict(line) for line in some] for name, some in sines.items()},
        "noise": asdict(found.noise),
    }


def _write_table(series: FlameSeries, path: Path) -> None:
    unit = series.unit
    header = [f"height_{unit}", "tip_row", f"width_{unit}", f"area_{unit}2", "brightness"]
    rows = zip(*series.measures.values(), strict=True)
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["frame", "time_s", *header, "source", "warnings"])
        for number, row in enumerate(rows):
            time, said = f"{series.times_s[number]:.15g}", " ".join(series.doubts[number])
            numbers = [f"{x:.7g}" for x in row]
            writer.writerow([number, time, *numbers, series.names[number], said])


def _figure(series: FlameSeries, found: Flicker | None, left_out: np.ndarray):
    """Height against time, its spectrum, and contours over the mean picture."""
    figure, axes = figures.subplots(2, 2, figsize=(11, 6.5), layout="constrained")
    times_s, heights = series.times_s, series.heights
    top, below = axes[:, 0]
    top.plot(times_s, heights, "." * (len(heights) < 300) + "-", linewidth=0.8, markersize=4)
    if left_out.any():
        top.plot(times_s[left_out], heights[left_out], "C3x", label="left out of the spectrum")
        top.legend(fontsize=8)
    top.set(xlabel="time (s)", ylabel=f"height ({series.unit})")
    if found is None:
        below.set_title("no spectrum: too few heights, or repeated frames", fontsize=9)
    else:
        below.plot(found.frequencies_hz, found.power, linewidth=0.9)
        for number, line in enumerate(found.lines or (found.peak,)):
            colour = "C1" if found.lines else "C7"
            style = ":" if number else "--"
            below.axvline(line.frequency_hz, color=colour, linestyle=style, linewidth=0.9)
        title = fill(found.describe(unit=series.unit), 100)
        below.set_title(f"{title}\nresolution {found.resolution_hz:.2g} Hz", fontsize=8)
    below.set(xlabel="frequency (Hz)", ylabel="share of the variance")
    for axis in axes[:, 1]:
        axis.remove()
    axis = figure.add_subplot(axes[0, 1].get_gridspec()[:, 1], aspect="equal")
    for time, contour in series.contours:
        axis.plot(contour[:, 1], contour[:, 0], linewidth=1, label=f"{time:.3g} s")
    axis.invert_yaxis()
    axis.set(xlabel="column (pixels)", ylabel="row (pixels)", title="contours")
    if series.contours:
        axis.legend(fontsize=7)
    return figure
