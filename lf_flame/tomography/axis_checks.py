"""Checks whether a flame is axisymmetric about the axis that was stated."""

from dataclasses import replace

import numpy as np

from lf_flame._common.arrays import centred
from lf_flame.lightfield import LightField
from lf_flame.tomography.axis import MARGIN, find_axis
from lf_flame.tomography.axisymmetric_grid import AxisymmetricGrid
from lf_flame.tomography.data_checks import Check
from lf_flame.tomography.fit import Explanation
from lf_flame.tomography.geometries import SectionGeometry, backproject, project
from lf_flame.tomography.projection_operator import AxisymmetricOperator

MOST_SIGMAS = 4.0
"""Number of standard errors that a departure must exceed to be more than noise."""

DEPTH_RATIO, DEEPEST = 1.5, 10.0
"""Extent in depth, relative to that across, of the flame that serves as comparison, and largest
one that is considered; its inverse is the smallest."""

GRID_ERROR = 5e-5
"""Residual in the component of a flame stretched in depth that the grid itself causes."""


def axis_checks(
    light_field: LightField, geometry: SectionGeometry, found: Explanation, views: np.ndarray
) -> list[Check]:
    """Check whether a flame is upright, where it is stated, and axisymmetric.

    `views` are those of the light field that are fitted. A number is in units of its limit: the
    larger of a tenth of a pixel, or of what hardly matters, and four standard errors.
    """
    grid = geometry.grid
    depth = grid.depth_mm if light_field.views.shape[1] < 3 else None
    axis = find_axis(light_field, grid.camera, depth)
    least = 0.1 * grid.pixel_mm
    pupil = grid.camera.views * grid.camera.view_step_mm
    half_angle = pupil / 2 / grid.camera.distance_mm(grid.depth_mm)
    edge = axis.radius_mm / MARGIN
    lit = project(geometry.operator, np.ones(grid.shape))
    outside = max(0.9 * edge / grid.radius_mm, _light_outside(grid, views, lit))
    shown = "the light field shows it at"
    places = [
        (axis.lean_deg, 1.0, 0.0, f"leans by {axis.lean_deg:.1f} degrees"),
        (axis.depth_lean_deg, 5.0, axis.depth_lean_error_deg,
         f"leans by {axis.depth_lean_deg:.0f} degrees in depth"),
        (axis.wander_mm, least, axis.wander_error_mm,
         f"is not straight: it moves by up to {axis.wander_mm:.2g} mm across with height"),
        (grid.axis_mm - axis.across_mm, least, axis.across_error_mm,
         f"was stated {grid.axis_mm:.3f} mm across, {shown} {axis.across_mm:.3f} mm"),
        # A wrong depth displaces the axis in the outermost views by the parallax.
        (grid.depth_mm - axis.depth_mm, least / half_angle, axis.depth_error_mm,
         f"was stated at a depth of {grid.depth_mm:.2f} mm, {shown} {axis.depth_mm:.2f} mm"),
        (outside, 1.0, 0.0,
         f"is that of a flame of {grid.radius_mm:.3g} mm radius as stated, but there is light out "
         f"to {edge:.3g} mm"),
    ]  # fmt: skip
    checks = [
        Check("axis", abs(number) / max(limit, MOST_SIGMAS * error), 1.0,
              f"The axis {words}: emission is wrong there by more than its error bars.")
        for number, limit, error, words in places
    ]  # fmt: skip
    sentence = (
        f"The flame is not axisymmetric: its halves differ by {axis.lopsided:.1%} of its light, "
        f"and the result is the axisymmetric flame most like it."
    )
    checks.append(Check("roundness", axis.lopsided, 0.03, sentence))
    # A wrong axis or radius would look like another depth ratio.
    if not any(check.failed for check in checks):
        ratio, error, departure = measure_depth_ratio(
            geometry, found.cells, views, found.pixel_noise
        )
        sentence = (
            f"The flame is {'deeper' if ratio > 1 else 'flatter'} than wide: its extent in depth "
            f"is about {ratio:.2f} times that across (standard error {error:.1g}); emission is "
            f"wrong by that factor."
        )
        checks.append(Check("roundness", departure, 1.0, sentence))
    return checks


def _light_outside(grid: AxisymmetricGrid, views: np.ndarray, lit: np.ndarray) -> float:
    """Light where no flame within a grid's radius can be, over 0.2 % of all, or 0 if noise."""
    dark = grid.place(lit).max(axis=(0, 2)) <= 0  # view column, column
    views = grid.place(views)
    rows = views.sum(axis=0, dtype=np.float64).transpose(1, 0, 2)[:, dark].sum(axis=1)
    # Noise differs between neighbouring rows, the flame hardly does.
    error = np.sqrt(np.sum(np.square(np.diff(rows))) / 2)
    light, total = float(rows.sum()), float(views.sum(dtype=np.float64))
    return light / (2e-3 * total) if light > MOST_SIGMAS * error and total > 0 else 0.0


def measure_depth_ratio(
    geometry: SectionGeometry, emission: np.ndarray, views: np.ndarray, sd: np.ndarray
) -> tuple[float, float, float]:
    """Extent of a flame in depth relative to that across, as its light field shows it.

    The reconstructed emission is stretched in depth, with the same light along the line of sight.
    The resulting change of the views, without the parts that an axisymmetric flame or the longer
    path of oblique rays could imitate, is correlated with the residual (a matched filter). Gives
    the ratio, 1 for an axisymmetric flame, its standard error, and the departure from 1, in units
    of the larger of 0.05 and `MOST_SIGMAS` errors.
    """
    operator = geometry.operator
    wide = AxisymmetricOperator(replace(geometry.grid, depth_ratio=DEPTH_RATIO))
    round_one = project(operator, emission)
    seen = project(wide, emission / DEPTH_RATIO)

    def unlike_round(views: np.ndarray) -> np.ndarray:
        explained = geometry.problem(backproject(operator, views)).unpenalised()
        return views - project(operator, explained)

    residual, change = unlike_round(views), unlike_round(seen - round_one)
    # The operator gives all rays the path of one along the optical axis. Oblique rays have longer
    # ones, which looks like a flatter flame.
    longer = unlike_round(round_one * _longer_path(geometry.grid))
    least = float(np.finfo(np.float32).tiny)
    power = max(float(np.sum(np.square(longer))), least)
    change -= longer * float(np.sum(change * longer)) / power
    power = max(float(np.sum(np.square(change))), least)
    noise = float(np.sum(np.square(change * sd)))
    # The change follows the flame's second moment along depth.
    step = DEPTH_RATIO**2 - 1
    squared = 1 + step * float(np.sum(change * residual)) / power
    grid_error = GRID_ERROR * float(seen.max()) / float(np.sqrt(power / change.size))
    error = step * float(np.hypot(np.sqrt(noise) / power, grid_error))  # of the square
    ratio = float(np.sqrt(max(squared, DEEPEST**-2)))
    departure = min(abs(squared - 1) / (MOST_SIGMAS * error), abs(ratio - 1) / 0.05)
    return ratio, error / 2 / ratio, departure


def _longer_path(grid: AxisymmetricGrid) -> np.ndarray:
    """Excess of a ray's path through a slab, 1 / cos - 1, to second order, shape (v, u, t, s)."""
    camera, pixels = grid.camera, grid.data_shape[2:]
    distance, slope = camera.distance_mm(grid.depth_mm), camera.depth_to_slope(grid.depth_mm)
    views = centred(camera.views)[:, None]
    squared = []
    for count in pixels:
        place = grid.pixel_mm * (centred(count) - slope / grid.block * views)
        squared.append(np.square((place - camera.view_step_mm * views) / distance))
    down, across = squared
    return grid.pick((down[:, None, :, None] + across[None, :, None, :]) / 2)
