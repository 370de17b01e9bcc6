"""Figure of soot temperatures with their errors, for one column of a paper."""

from collections.abc import Sequence

import numpy as np
from matplotlib.ticker import MaxNLocator

from lf_flame._common.figures import subplots
from lf_flame.tomography.emission_folder import Place
from lf_flame.tomography.figures import shown_planes

WIDTH_IN, FONT = 3.5, 6.5
"""Width of a column of a paper in inches, and size of letters in points."""

MARGIN = 0.1
"""Margin around the cells with a temperature, relative to their extent."""

ISOTHERMS = 5
"""Largest number of isotherms."""


def temperature_figure(
    kelvin: np.ndarray, sigma: np.ndarray, emission: np.ndarray, places: Sequence[Place]
):
    """Draw emission, temperature with isotherms, and its standard deviation side by side.

    Isotherms are drawn where three standard deviations are less than their distance. The maps are
    cut to the cells that have a temperature.

    Parameters
    ----------
    kelvin, sigma : ndarray, shape (planes, rows, columns)
        Temperatures and their standard deviations in K, NaN where there is none.
    emission : ndarray, shape (planes, rows, columns)
        Emission in one colour.
    places : sequence of Place
        Place of each plane.

    Returns
    -------
    matplotlib.figure.Figure
    """
    shown = shown_planes(len(kelvin))
    columns = (
        ("emission", "relative to the peak", emission / max(float(np.max(emission)), 1e-30)),
        ("temperature", "K", kelvin),
        ("standard deviation", "K", sigma),
    )
    beyond = "neither", "both", "max"  # a rim's temperatures are nearly noise
    ranges = (0.0, 1.0), _range(kelvin, sigma), (0.0, _range(sigma, sigma)[1])
    left, right, low, high = _window(kelvin[shown], places[shown[0]])
    # A third of the width, less what ticks and labels take.
    height = 0.24 * WIDTH_IN * (high - low) / (right - left)
    size = (WIDTH_IN, len(shown) * (height + 0.3) + 1.0)
    figure, axes = subplots(len(shown), 3, figsize=size, layout="constrained", squeeze=False)
    for column, ((word, unit, maps), (least, most)) in enumerate(zip(columns, ranges, strict=True)):
        for axis, plane in zip(axes[:, column], shown, strict=True):
            place = places[plane]
            picture = axis.imshow(
                maps[plane], "inferno", vmin=least, vmax=most, extent=place.extent_mm
            )
            axis.set_facecolor("0.75")
            axis.set(xlim=(left, right), ylim=(low, high))
            axis.tick_params(labelsize=FONT, length=2, labelleft=column == 0)
            axis.set_title(place.title if column == 0 else "", fontsize=FONT)
        axes[-1, column].set_xlabel(place.across, fontsize=FONT)
        bar = figure.colorbar(
            picture, ax=list(axes[:, column]), location="top", aspect=12, extend=beyond[column]
        )
        bar.set_label(f"{word}\n({unit})", fontsize=FONT)
        bar.ax.xaxis.set_major_locator(MaxNLocator(3))
        bar.ax.tick_params(labelsize=FONT, length=2)
    for axis, plane in zip(axes[:, 1], shown, strict=True):
        _draw_isotherms(axis, kelvin[plane], sigma[plane], ranges[1], places[plane].extent_mm)
    for axis in axes[:, 0]:
        axis.set_ylabel("height (mm)", fontsize=FONT)
    return figure


def _draw_isotherms(axis, kelvin, sigma, limits: tuple[float, float], extent_mm) -> None:
    """Draw isotherms at round temperatures, with their numbers."""
    levels = [level for level in MaxNLocator(ISOTHERMS).tick_values(*limits)
              if limits[0] <= level <= limits[1]]  # fmt: skip
    step = levels[1] - levels[0] if len(levels) > 1 else np.inf
    well_known = np.where(3 * sigma < step, kelvin, np.nan)
    if not levels or min(kelvin.shape) < 2 or not np.isfinite(well_known).any():
        return
    lines = axis.contour(
        well_known, levels, colors="w", linewidths=0.5, extent=extent_mm, origin="upper"
    )
    axis.clabel(lines, fmt="%d", fontsize=0.7 * FONT)


def _range(values: np.ndarray, sigma: np.ndarray) -> tuple[float, float]:
    """Range of the better-known half of values: at a flame's rim temperatures are nearly noise."""
    known = np.isfinite(values) & np.isfinite(sigma)
    if not known.any():
        return 0.0, 1.0
    low, high = np.percentile(values[known & (sigma <= np.median(sigma[known]))], (1, 99))
    return float(low), float(max(high, low + 1.0))


def _window(kelvin: np.ndarray, place: Place) -> tuple[float, float, float, float]:
    """Edges in mm around all cells with a temperature, with a margin; all of the map without."""
    left, right, low, high = place.extent_mm
    known = np.isfinite(kelvin).any(axis=0)
    if not known.any():
        return place.extent_mm
    found = []
    for axis, (begin, end) in ((0, (left, right)), (1, (high, low))):
        lit = np.flatnonzero(known.any(axis=axis))
        edges = np.linspace(begin, end, known.shape[1 - axis] + 1)
        first, last = sorted((edges[lit[0]], edges[lit[-1] + 1]))
        margin = MARGIN * (last - first)
        found += [max(first - margin, min(begin, end)), min(last + margin, max(begin, end))]
    return found[0], found[1], found[2], found[3]
