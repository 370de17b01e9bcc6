"""Profiles of emission, up a flame and across it, with 95 % confidence bands.

A band is the scatter of a profile over bootstrap draws of the noise and of the penalty's prior. It
does not include all of the uncertainty in depth: for a flame that is thick in depth, bands are too
narrow.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from lf_flame._common import figures
from lf_flame._common.arrays import centred
from lf_flame._common.atomic_files import OutputFolder
from lf_flame.errors import InputError
from lf_flame.tomography.emission import bar_times, scatter
from lf_flame.tomography.emission_folder import EmissionFolder, write_table

RECORD = "profiles.json"


@dataclass(frozen=True, eq=False)
class Profile:
    """Emission along a line, averaged across a strip; all arrays are float64, shape (n,).

    `places_mm` are heights upwards, or positions across, from the optical axis; `sigma` is the
    standard error and `band` the half-width of the 95 % confidence band, None without draws. The
    strip's middle is `at_mm` from the optical axis.
    """

    places_mm: np.ndarray
    values: np.ndarray
    sigma: np.ndarray | None
    band: np.ndarray | None = None
    at_mm: float = 0.0


def axial(
    plane: ArrayLike,
    draws: ArrayLike,
    cell_mm: float,
    across_mm: float | None = None,
    width_mm: float = 0.0,
) -> Profile:
    """Take a profile up a depth plane, (rows, columns) with row 0 at the top, lowest height first.

    The strip is at the centre of the light by default, and one cell wide or wider; columns at its
    borders are weighted by the part inside. `draws` has the shape (n, rows, columns).
    """
    image, again = np.asarray(plane, np.float64), np.asarray(draws, np.float64)
    heights, places = (cell_mm * centred(count) for count in image.shape)
    if across_mm is None:
        light = image.sum(axis=0)
        across_mm = float(light @ places) / max(float(light.sum()), 1e-300)
    parts = _strip(places, across_mm, width_mm, cell_mm)
    values, drawn = image[::-1] @ parts, again[:, ::-1] @ parts
    if len(drawn) < 2:
        return Profile(heights, values, None, at_mm=across_mm)
    sigma = scatter(drawn, values)
    return Profile(heights, values, sigma, bar_times(len(drawn)) * sigma)


def radial(
    plane: ArrayLike,
    draws: ArrayLike,
    cell_mm: float,
    height_mm: float | None = None,
    thickness_mm: float = 0.0,
) -> Profile:
    """Take a profile across a depth plane, as `axial` does up it, from a strip at a height."""
    image, again = (np.asarray(one)[..., ::-1, ::-1].swapaxes(-1, -2) for one in (plane, draws))
    return axial(image, again, cell_mm, height_mm, thickness_mm)


def _strip(places: np.ndarray, middle: float, width: float, cell: float) -> np.ndarray:
    """Weights of the cells by their part of a strip, one cell wide or wider; their sum is 1."""
    if not 0 <= width < np.inf:
        raise InputError(f"A strip's width must be a finite number, 0 or above, got {width} mm.")
    end = places[-1] + cell / 2
    if not abs(middle) <= end:
        raise InputError(
            f"A strip must lie within the plane, {-end:.3g} to {end:.3g} mm, got {middle}."
        )
    half = max(width, cell) / 2
    high = np.minimum(places + cell / 2, middle + half)
    parts = np.clip(high - np.maximum(places - cell / 2, middle - half), 0, None)
    return parts / parts.sum()


def take_profiles(
    folder: EmissionFolder,
    *,
    across: float | None = None,
    width: float = 0.0,
    height: float | None = None,
    thickness: float = 0.0,
) -> dict[str, list[Profile]]:
    """Take profiles up and across every depth plane, lists "axial" and "radial"; all in mm."""
    found: dict[str, list[Profile]] = {"axial": [], "radial": []}
    for k, plane in enumerate(folder.emission):
        one = plane, folder.draws[:, k], folder.cell_mm[k]
        found["axial"].append(axial(*one, across, width))
        found["radial"].append(radial(*one, height, thickness))
    return found


def write_profiles(
    found: dict[str, list[Profile]], depths_mm: list[float], folder: OutputFolder
) -> None:
    """Write ``axial.csv``, ``radial.csv`` and ``profiles.png``."""
    for name, place in (("axial", "height_mm"), ("radial", "across_mm")):
        columns = ["depth_mm", place, "emission", "standard_deviation", "low_95", "high_95"]
        both = zip(depths_mm, found[name], strict=True)
        rows = ([depth, *row] for depth, profile in both for row in _rows(profile))
        write_table(folder.path(f"{name}.csv"), columns, rows)
    figures.save(_profiles_figure(found, depths_mm), folder.path("profiles.png"))
    folder.facts |= {"depths_mm": depths_mm, "across_mm": [one.at_mm for one in found["axial"]]}
    folder.facts["height_mm"] = [one.at_mm for one in found["radial"]]


def _rows(profile: Profile):
    missing = np.full(len(profile.values), "")
    sigma = missing if profile.sigma is None else profile.sigma
    low, high = (
        missing if profile.band is None else profile.values + sign * profile.band
        for sign in (-1, 1)
    )
    return zip(profile.places_mm, profile.values, sigma, low, high, strict=True)


def _profiles_figure(found: dict[str, list[Profile]], depths_mm: list[float]):
    """Draw profiles up and across each depth plane, with their confidence bands."""
    from lf_flame.tomography.figures import shown_planes

    shown = shown_planes(len(depths_mm))
    figure, axes = figures.subplots(1, 2, figsize=(11, 4.2), layout="constrained")
    places = (("axial", "height (mm)"), ("radial", "across (mm)"))
    for axis, (name, label) in zip(axes, places, strict=True):
        for colour, plane in enumerate(shown):
            profile = found[name][plane]
            style = {"color": f"C{colour}"}
            depth = f"{depths_mm[plane]:+g} mm"
            axis.plot(profile.places_mm, profile.values, linewidth=1.2, label=depth, **style)
            if profile.band is not None:
                low, high = profile.values - profile.band, profile.values + profile.band
                axis.fill_between(profile.places_mm, low, high, alpha=0.3, linewidth=0, **style)
        axis.set(xlabel=label, ylabel="emission")
        axis.set_title(f"{name} profiles, band of 95 %", fontsize=10)
        axis.set_ylim(bottom=0)
        axis.grid(alpha=0.3)
    axes[1].legend(fontsize=8, title="depth", title_fontsize=8)
    return figure
