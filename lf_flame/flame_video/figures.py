"""Figure of a flame's flicker."""

from collections.abc import Sequence
from dataclasses import dataclass
from textwrap import fill
from typing import TYPE_CHECKING

import numpy as np

from lf_flame._common.figures import subplots

if TYPE_CHECKING:
    from lf_flame.flame_video.flicker import Flicker

TITLE_WIDTH = 100
"""Number of letters in a line of a title."""


@dataclass(frozen=True)
class PictureScale:
    """Scale of lengths in an image.

    Attributes
    ----------
    pixel_mm : float, optional
        Side of a pixel; None for lengths in pixels.
    burner_row : float, optional
        Row from which heights are measured; None for the lower edge.
    """

    pixel_mm: float | None = None
    burner_row: float | None = None

    @property
    def unit(self) -> str:
        """Name of the unit of lengths."""
        return "px" if self.pixel_mm is None else "mm"

    def place(self, rows, columns, shape: tuple[int, int]):
        """Positions of rows and columns: across from the centre and up from the burner, in mm.

        Without a scale they are columns and rows in pixels, unchanged.
        """
        if self.pixel_mm is None:
            return columns, rows
        burner = shape[0] - 0.5 if self.burner_row is None else self.burner_row
        return (columns - (shape[1] - 1) / 2) * self.pixel_mm, (burner - rows) * self.pixel_mm


def flicker_figure(
    times_s: np.ndarray,
    heights: np.ndarray,
    found: "Flicker | None",
    mean_image: np.ndarray,
    contours: Sequence[tuple[float, np.ndarray]],
    scale: PictureScale,
    outliers: np.ndarray,
):
    """Height against time, its spectrum, and contours over the mean image.

    Parameters
    ----------
    times_s, heights : ndarray, shape (frames,)
        Times, and heights in the unit of `scale`; NaN without a flame.
    found : Flicker or None
        Flicker; None if too few heights are known.
    mean_image : ndarray, shape (rows, columns)
        Mean over the frames.
    contours : sequence of (float, ndarray)
        Times, and contours as in `FlameShape`.
    scale : PictureScale
        Scale of lengths.
    outliers : ndarray of bool, shape (frames,)
        Whether a height was left out of the spectrum.

    Returns
    -------
    matplotlib.figure.Figure
    """
    figure, axes = subplots(2, 2, figsize=(11, 6.5), layout="constrained", width_ratios=(3, 2))
    for axis in axes[:, 1]:
        axis.remove()
    picture = figure.add_subplot(axes[0, 1].get_gridspec()[:, 1])
    _draw_heights(axes[0, 0], times_s, heights, scale.unit, outliers)
    _draw_spectrum(axes[1, 0], found)
    _draw_contours(picture, mean_image, contours, scale)
    return figure


def _draw_heights(axis, times_s, heights, unit: str, outliers: np.ndarray) -> None:
    style = "." if len(times_s) < 300 else ""
    axis.plot(times_s, heights, f"{style}-", linewidth=0.8, markersize=4)
    if outliers.any():
        label = "left out of the spectrum"
        axis.plot(times_s[outliers], heights[outliers], "C3x", markersize=7, label=label)
        axis.legend(fontsize=8)
    axis.set_xlabel("time (s)")
    axis.set_ylabel(f"height ({unit})")
    axis.grid(alpha=0.3)


def _draw_spectrum(axis, found: "Flicker | None") -> None:
    if found is None:
        axis.set_title("too few heights for a spectrum", fontsize=9)
        axis.axis("off")
        return
    axis.plot(found.frequencies_hz, found.power, linewidth=0.9)
    axis.set_ylim(0, 1.15 * max(float(found.power.max()), 1e-3))
    if np.isfinite(found.peak_hz):
        stands_out = np.isfinite(found.frequency_hz)
        colour = "C1" if stands_out else "C7"
        axis.axvline(found.peak_hz, color=colour, linestyle="--", linewidth=0.9)
        bar = axis.errorbar(
            found.peak_hz, 1.06 * found.power.max(), xerr=found.resolution_hz / 2,
            color=colour, capsize=3,
        )  # fmt: skip
        axis.legend([bar], [f"resolution {found.resolution_hz:.2g} Hz"], fontsize=8)
        for line in found.lines[1:]:
            axis.axvline(line.frequency_hz, color="C1", linestyle=":", linewidth=0.9)
    axis.set_title(fill(found.describe(), TITLE_WIDTH), fontsize=8)
    axis.set_xlabel("frequency (Hz)")
    axis.set_ylabel("share of the variance")
    axis.grid(alpha=0.3)


def _draw_contours(
    axis,
    mean_image: np.ndarray,
    contours: Sequence[tuple[float, np.ndarray]],
    scale: PictureScale,
) -> None:
    rows, columns = mean_image.shape
    ends = np.array([-0.5, rows - 0.5]), np.array([-0.5, columns - 0.5])
    across, up = scale.place(*ends, mean_image.shape)
    axis.imshow(mean_image, cmap="gray", vmin=0, extent=(*across, up[1], up[0]))
    for number, (time_s, contour) in enumerate(contours):
        place = scale.place(contour[:, 0], contour[:, 1], mean_image.shape)
        axis.plot(*place, f"C{number}", linewidth=1, label=f"{time_s:.3g} s")
    axis.set_title("contours over the mean picture", fontsize=9)
    in_mm = scale.pixel_mm is not None
    axis.set_xlabel("across, from the picture's middle (mm)" if in_mm else "column (pixels)")
    axis.set_ylabel("height (mm)" if in_mm else "row (pixels)")
    if contours:
        axis.legend(fontsize=7)
