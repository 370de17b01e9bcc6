"""Measurements of a flame in the frames of a video, one after the other."""

import csv
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from lf_flame.flame_video.flame_shape import BRIGHT_DARK, measure_flame
from lf_flame.lightfield import LightField
from lf_flame.refocus import shift_and_sum

REPEATED = (
    "The picture is the same as the one before in every pixel: the frame was repeated, and another "
    "one is probably lost; times by the frame rate, and so frequencies, are then wrong."
)

CONTOURS = 5
"""Number of frames with contours in the figure."""


@dataclass(frozen=True)
class Measures:
    """Options for measuring the flame of a frame.

    Attributes
    ----------
    slope : float or None
        Slope at which frames are refocused; None takes the central view.
    level : float
        Level of the contour as a fraction of the peak.
    pixel_mm : float or None
        Side of a pixel in mm at the flame; None for lengths in pixels.
    burner_row : float or None
        Row from which heights are measured; None for the lower edge.
    """

    slope: float | None = None
    level: float = 0.5
    pixel_mm: float | None = None
    burner_row: float | None = None

    @property
    def unit(self) -> str:
        """Unit of lengths."""
        return "px" if self.pixel_mm is None else "mm"

    def place(self, rows, columns, shape: tuple[int, int]):
        """Positions of rows and columns: across from the centre and up from the burner, in mm.

        Without a scale they are columns and rows in pixels, unchanged.
        """
        if self.pixel_mm is None:
            return columns, rows
        burner = shape[0] - 0.5 if self.burner_row is None else self.burner_row
        return (columns - (shape[1] - 1) / 2) * self.pixel_mm, (burner - rows) * self.pixel_mm

    def image(self, light_field: LightField) -> np.ndarray:
        """Image in which the flame is measured; grey, float64, shape (t, s)."""
        v, u = light_field.views.shape[:2]
        if self.slope is None:
            image = light_field.filled[(v - 1) // 2, (u - 1) // 2]
        else:
            # Filled, so that no warning is repeated with each frame.
            filled = LightField.trusted(light_field.filled, weights=light_field.weights)
            image = shift_and_sum(filled, [self.slope])[0]
        grey = np.asarray(image, np.float64)
        return grey.mean(axis=2) if grey.ndim == 3 else grey


@dataclass
class FlameSeries:
    """Measurements of all frames: some numbers for each, the sum image, and a few contours.

    Attributes
    ----------
    times_s, heights : list of float
        Times and heights of the frames; heights are NaN without a flame.
    names : list of str
        File names of the frames.
    total : ndarray of float64, shape (t, s), or float
        Sum of the images.
    contours : list of (float, ndarray)
        Times and contours of frames spread evenly over the sequence.
    doubts : dict of str to list of str
        Names of frames by warning.
    repeated : list of bool
        Whether a frame's picture repeats the one before.
    dark_shares : list of float
        Brightness of the dark around the flame, relative to the peak.
    """

    times_s: list[float] = field(default_factory=list)
    heights: list[float] = field(default_factory=list)
    names: list[str] = field(default_factory=list)
    total: np.ndarray | float = 0.0
    contours: list[tuple[float, np.ndarray]] = field(default_factory=list)
    doubts: dict[str, list[str]] = field(default_factory=dict)
    repeated: list[bool] = field(default_factory=list)
    dark_shares: list[float] = field(default_factory=list)

    def warnings(self) -> list[str]:
        """Sentences on what is doubtful, each with the number of frames."""
        return [
            f"{len(names)} of {len(self.times_s)} frames, first {names[0]}: {doubt}"
            + (f" {self._dark()}" if doubt == BRIGHT_DARK else "")
            for doubt, names in self.doubts.items()
        ]

    def _dark(self) -> str:
        """Say how bright the dark is."""
        return f"It is at up to {100 * np.nanmax(self.dark_shares):.2g} % of the flame's peak."


def measure_frames(
    paths: Sequence[Path],
    frames: Iterable[LightField],
    measures: Measures,
    times_s: Sequence[float],
    table: Path,
    progress: Callable = iter,
) -> FlameSeries:
    """Measure frame after frame, and write a row of ``flame.csv`` for each.

    Parameters
    ----------
    paths : sequence of Path
        Paths of the frames, in the same order.
    frames : iterable of LightField
        Frames of one shape; each is released before the next is requested.
    measures : Measures
        Options of the measurement.
    times_s : sequence of float
        Time of each frame in s.
    table : Path
        Table to write.
    progress : callable, optional
        Function that wraps the images, as ``tqdm`` does; wrapping the frames would keep one while
        the next is read.

    Returns
    -------
    FlameSeries
    """
    series, unit = FlameSeries(), measures.unit
    before: np.ndarray | None = None
    shown = set(np.linspace(0, len(paths) - 1, CONTOURS).round().astype(int).tolist())
    header = [
        "frame", "time_s", f"height_{unit}", "tip_row", f"width_{unit}", f"area_{unit}2",
        "brightness", "source", "warnings",
    ]  # fmt: skip
    with table.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(header)
        for number, image in enumerate(progress(map(measures.image, frames))):
            time_s, name = float(times_s[number]), paths[number].name
            shape = measure_flame(
                image,
                level=measures.level,
                pixel_mm=measures.pixel_mm or 1.0,
                burner_row=measures.burner_row,
            )
            # Dark frames may be alike, without a flame and clipped at 0.
            repeated = before is not None and shape.is_found and np.array_equal(image, before)
            doubts = (*shape.warnings, *([REPEATED] if repeated else []))
            numbers = (shape.height, shape.tip_row, shape.width, shape.area, shape.brightness)
            written = [f"{x:.7g}" for x in numbers]
            writer.writerow([number, f"{time_s:.15g}", *written, name, " ".join(doubts)])
            series.times_s.append(time_s)
            series.names.append(name)
            series.heights.append(shape.height)
            series.repeated.append(repeated)
            series.dark_shares.append(shape.dark_share)
            series.total = series.total + image
            if number in shown and shape.is_found:
                series.contours.append((time_s, shape.contour))
            for doubt in doubts:
                series.doubts.setdefault(doubt, []).append(name)
            before = image
    return series
