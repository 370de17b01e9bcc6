"""Figures of emission on planes and in a half section, of profiles, and of resolution."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.ticker import MaxNLocator

from lf_flame._common import figures
from lf_flame._common.atomic_files import OutputFolder
from lf_flame._common.figures import subplots
from lf_flame.lightfield import LightField
from lf_flame.refocus import shift_and_sum
from lf_flame.tomography.axisymmetric_grid import AxisymmetricGrid
from lf_flame.tomography.emission import Emission, Place, bar_times
from lf_flame.tomography.frustum_grid import FEW_PLANES, FrustumGrid

MOST_SHOWN = 8
"""Largest number of depth planes that a figure shows side by side."""

WIDTH_IN, FONT = 3.5, 6.5
"""Width of a column of a paper in inches, and size of letters in points."""


def draw_emission(found: Emission, light_field: LightField, folder: OutputFolder) -> None:
    """Write the figures of an emission into its folder."""
    figures.save(trust_figure(found), folder.path("trust.png"))
    if isinstance(found.grid, FrustumGrid):
        figures.save(_depth_figure(found), folder.path("depth.png"))
        figures.save(_slices_figure(found, light_field), folder.path("slices.png"))
    else:
        figures.save(_section_figure(found), folder.path("section.png"))


def trust_figure(found: Emission):
    """Chi-squared by view, and the number of each check relative to its limit."""
    figure, (left, right) = subplots(1, 2, figsize=(10, 4), layout="constrained")
    shown = np.clip(found.chi_squared, 1e-3, 1e6)
    most = max(2.0, float(np.exp(np.nanmax(np.abs(np.log(shown))))))
    picture = left.imshow(shown, cmap="RdBu_r", norm=LogNorm(1 / most, most))
    left.set_title("chi-squared of each view\n(1: noise alone is left)", fontsize=9)
    left.set(xlabel="u", ylabel="v")
    bar = figure.colorbar(picture, ax=left)
    ticks = [1 / most, most**-0.5, 1.0, most**0.5, most]
    bar.set_ticks(ticks, labels=[f"{tick:.2g}" for tick in ticks], minor=False)
    bar.minorticks_off()
    names = [check.name for check in found.checks]
    numbers = [min(check.number / (check.limit or 1), 1e3) for check in found.checks]
    colours = ["C3" if check.failed else "C0" for check in found.checks]
    right.barh(range(len(names)), numbers, color=colours)
    right.set_yticks(range(len(names)), names, fontsize=8)
    right.set_xscale("symlog", linthresh=1)
    right.axvline(1, color="C7", linewidth=1)
    right.invert_yaxis()
    right.set_title("checks, relative to their limits", fontsize=9)
    return figure


def _depth_figure(found: Emission):
    """Light against depth with error bars of 95 %."""
    figure, axis = subplots(1, 1, figsize=(7, 3.6), layout="constrained")
    assert isinstance(found.grid, FrustumGrid)
    depths = np.array(found.grid.depths_mm)
    light, error = found.light
    bars = None if error is None else bar_times(len(found.draws)) * error
    line = "o-" if len(depths) > FEW_PLANES else "o"  # separate sheets form no curve
    axis.errorbar(depths, light, bars, fmt=line, capsize=3, markersize=4)
    axis.set(xlabel="depth (mm)", ylabel="light of the plane\n(radiance x mm$^2$)")
    axis.set_ylim(0, 1.05 * axis.get_ylim()[1])  # leaves room for a marker at the top
    axis.grid(alpha=0.3)
    return figure


def _slices_figure(found: Emission, light_field: LightField):
    """Depth planes of the emission above refocused images at the same depths, separate scales."""
    grid = found.grid
    assert isinstance(grid, FrustumGrid)
    (rows, columns), block = grid.pixels, grid.block
    stack = shift_and_sum(grid.camera.corrected(light_field), grid.slopes)
    stack = stack.reshape(len(stack), rows, block, columns, block).mean(axis=(2, 4))
    shown = shown_planes(len(found.emission))
    width = min(3.2, 14 / len(shown))
    size = (width * len(shown), 2 * width * rows / columns + 1.2)
    figure, axes = subplots(2, len(shown), figsize=size, layout="constrained", squeeze=False)
    for line, images, word in zip(
        axes, (found.emission, stack), ("emission", "refocused"), strict=True
    ):
        white = max(float(images[shown].max()), 1e-30)
        for axis, plane in zip(line, shown, strict=True):
            depth = grid.depths_mm[plane]
            half = grid.cell_mm(depth) / 2
            extent = (-columns * half, columns * half, -rows * half, rows * half)
            picture = axis.imshow(images[plane], "inferno", vmin=0, vmax=white, extent=extent)
            axis.set_title(f"{word}, {depth:+g} mm", fontsize=8)
            axis.tick_params(labelsize=7)
        line[0].set_ylabel("height (mm)", fontsize=8)
        figure.colorbar(picture, ax=list(line), shrink=0.8, label="radiance")
    for axis in axes[-1]:
        axis.set_xlabel("across (mm)", fontsize=8)
    return figure


def _section_figure(found: Emission):
    """Draw the section through the axis, its standard deviation, and radial profiles."""
    grid = found.grid
    assert isinstance(grid, AxisymmetricGrid)
    figure, axes = subplots(1, 3, figsize=(11, 4.6), layout="constrained", width_ratios=(1, 1, 1.3))
    side, edge = grid.radii_mm[-1] + grid.step_mm / 2, grid.step_mm / 2
    extent = (-side, side, grid.heights_mm[-1] - edge, grid.heights_mm[0] + edge)
    for axis, half, word in (
        (axes[0], found.emission, "emission"), (axes[1], found.sigma, "standard deviation"),
    ):  # fmt: skip
        if half is None:
            axis.axis("off")
            continue
        whole = np.concatenate([half[:, :0:-1], half], axis=1)
        white = max(float(half.max()), 1e-30)
        picture = axis.imshow(whole, cmap="inferno", vmin=0, vmax=white, extent=extent)
        axis.set_title(word, fontsize=9)
        axis.set(xlabel="from the axis (mm)", ylabel="height (mm)")
        figure.colorbar(picture, ax=axis, shrink=0.8, label="radiance / mm")
    # At 1/4, 1/2 and 3/4 of the height of the bright part.
    light = found.emission @ grid.radii_mm
    bright = np.flatnonzero(light > 0.05 * light.max())
    axis = axes[2]
    for number, share in enumerate((0.25, 0.5, 0.75) if bright.size else ()):
        row = int(round(bright[-1] + share * (bright[0] - bright[-1])))
        values, colour = found.emission[row], f"C{number}"
        axis.plot(grid.radii_mm, values, colour, label=f"{grid.heights_mm[row]:+.1f} mm high")
        if found.bar is not None:
            low, high = np.clip(values - found.bar[row], 0, None), values + found.bar[row]
            axis.fill_between(grid.radii_mm, low, high, color=colour, alpha=0.3, linewidth=0)
    axis.set(xlabel="distance from the axis (mm)", ylabel="radiance / mm")
    axis.set_title("radial profiles, bars of 95 %", fontsize=9)
    axis.set_ylim(bottom=0)
    axis.grid(alpha=0.3)
    if axis.lines:
        axis.legend(fontsize=8)
    return figure


def shown_planes(count: int) -> np.ndarray:
    """Choose at most `MOST_SHOWN` of so many planes, spread evenly."""
    return np.unique(np.linspace(0, count - 1, min(count, MOST_SHOWN)).round().astype(int))


def temperature_figure(
    kelvin: np.ndarray, sigma: np.ndarray, emission: np.ndarray, places: Sequence[Place]
):
    """Draw emission, temperature, and its standard deviation side by side.

    All maps are (planes, rows, columns), NaN where there is no temperature, and cut to what is
    known.
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
    for axis in axes[:, 0]:
        axis.set_ylabel("height (mm)", fontsize=FONT)
    return figure


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
    rows, columns = np.nonzero(np.isfinite(kelvin).any(axis=0))
    if not rows.size:
        return place.extent_mm
    side = (right - left) / kelvin.shape[2]
    margin = 0.1 * side * max(np.ptp(rows), np.ptp(columns), 1)
    return (
        max(left + side * columns.min() - margin, left),
        min(left + side * (columns.max() + 1) + margin, right),
        max(high - side * (rows.max() + 1) - margin, low),
        min(high - side * rows.min() + margin, high),
    )
