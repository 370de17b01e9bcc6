"""Figure of an axisymmetric flame's section with its standard deviation."""

from typing import TYPE_CHECKING

import numpy as np

from lf_flame._common.figures import subplots
from lf_flame.tomography.figures import draw_chi_squared

if TYPE_CHECKING:
    from lf_flame.tomography.axisymmetric.reconstruction import AxisymmetricFlame

SHOWN_HEIGHTS = (0.25, 0.5, 0.75)
"""Heights of radial profiles, as fractions of the height of a flame's bright part."""


def bright_heights(found: "AxisymmetricFlame") -> list[int]:
    """Choose heights for profiles, as indices: at 1/4, 1/2 and 3/4 of the bright part."""
    light = found.emission @ found.grid.radii_mm
    bright = np.flatnonzero(light > 0.05 * light.max())
    if not bright.size:
        return []
    bottom, top = bright[-1], bright[0]
    return [int(round(bottom + share * (top - bottom))) for share in SHOWN_HEIGHTS]


def section_figure(found: "AxisymmetricFlame"):
    """Draw the section through the axis, its standard deviation, profiles and each view's misfit.

    Parameters
    ----------
    found : AxisymmetricFlame

    Returns
    -------
    matplotlib.figure.Figure
    """
    figure, axes = subplots(
        1, 4, figsize=(14, 4.6), layout="constrained", width_ratios=(1, 1, 1.3, 0.9)
    )
    _draw_section(figure, axes[0], found, found.emission, "emission")
    if found.sigma is None:
        axes[1].axis("off")
    else:
        _draw_section(figure, axes[1], found, found.sigma, "standard deviation")
    _draw_profiles(axes[2], found)
    draw_chi_squared(figure, axes[3], found.chi_squared, shrink=0.6)
    return figure


def _draw_section(figure, axis, found: "AxisymmetricFlame", half: np.ndarray, word: str) -> None:
    grid = found.grid
    whole = np.concatenate([half[:, :0:-1], half], axis=1)
    side, edge = grid.radii_mm[-1] + grid.step_mm / 2, grid.step_mm / 2
    extent = (-side, side, grid.heights_mm[-1] - edge, grid.heights_mm[0] + edge)
    white = max(float(half.max()), 1e-30)
    picture = axis.imshow(whole, cmap="inferno", vmin=0, vmax=white, extent=extent)
    axis.set_title(word, fontsize=9)
    axis.set_xlabel("from the axis (mm)")
    axis.set_ylabel("height (mm)")
    figure.colorbar(picture, ax=axis, shrink=0.8, label="radiance / mm")


def _draw_profiles(axis, found: "AxisymmetricFlame") -> None:
    grid = found.grid
    for number, row in enumerate(bright_heights(found)):
        values = found.emission[row]
        axis.plot(
            grid.radii_mm, values, color=f"C{number}", label=f"{grid.heights_mm[row]:+.1f} mm high"
        )
        if found.bar is not None:
            half = found.bar[row]
            low = np.clip(values - half, 0, None)
            axis.fill_between(
                grid.radii_mm, low, values + half, color=f"C{number}", alpha=0.3, linewidth=0
            )
    axis.set_xlabel("distance from the axis (mm)")
    axis.set_ylabel("radiance / mm")
    axis.set_title("radial profiles, bars of 95 %", fontsize=9)
    axis.set_ylim(bottom=0)
    axis.grid(alpha=0.3)
    if axis.lines:
        axis.legend(fontsize=8)
