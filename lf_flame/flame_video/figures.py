"""Figure of a flame's flicker."""

from collections.abc import Sequence
from textwrap import fill
from typing import TYPE_CHECKING

import numpy as np

from lf_flame._common.figures import subplots

if TYPE_CHECKING:
    from lf_flame.flame_video.flame_series import FlameSeries, Measures
    from lf_flame.flame_video.flicker import Flicker

TITLE_WIDTH = 100
"""Number of letters in a line of a title."""


def flicker_figure(
    series: "FlameSeries", measures: "Measures", found: "Flicker | None", left_out: np.ndarray
):
    """Height against time, its spectrum, and contours over the mean image.

    Parameters
    ----------
    series : FlameSeries
    measures : Measures
        Options with which it was measured; they hold the scale of lengths.
    found : Flicker or None
        Flicker; None if too few heights or times are known.
    left_out : ndarray of bool, shape (frames,)
        Whether a height was left out of the spectrum.

    Returns
    -------
    matplotlib.figure.Figure
    """
    times_s, heights = np.array(series.times_s), np.array(series.heights)
    figure, axes = subplots(2, 2, figsize=(11, 6.5), layout="constrained", width_ratios=(3, 2))
    for axis in axes[:, 1]:
        axis.remove()
    picture = figure.add_subplot(axes[0, 1].get_gridspec()[:, 1])
    _draw_heights(axes[0, 0], times_s, heights, measures.unit, left_out)
    _draw_spectrum(axes[1, 0], found, measures.unit)
    _draw_contours(picture, np.asarray(series.total) / len(times_s), series.contours, measures)
    return figure


def _draw_heights(axis, times_s, heights, unit: str, left_out: np.ndarray) -> None:
    style = "." if len(times_s) < 300 else ""
    axis.plot(times_s, heights, f"{style}-", linewidth=0.8, markersize=4)
    if left_out.any():
        label = "left out of the spectrum"
        axis.plot(times_s[left_out], heights[left_out], "C3x", markersize=7, label=label)
        axis.legend(fontsize=8)
    axis.set_xlabel("time (s)")
    axis.set_ylabel(f"height ({unit})")
    axis.grid(alpha=0.3)


def _draw_spectrum(axis, found: "Flicker | None", unit: str) -> None:
    if found is None:
        axis.set_title("no spectrum: too few heights, or repeated frames", fontsize=9)
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
    axis.set_title(fill(found.describe(unit=unit), TITLE_WIDTH), fontsize=8)
    axis.set_xlabel("frequency (Hz)")
    axis.set_ylabel("share of the variance")
    axis.grid(alpha=0.3)


def _draw_contours(
    axis,
    mean_image: np.ndarray,
    contours: Sequence[tuple[float, np.ndarray]],
    measures: "Measures",
) -> None:
    rows, columns = mean_image.shape
    ends = np.array([-0.5, rows - 0.5]), np.array([-0.5, columns - 0.5])
    across, up = measures.place(*ends, mean_image.shape)
    axis.imshow(mean_image, cmap="gray", vmin=0, extent=(*across, up[1], up[0]))
    for number, (time_s, contour) in enumerate(contours):
        place = measures.place(contour[:, 0], contour[:, 1], mean_image.shape)
        axis.plot(*place, f"C{number}", linewidth=1, label=f"{time_s:.3g} s")
    axis.set_title("contours over the mean picture", fontsize=9)
    in_mm = measures.pixel_mm is not None
    axis.set_xlabel("across, from the picture's middle (mm)" if in_mm else "column (pixels)")
    axis.set_ylabel("height (mm)" if in_mm else "row (pixels)")
    if contours:
        axis.legend(fontsize=7)
