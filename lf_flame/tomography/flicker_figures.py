"""A picture of how a flame flickers."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from lf_flame._common.figures import subplots

if TYPE_CHECKING:
    from lf_flame.tomography.flicker import Flicker


def flicker_figure(
    times_s: np.ndarray,
    heights: np.ndarray,
    unit: str,
    found: "Flicker | None",
    mean_image: np.ndarray,
    contours: Sequence[tuple[float, np.ndarray]],
):
    """Height against time, its spectrum, and contours over the mean picture.

    Parameters
    ----------
    times_s, heights : ndarray, shape (frames,)
        NaN where there is no flame.
    unit : str
        Of the heights.
    found : Flicker or None
        None where too few heights are known.
    mean_image : ndarray, shape (rows, columns)
    contours : sequence of (float, ndarray)
        Time, and contour as of `FlameShape`.

    Returns
    -------
    matplotlib.figure.Figure
    """
    figure, axes = subplots(2, 2, figsize=(11, 6.5), layout="constrained", width_ratios=(3, 2))
    for axis in axes[:, 1]:
        axis.remove()
    picture = figure.add_subplot(axes[0, 1].get_gridspec()[:, 1])
    _draw_heights(axes[0, 0], times_s, heights, unit)
    _draw_spectrum(axes[1, 0], found)
    _draw_contours(picture, mean_image, contours)
    return figure


def _draw_heights(axis, times_s: np.ndarray, heights: np.ndarray, unit: str) -> None:
    style = "." if len(times_s) < 300 else ""
    axis.plot(times_s, heights, f"{style}-", linewidth=0.8, markersize=4)
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
    axis.set_title(found.describe(), fontsize=8)
    axis.set_xlabel("frequency (Hz)")
    axis.set_ylabel("share of the variance")
    axis.grid(alpha=0.3)


def _draw_contours(
    axis, mean_image: np.ndarray, contours: Sequence[tuple[float, np.ndarray]]
) -> None:
    axis.imshow(mean_image, cmap="gray", vmin=0)
    for number, (time_s, contour) in enumerate(contours):
        axis.plot(contour[:, 1], contour[:, 0], f"C{number}", linewidth=1, label=f"{time_s:.3g} s")
    axis.set_title("contours over the mean picture", fontsize=9)
    axis.set_xlabel("column (pixels)")
    axis.set_ylabel("row (pixels)")
    if contours:
        axis.legend(fontsize=7)
