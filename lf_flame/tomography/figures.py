"""Figures of emission by depth, and of its errors."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.ticker import LogFormatter

from lf_flame._common.figures import subplots
from lf_flame.optics.lens import Lens
from lf_flame.tomography.frustum_grid import FEW_PLANES
from lf_flame.tomography.resolution import (
    angular_width,
    depth_blur,
    depth_modes,
    depth_singular_values,
    finest_period,
)

if TYPE_CHECKING:
    from lf_flame.tomography.profiles import Profile
    from lf_flame.tomography.reconstruction_result import Reconstruction

MOST_SHOWN = 8
"""Largest number of depth planes that a figure shows side by side."""

MOST_NUMBERED = 9
"""Largest number of views along an axis with which each view's chi-squared is printed."""


def resolution_figure(camera: Lens, thickness_mm: float, periods_mm: Sequence[float]):
    """Depth blur against lateral period, and the decay of singular values.

    Parameters
    ----------
    camera : Lens
    thickness_mm : float
        Extent in depth of the emission, centred on the focal plane.
    periods_mm : sequence of float
        Lateral periods for which singular values are drawn.

    Returns
    -------
    matplotlib.figure.Figure
    """
    figure, (left, right) = subplots(1, 2, figsize=(10.5, 4.2), layout="constrained")
    finest = finest_period(camera)
    lengths = np.geomspace(finest, max(100 * finest, *periods_mm), 100)
    left.loglog(lengths, depth_blur(camera, lengths), color="C0")
    left.axhline(thickness_mm, color="C7", linestyle="--", linewidth=1)
    left.annotate(
        f"{thickness_mm:g} mm: beyond, one number for all depths",
        (lengths[0], thickness_mm), textcoords="offset points", xytext=(2, 4), fontsize=8,
    )  # fmt: skip
    left.set_xlabel("lateral period in the focal plane (mm)")
    left.set_ylabel("blur in depth (mm)")
    left.set_title(f"period / {angular_width(camera):.3f} rad", fontsize=10)
    left.grid(alpha=0.3, which="both")
    depths = camera.focal_plane_mm + thickness_mm * np.linspace(-0.5, 0.5, 64)
    for number, period in enumerate(periods_mm):
        values = depth_singular_values(camera, period, depths)[:12]
        modes = depth_modes(camera, period, thickness_mm)
        label = f"{period:g} mm: {modes:.1f} modes"
        right.semilogy(1 + np.arange(len(values)), values, "o-", color=f"C{number}", label=label)
    right.axhline(0.01, color="C7", linestyle="--", linewidth=1)
    right.set_ylim(1e-4, 1.5)
    right.set_xlabel("number of the singular value")
    right.set_ylabel("relative to the largest")
    right.set_title(f"light within {thickness_mm:g} mm of depth", fontsize=10)
    right.legend(fontsize=8, title="lateral period", title_fontsize=8)
    right.grid(alpha=0.3)
    return figure


def shown_planes(count: int) -> np.ndarray:
    """Choose at most `MOST_SHOWN` of so many planes, spread evenly."""
    return np.unique(np.linspace(0, count - 1, min(count, MOST_SHOWN)).round().astype(int))


def slices_figure(found: "Reconstruction", focal_stack: np.ndarray):
    """Depth planes of the emission above refocused images at the same depths, on separate scales.

    Parameters
    ----------
    found : Reconstruction
    focal_stack : ndarray, shape (planes, rows, columns)
        Refocused images at the depths of the planes.

    Returns
    -------
    matplotlib.figure.Figure
    """
    shown = shown_planes(len(found.emission))
    rows, columns = found.grid.pixels
    width = min(3.2, 14 / len(shown))
    size = (width * len(shown), 2 * width * rows / columns + 1.2)
    figure, axes = subplots(2, len(shown), figsize=size, layout="constrained", squeeze=False)
    for line, (images, word) in enumerate(
        ((found.emission, "emission"), (focal_stack, "refocused"))
    ):
        white = max(float(images[shown].max()), 1e-30)
        for axis, plane in zip(axes[line], shown, strict=True):
            depth = found.grid.depths_mm[plane]
            half = found.grid.cell_mm(depth) / 2
            extent = (-columns * half, columns * half, -rows * half, rows * half)
            picture = axis.imshow(images[plane], "inferno", vmin=0, vmax=white, extent=extent)
            axis.set_title(f"{word}, {depth:+g} mm", fontsize=8)
            axis.tick_params(labelsize=7)
        axes[line][0].set_ylabel("height (mm)", fontsize=8)
        figure.colorbar(picture, ax=list(axes[line]), shrink=0.8, label="radiance")
    for axis in axes[-1]:
        axis.set_xlabel("across (mm)", fontsize=8)
    return figure


def depth_figure(found: "Reconstruction", light: np.ndarray, error: np.ndarray | None):
    """Light against depth with error bars, and the depth blur of detail of three sizes.

    Parameters
    ----------
    found : Reconstruction
    light, error : ndarray, shape (planes,)
        Light of each depth plane and its standard error; `error` may be None.

    Returns
    -------
    matplotlib.figure.Figure
    """
    figure, (top, bottom) = subplots(
        2, 1, figsize=(7, 4.4), layout="constrained", sharex=True, height_ratios=(4, 1)
    )
    depths = np.array(found.grid.depths_mm)
    bars = None if error is None else 1.96 * error
    line = "o-" if len(depths) > FEW_PLANES else "o"  # separate sheets form no curve
    top.errorbar(depths, light, bars, fmt=line, capsize=3, markersize=4)
    top.set_ylabel("light of the plane\n(radiance x mm$^2$)")
    top.set_ylim(0, 1.05 * top.get_ylim()[1])  # leaves room for a marker at the top
    top.grid(alpha=0.3)
    middle = (depths.min() + depths.max()) / 2
    periods = (10.0, 3.0, 1.0)
    blurs = [depth_blur(found.grid.camera, period) for period in periods]
    bottom.barh(range(len(blurs)), blurs, left=middle - np.divide(blurs, 2), color="C7", height=0.5)
    # As ticks, for which the layout makes room: a bar may end anywhere.
    words = [f"{period:g} mm: {blur:.1f} mm" for period, blur in zip(periods, blurs, strict=True)]
    bottom.set_yticks(range(len(words)), words, fontsize=8)
    bottom.set_title("detail of a size, and its blur in depth", fontsize=8)
    bottom.set_xlabel("depth (mm)")
    top.use_sticky_edges = bottom.use_sticky_edges = False  # else bars begin at the frame
    bottom.margins(x=0.05)
    return figure


def trust_figure(found: "Reconstruction"):
    """Residual of each view beside the misfit by strength, with the chosen strength marked.

    Parameters
    ----------
    found : Reconstruction

    Returns
    -------
    matplotlib.figure.Figure
    """
    figure, (left, right) = subplots(1, 2, figsize=(10, 4), layout="constrained")
    draw_chi_squared(figure, left, found.chi_squared)
    if found.tried:
        strengths = [tried.strength for tried in found.tried]
        misfits = [max(tried.misfit, 1e-3) for tried in found.tried]
        expected = [max(tried.expected, 1e-3) for tried in found.tried]
        right.loglog(strengths, misfits, "o-", label="residual")
        right.loglog(strengths, expected, "--", color="C7", label="what noise leaves")
        right.axvline(found.strength, color="C1", linewidth=1, label="taken")
        right.legend(fontsize=8)
    right.set_xlabel("strength of the penalty")
    right.set_ylabel("squared residual, relative to noise")
    for axis in (right.xaxis, right.yaxis):  # 0.01 and 6, for 10 to a power
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter(LogFormatter(minor_thresholds=(2, 0.4)))
    # Few strengths span less than a decade, where minor ticks have labels that would collide.
    right.tick_params(axis="x", which="minor", labelsize=6, labelrotation=60)
    right.grid(alpha=0.3)
    return figure


def draw_chi_squared(figure, axis, chi_squared: np.ndarray, shrink: float = 1.0) -> None:
    """Draw chi-squared by view on a logarithmic scale about 1; white if only noise remains."""
    shown = np.clip(chi_squared, 1e-3, 1e6)
    most = max(2.0, float(np.exp(np.nanmax(np.abs(np.log(shown))))))
    picture = axis.imshow(shown, cmap="RdBu_r", norm=LogNorm(1 / most, most))
    if max(shown.shape) <= MOST_NUMBERED:
        axis.set_xticks(range(shown.shape[1]))
        axis.set_yticks(range(shown.shape[0]))
        for (v, u), value in np.ndenumerate(chi_squared):
            if np.isnan(value):  # not fitted
                continue
            ink = "w" if abs(np.log(shown[v, u])) > 0.6 * np.log(most) else "k"
            axis.text(u, v, f"{value:.2g}", ha="center", va="center", fontsize=6, color=ink)
    axis.set_title("chi-squared of each view\n(1: noise alone is left)", fontsize=9)
    axis.set_xlabel("u")
    axis.set_ylabel("v")
    bar = figure.colorbar(picture, ax=axis, shrink=shrink)
    ticks = [1 / most, most**-0.5, 1.0, most**0.5, most]
    bar.set_ticks(ticks, labels=[f"{tick:.2g}" for tick in ticks], minor=False)
    bar.minorticks_off()


def profiles_figure(found: dict[str, list["Profile"]], depths_mm: Sequence[float]):
    """Draw profiles up and across each depth plane with their bands, or one standard deviation.

    Parameters
    ----------
    found : dict
        Lists "axial" and "radial", with a profile for each depth plane.
    depths_mm : sequence of float

    Returns
    -------
    matplotlib.figure.Figure
    """
    shown = shown_planes(len(depths_mm))
    figure, axes = subplots(1, 2, figsize=(11, 4.2), layout="constrained")
    places = (("axial", "height (mm)"), ("radial", "across (mm)"))
    for axis, (name, label) in zip(axes, places, strict=True):
        for colour, plane in enumerate(shown):
            profile = found[name][plane]
            style = {"color": f"C{colour}"}
            depth = f"{depths_mm[plane]:+g} mm"
            axis.plot(profile.places_mm, profile.values, linewidth=1.2, label=depth, **style)
            half = profile.band if profile.band is not None else profile.sigma
            if half is not None:
                low, high = profile.values - half, profile.values + half
                axis.fill_between(profile.places_mm, low, high, alpha=0.3, linewidth=0, **style)
        axis.set_xlabel(label)
        axis.set_ylabel("emission")
        words = "band of 95 %" if found[name][0].band is not None else "one standard deviation"
        axis.set_title(f"{name} profiles, {words}", fontsize=10)
        axis.set_ylim(bottom=0)
        axis.grid(alpha=0.3)
    axes[1].legend(fontsize=8, title="depth", title_fontsize=8)
    return figure
