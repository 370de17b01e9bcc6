"""Whether a flame is axisymmetric about the stated axis, as far as its light field shows."""

from dataclasses import replace

import numpy as np
from scipy import ndimage

from lf_flame._common.arrays import centred
from lf_flame.tomography.axisymmetric.axis import MARGIN, FlameAxis
from lf_flame.tomography.axisymmetric.fit import AxisymmetricFit
from lf_flame.tomography.axisymmetric.grid import AxisymmetricGrid
from lf_flame.tomography.axisymmetric.operator import AxisymmetricOperator

MOST_LEAN_DEG = 1.0
"""Largest lean of the axis without a warning, in degrees: 0.5 mm over 25 mm of height."""

MOST_DEPTH_LEAN_DEG = 5.0
"""Largest lean in depth without a warning, in degrees."""

SEEN_LEAN_DEG = 15.0
"""Lean in depth, in degrees, that a light field should show; if it does not, a note says so."""

MOST_LOPSIDED = 0.03
"""Largest relative difference of the halves of an axisymmetric flame."""

MOST_SHIFT = 0.1
"""Largest displacement of the axis without a warning, in pixels."""

MOST_OUTSIDE = 2e-3
"""Largest fraction of the light beyond the stated radius without a warning."""

ERRORS = 4.0
"""Number of standard errors that a departure must exceed to be more than noise."""

DEPTH_RATIO = 1.5
"""Extent in depth, relative to that across, of the flame that serves as comparison."""

DEEPEST = 10.0
"""Extent in depth, relative to that across, beyond which a flame is not thought of."""

FLATTEST = 1 / DEEPEST
"""Extent in depth, relative to that across, below which a flame is not thought of."""

MOST_DEPTH_RATIO = 0.05
"""Largest departure of the depth ratio from 1 without a warning."""

MODEL_ERROR = 1e-3
"""Residual that the grid itself causes, relative to the brightest pixel."""

GRID_ERROR = 5e-5
"""The same in the component of a flame stretched in depth, if the model is right."""

LEAST_RADIUS = 0.9
"""Smallest stated radius without a warning, relative to the radius of the visible light."""

SMOOTHED = 5
"""Number of pixels along each axis over which residuals are averaged: departures are larger than
pixels, noise is not."""


def check_roundness(axis: FlameAxis) -> tuple[str, ...]:
    """Sentences on why a flame is not axisymmetric and upright, as far as its axis shows."""
    found = []
    if abs(axis.lean_deg) > MOST_LEAN_DEG:
        found.append(
            f"The axis leans by {axis.lean_deg:.1f} degrees: the inversion takes it for upright, "
            f"so rotate the picture, or look at fewer heights."
        )
    limit = max(MOST_DEPTH_LEAN_DEG, ERRORS * axis.depth_lean_error_deg)
    if abs(axis.depth_lean_deg) > limit:
        found.append(
            f"The axis leans by {axis.depth_lean_deg:.0f} degrees in depth (standard error "
            f"{axis.depth_lean_error_deg:.1g}): the inversion takes it for upright, and emission "
            f"is wrong where the axis is far from its mean depth."
        )
    if axis.lopsided > MOST_LOPSIDED:
        found.append(
            f"The flame's halves differ by {axis.lopsided:.1%} of its light: it is not "
            f"axisymmetric, and the result is the axisymmetric flame most like it."
        )
    return tuple(found)


def check_stated(axis: FlameAxis, grid: AxisymmetricGrid, views: np.ndarray) -> tuple[str, ...]:
    """Compare the axis and the radius of a grid with what the light field shows.

    Parameters
    ----------
    axis : FlameAxis
        Axis as found.
    grid : AxisymmetricGrid
        Grid with the stated axis.
    views : ndarray, shape (v, u, t, s)
        Views that are used, in the grid's pixels.
    """
    found = []
    least = MOST_SHIFT * grid.step_mm
    if axis.wander_mm > max(least, ERRORS * axis.wander_error_mm):
        found.append(
            f"The axis is not straight: it moves by up to {axis.wander_mm:.2g} mm across with "
            f"height, and near it emission is wrong there."
        )
    off = grid.axis_mm - axis.across_mm
    if abs(off) > max(least, ERRORS * axis.across_error_mm):
        found.append(
            f"The axis was stated {grid.axis_mm:.3f} mm across, the light field shows it at "
            f"{axis.across_mm:.3f} mm (standard error {axis.across_error_mm:.1g}): near the axis "
            f"emission is wrong; leave it out to have it found."
        )
    pupil = grid.camera.views * grid.camera.view_step_mm
    half_angle = pupil / 2 / grid.camera.distance_mm(grid.depth_mm)
    off = grid.depth_mm - axis.depth_mm
    # A wrong depth displaces the axis in the outermost views by the parallax.
    if abs(off) > max(least / half_angle, ERRORS * axis.depth_error_mm):
        found.append(
            f"The axis was stated at a depth of {grid.depth_mm:.2f} mm, the light field shows it "
            f"at {axis.depth_mm:.2f} mm (standard error {axis.depth_error_mm:.1g}): emission is "
            f"smeared; leave it out to have it found."
        )
    edge = axis.radius_mm / MARGIN
    if grid.radius_mm < LEAST_RADIUS * edge or _has_light_outside(grid, views):
        found.append(
            f"The radius was stated {grid.radius_mm:.3g} mm, but there is light out to "
            f"{edge:.3g} mm: what glows outside is taken for emission within, so state "
            f"{axis.radius_mm:.3g} mm, or take off a background."
        )
    return tuple(found)


def _has_light_outside(grid: AxisymmetricGrid, views: np.ndarray) -> bool:
    """Whether there is more light than noise where no flame within a grid's radius can be."""
    lit = AxisymmetricOperator(grid).matvec(np.ones(np.prod(grid.shape))).reshape(views.shape)
    lit, views = grid.place(lit), grid.place(views)
    dark = lit.max(axis=(0, 2)) <= 0  # view column, column
    rows = views.sum(axis=0, dtype=np.float64).transpose(1, 0, 2)[:, dark].sum(axis=1)
    # Noise differs between neighbouring rows, the flame hardly does.
    error = np.sqrt(np.sum(np.square(np.diff(rows))) / 2)
    light, total = float(rows.sum()), float(views.sum(dtype=np.float64))
    return bool(light > ERRORS * error and light > MOST_OUTSIDE * total)


def check_misfit(grid: AxisymmetricGrid, residual: np.ndarray, peak: float) -> tuple[str, ...]:
    """Sentence if views differ from the best axisymmetric flame by more than noise.

    Noise differs from view to view, or in a single view from pixel to pixel; the residual of a
    flame that is not axisymmetric is similar in neighbours.

    Parameters
    ----------
    grid : AxisymmetricGrid
    residual : ndarray, in the shape of the grid's views
    peak : float
        Brightest pixel of the views.
    """
    views = grid.place(residual)
    if views.shape[1] > 1:
        smooth = ndimage.uniform_filter(views, (0, 0, SMOOTHED, SMOOTHED), np.float64)
        counted = np.ones(views.shape[:2], bool) if grid.counted is None else grid.counted
        both = counted[:, :-1] & counted[:, 1:]
        one, other = smooth[:, :-1][both], smooth[:, 1:][both]
        independent = one.size / SMOOTHED**2
    else:
        one, other = residual[..., :-1, :], residual[..., 1:, :]
        independent = one.size
    shared = float(np.mean(one * other, dtype=np.float64))
    power = float(np.mean(np.square(one), dtype=np.float64))
    error = power / np.sqrt(independent)
    if shared <= max(ERRORS * error, (3 * MODEL_ERROR * peak) ** 2):
        return ()
    return (
        f"No axisymmetric flame explains {np.sqrt(shared) / peak:.2%} of the brightest pixel, more "
        f"than noise: the flame is not axisymmetric, or axis, depth, radius, burner, camera or a "
        f"background is wrong; error bars do not include this.",
    )


def _longer_path(grid: AxisymmetricGrid) -> np.ndarray:
    """Excess of a ray's path through a slab, 1 / cos - 1, to second order, shape (v, u, t, s)."""
    camera, pixels = grid.camera, grid.view_shape[2:]
    distance, slope = camera.distance_mm(grid.depth_mm), camera.depth_to_slope(grid.depth_mm)
    views = centred(camera.views)[:, None]
    squared = []
    for count in pixels:
        place = grid.step_mm * (centred(count) - slope / grid.block * views)
        squared.append(np.square((place - camera.view_step_mm * views) / distance))
    down, across = squared
    return grid.pick((down[:, None, :, None] + across[None, :, None, :]) / 2)


class DepthRatio:
    """Extent of a flame in depth relative to that across, as its light field shows it.

    The reconstructed emission is stretched in depth, with the same light along the line of sight.
    The resulting change of the views, without the parts that an axisymmetric flame or the longer
    path of oblique rays could imitate, is correlated with the residual (a matched filter).

    Parameters
    ----------
    operator : AxisymmetricOperator
    problem : AxisymmetricFit
        Fit to the light field.
    emission : ndarray, shape (heights, radii)
        Reconstructed emission.
    residual : ndarray, shape (v, u, t, s)
        Light field minus that of the best axisymmetric flame, unpenalised.
    sd : ndarray
        Standard deviation of a pixel, in a shape that broadcasts to that of `residual`.

    Attributes
    ----------
    ratio, error : float
        Depth ratio, 1 for an axisymmetric flame, and its standard error due to noise and grid.
    """

    def __init__(
        self,
        operator: AxisymmetricOperator,
        problem: AxisymmetricFit,
        emission: np.ndarray,
        residual: np.ndarray,
        sd: np.ndarray,
    ):
        wide = replace(operator.grid, depth_ratio=DEPTH_RATIO)
        round_one = operator.matvec(emission.ravel())
        seen = AxisymmetricOperator(wide).matvec(emission.ravel() / DEPTH_RATIO)
        peak = float(seen.max())

        def unlike_round(views: np.ndarray) -> np.ndarray:
            explained = problem.explain(operator.rmatvec(views.ravel()))
            return views.reshape(residual.shape) - operator.matvec(explained.ravel()).reshape(
                residual.shape
            )

        change = unlike_round(seen - round_one)
        # The operator gives all rays the path of one along the optical axis. Oblique rays have
        # longer ones, which looks like a flatter flame.
        longer = unlike_round(round_one.reshape(residual.shape) * _longer_path(operator.grid))
        power = max(float(np.sum(np.square(longer))), float(np.finfo(np.float32).tiny))
        change -= longer * float(np.sum(change * longer)) / power
        power = max(float(np.sum(np.square(change))), float(np.finfo(np.float32).tiny))
        noise = float(np.sum(np.square(change * sd)))
        # The change follows the flame's second moment along depth.
        step = DEPTH_RATIO**2 - 1
        size = float(np.sqrt(power / change.size))
        self._squared = 1 + step * float(np.sum(change * residual)) / power
        self._error = step * float(np.hypot(np.sqrt(noise) / power, GRID_ERROR * peak / size))
        self.ratio = float(np.sqrt(max(self._squared, FLATTEST**2)))
        self.error = self._error / 2 / self.ratio

    def hidden(self, ratio: float) -> float | None:
        """Nearest depth ratio that this light field would show, if not `ratio`, else None.

        It is 0 or infinite if there is none to be thought of.
        """
        reach = ERRORS * self._error
        if abs(ratio**2 - 1) >= reach:
            return None
        if ratio < 1:
            return float(np.sqrt(1 - reach)) if reach < 1 - FLATTEST**2 else 0.0
        return float(np.sqrt(1 + reach)) if reach < DEEPEST**2 - 1 else np.inf

    def check(self) -> tuple[str, ...]:
        """Sentence if the flame is deeper or flatter than axisymmetric."""
        if abs(self._squared - 1) <= ERRORS * self._error:
            return ()
        if abs(self.ratio - 1) <= MOST_DEPTH_RATIO:
            return ()
        deeper = "deeper" if self.ratio > 1 else "flatter"
        return (
            f"The flame is {deeper} than wide: its extent in depth is about {self.ratio:.2f} times "
            f"that across (standard error {self.error:.1g}); emission is wrong by that factor.",
        )


def name_unseen(axis: FlameAxis, depth: DepthRatio) -> tuple[str, ...]:
    """Sentences on departures from an axisymmetric, upright flame that noise would hide."""
    found = []
    deep, flat = depth.hidden(DEPTH_RATIO), depth.hidden(1 / DEPTH_RATIO)
    if deep is not None:
        shown = f", only one above about {deep:.2g}" if deep < DEEPEST else ", nor a deeper one"
        found.append(
            f"This light field would not show a flame {DEPTH_RATIO:g} times as deep as wide"
            f"{shown}: what is found would be too large by that factor."
        )
    if flat is not None:
        shown = f", only one below about {flat:.2g}" if flat > 0 else ", nor a flatter one"
        found.append(
            f"This light field would not show a flame {1 / DEPTH_RATIO:.2g} times as deep as wide"
            f"{shown}: what is found would be too small by that factor."
        )
    if ERRORS * axis.depth_lean_error_deg > SEEN_LEAN_DEG:
        found.append(
            f"This light field would not show an axis that leans by {SEEN_LEAN_DEG:g} degrees in "
            f"depth: emission would be that of another height there."
        )
    return tuple(found)
