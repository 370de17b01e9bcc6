"""Measurements of a flame in the frames of a video: their table, flicker, figure and record."""

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np

from lf_flame._common import figures
from lf_flame._common.output_folders import OutputFolder
from lf_flame.errors import InputError
from lf_flame.flame_video import processing
from lf_flame.flame_video.flame_shape import DOUBTS, row_error
from lf_flame.flame_video.flicker import Flicker, find_flicker

RECORD, TABLE, PICTURE = "flicker.json", "flame.csv", "flicker.png"

MEASURES = ("height", "tip_row", "width", "area", "brightness")

RESULTS = ("frequency_hz", "peak_hz", "amplitude", "false_alarm", "resolution_hz", "resolvable")


@dataclass
class FlameSeries:
    """Measurements of all frames.

    `measures` has the columns `MEASURES`, NaN without a flame, and `doubts` the sentences on each
    frame. Lengths are in pixels if `pixel_mm` is None.
    """

    times_s: np.ndarray
    names: Sequence[str]
    pixel_mm: float | None
    level: float
    measures: np.ndarray
    doubts: list[list[str]]

    @property
    def unit(self) -> str:
        """Unit of lengths."""
        return "px" if self.pixel_mm is None else "mm"

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
    names = (*MEASURES, "state", "doubts", "time")
    *columns, state, bits, times = (processing.read_array(group, name, path) for name in names)
    counted = group["time"].attrs.get("units") != "s"
    if counted != (frames_per_second is not None):
        raise InputError(
            f"{path} counts frames: state --frames-per-second."
            if counted
            else f"{path} holds the times of its frames: leave out --frames-per-second."
        )
    frames, options = dict[str, Any](group.attrs)["frames"], dict[str, Any](group["height"].attrs)
    doubts = [[x for k, x in enumerate(DOUBTS.values()) if bit >> k & 1] for bit in bits]
    for number in np.flatnonzero(state == processing.UNUSABLE):
        doubts[number].append("The frame is unusable.")
    return FlameSeries(
        times / (frames_per_second or 1.0),
        [name or f"frame {number}" for number, name in enumerate(frames)],
        options.get("pixel_mm"),
        options.get("level", 0.5),
        np.column_stack(columns),
        doubts,
    )


def write_flicker(series: FlameSeries, folder: OutputFolder) -> tuple[Flicker | None, list[str]]:
    """Find the flicker; write the table, the figure and the facts of the record; give warnings.

    The flicker is None if too few frames have a height.
    """
    heights, found, warnings = series.measures[:, 0], None, series.warnings()
    resolvable = row_error(series.level) * (series.pixel_mm or 1.0)
    try:
        found = find_flicker(series.times_s, heights, resolvable=resolvable)
    except InputError as error:  # the heights are useful without a frequency
        warnings.append(str(error))
    _write_table(series, folder.path(TABLE))
    figures.save(_figure(series, found), folder.path(PICTURE))
    known = heights[np.isfinite(heights)]
    folder.facts |= {
        "frames": len(heights),
        "frames_with_flame": len(known),
        "level": series.level,
        "pixel_mm": series.pixel_mm,
        "unit": series.unit,
        "mean_height": float(known.mean()) if len(known) else None,
        "standard_deviation_of_height": float(known.std()) if len(known) else None,
        "flicker": found and {name: getattr(found, name) for name in RESULTS},
        "warnings": warnings,
    }
    return found, warnings


def _write_table(series: FlameSeries, path: Path) -> None:
    unit = series.unit
    header = [f"height_{unit}", "tip_row", f"width_{unit}", f"area_{unit}2", "brightness"]
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["frame", "time_s", *header, "source", "warnings"])
        for number, row in enumerate(series.measures):
            time, said = f"{series.times_s[number]:.15g}", " ".join(series.doubts[number])
            numbers = [f"{x:.7g}" for x in row]
            writer.writerow([number, time, *numbers, series.names[number], said])


def _figure(series: FlameSeries, found: Flicker | None):
    """Height against time, and its spectrum with the level of a false alarm."""
    figure, (top, below) = figures.subplots(2, 1, figsize=(9, 6.5), layout="constrained")
    times_s, heights = series.times_s, series.measures[:, 0]
    top.plot(times_s, heights, "." * (len(heights) < 300) + "-", linewidth=0.8, markersize=4)
    top.set(xlabel="time (s)", ylabel=f"height ({series.unit})")
    below.set(xlabel="frequency (Hz)", ylabel="share of the scatter", title="too few heights")
    if found is not None:
        below.plot(found.frequencies_hz, found.power, linewidth=0.9)
        below.axhline(found.level, color="C7", linestyle=":", label="noise is below in 99 %")
        below.legend(fontsize=8)
        below.set_title(fill(found.describe(unit=series.unit), 100), fontsize=9)
    return figure
