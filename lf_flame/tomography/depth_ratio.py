"""Extent of an axisymmetric flame in depth, as far as its light field shows it."""

from dataclasses import replace

import numpy as np

from lf_flame._common.arrays import centred
from lf_flame.tomography.axis import FlameAxis
from lf_flame.tomography.axisymmetric_grid import AxisymmetricGrid
from lf_flame.tomography.geometries import SectionGeometry, backproject, project
from lf_flame.tomography.projection_operator import AxisymmetricOperator

MOST_SIGMAS = 4.0
"""Number of standard errors that a departure must exceed to be more than noise."""

DEPTH_RATIO, DEEPEST = 1.5, 10.0
"""Extent in depth, relative to that across, of the flame that serves as comparison, and largest
one that is considered; its inverse is the smallest."""

GRID_ERROR = 5e-5
"""Residual in the component of a flame stretched in depth that the grid itself causes."""

SEEN_LEAN_DEG = 15.0
"""Lean in depth, in degrees, that a light field should show; if it does not, a note says so."""


class DepthRatio:
    """Extent of a flame in depth relative to that across, as its light field shows it.

    The reconstructed emission is stretched in depth, with the same light along the line of sight.
    The resulting change of the views, without the parts that an axisymmetric flame or the longer
    path of oblique rays could imitate, is correlated with the residual (a matched filter).

    ratio, error : depth ratio, 1 for an axisymmetric flame, and its standard error
    departure : departure from 1, in units of the larger of 0.05 and `MOST_SIGMAS` errors
    """

    def __init__(
        self, geometry: SectionGeometry, emission: np.ndarray, views: np.ndarray, sd: np.ndarray
    ):
        operator = geometry.operator
        wide = AxisymmetricOperator(replace(geometry.grid, depth_ratio=DEPTH_RATIO))
        round_one = project(operator, emission)
        seen = project(wide, emission / DEPTH_RATIO)

        def unlike_round(views: np.ndarray) -> np.ndarray:
            explained = geometry.problem(backproject(operator, views)).unpenalised()
            return views - project(operator, explained)

        residual, change = unlike_round(views), unlike_round(seen - round_one)
        # The operator gives all rays the path of one along the optical axis. Oblique rays have
        # longer ones, which looks like a flatter flame.
        longer = unlike_round(round_one * _longer_path(geometry.grid))
        least = float(np.finfo(np.float32).tiny)
        power = max(float(np.sum(np.square(longer))), least)
        change -= longer * float(np.sum(change * longer)) / power
        power = max(float(np.sum(np.square(change))), least)
        noise = float(np.sum(np.square(change * sd)))
        # The change follows the flame's second moment along depth.
        step = DEPTH_RATIO**2 - 1
        size = float(np.sqrt(power / change.size))
        squared = 1 + step * float(np.sum(change * residual)) / power
        grid_error = GRID_ERROR * float(seen.max()) / size
        self._error = step * float(np.hypot(np.sqrt(noise) / power, grid_error))
        self.ratio = float(np.sqrt(max(squared, DEEPEST**-2)))
        self.error = self._error / 2 / self.ratio
        sigmas = abs(squared - 1) / (MOST_SIGMAS * self._error)
        self.departure = min(sigmas, abs(self.ratio - 1) / 0.05)

    def hidden(self, ratio: float) -> float | None:
        """Nearest ratio that this light field shows, if not `ratio`; 0 or infinite if none."""
        reach = MOST_SIGMAS * self._error
        if abs(ratio**2 - 1) >= reach:
            return None
        if ratio < 1:
            return float(np.sqrt(1 - reach)) if reach < 1 - DEEPEST**-2 else 0.0
        return float(np.sqrt(1 + reach)) if reach < DEEPEST**2 - 1 else np.inf


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


def name_unseen(axis: FlameAxis, depth: DepthRatio) -> tuple[str, ...]:
    """Sentences on departures from an axisymmetric, upright flame that noise would hide."""
    found = []
    for ratio, beyond, word, size in (
        (DEPTH_RATIO, "above", "deeper", "large"), (1 / DEPTH_RATIO, "below", "flatter", "small"),
    ):  # fmt: skip
        nearest = depth.hidden(ratio)
        if nearest is None:
            continue
        shown = f", only one {beyond} about {nearest:.2g}"
        if nearest in (0.0, np.inf):
            shown = f", nor a {word} one"
        found.append(
            f"This light field would not show a flame {ratio:.2g} times as deep as wide{shown}: "
            f"what is found would be too {size} by that factor."
        )
    if MOST_SIGMAS * axis.depth_lean_error_deg > SEEN_LEAN_DEG:
        found.append(
            f"This light field would not show an axis that leans by {SEEN_LEAN_DEG:g} degrees in "
            f"depth: emission would be that of another height there."
        )
    return tuple(found)
