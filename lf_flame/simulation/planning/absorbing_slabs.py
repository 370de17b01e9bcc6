"""Bound on the error of dividing a thick, absorbing layer into slabs.

It is derived on the page "How many slabs" of the documentation, section "Slabs that absorb".
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.ndimage import maximum_filter, minimum_filter

from lf_flame.scenes.scene import Layer
from lf_flame.simulation.bundle_shifts import farthest_move_mm
from lf_flame.simulation.planning.scene_bounds import SceneBounds, box_mm
from lf_flame.simulation.slabs import slab_edges

PLACES = 32
"""Number of distances from a face by which slabs are grouped."""

NEAREST = 1e-2
"""Smallest of these distances above 0, in mean free paths."""

BOX_EDGES = 2
"""Number of edges of a box along one axis."""

KINK = 8
"""Divisor in the midpoint rule's error: at most J h^2 / KINK for a slope that jumps by J within a
part of width h."""

CURVATURE = 24
"""Divisor in the midpoint rule's error: g h^2 / CURVATURE for parts of width h and a second
derivative g."""


@dataclass(frozen=True, eq=False)
class MatterSteps:
    """Changes of the light along a ray where it passes from one cell to the next.

    Changes are upper bounds, per fraction of the layer's thickness and before attenuation.

    Attributes
    ----------
    shown, passed : ndarray of float64, shape (rows, columns)
        Change of the light that the cells emit, which reaches the camera through the matter in
        front of them; and of the light that passes through all matter on the ray.
    least, most : ndarray of float64, shape (rows, columns)
        Lower bounds on the optical thicknesses on the two sides: the smaller and the larger one.
    thickest : ndarray of float64, shape (rows, columns)
        Largest optical thickness of the cells themselves.
    """

    shown: np.ndarray
    passed: np.ndarray
    least: np.ndarray
    most: np.ndarray
    thickest: np.ndarray

    def at_edges(self, edges: np.ndarray) -> np.ndarray:
        """Largest product of change and squared width over all slabs."""
        return sum(
            part * np.exp(-extra) * np.max([w**2 * np.exp(-rate * d) for d, w, _ in slabs], axis=0)
            for part, rate, extra, slabs in self._parts(edges)
        )

    def inside(self, edges: np.ndarray) -> np.ndarray:
        """Sum over all slabs of change times squared width, for attenuation within a slab."""
        return sum(
            part
            * np.exp(-extra)
            * sum(
                square * np.minimum(1, self.thickest * w) * np.exp(-rate * d)
                for d, w, square in slabs
            )
            for part, rate, extra, slabs in self._parts(edges)
        )

    def _parts(self, edges: np.ndarray):
        front, near = edges[:-1], np.minimum(edges[:-1], 1 - edges[1:]).clip(0)
        tau, widths = float(self.thickest.max()), np.diff(edges)
        yield self.shown, self.least, 0.0, _by_distance(front, widths, tau)
        yield self.passed, self.most - self.least, self.least, _by_distance(near, widths, tau)


class Radiances(NamedTuple):
    """Bounds on the radiance that arrives at matter near each cell, from behind.

    Attributes
    ----------
    low, high : ndarray of float64, shape (rows, columns)
        Smallest and largest radiance of the matter itself if it is optically thick (its source
        function, emission over absorption).
    through : ndarray of float64, shape (rows, columns)
        Largest radiance, including light from behind the layer.
    """

    low: np.ndarray
    high: np.ndarray
    through: np.ndarray

    def between(self, axis: int) -> "Radiances":
        """Bounds for each pair of neighbouring cells along an axis, which comes first."""
        (low, low_1), (high, high_1), (through, through_1) = (_pairs(x, axis) for x in self)
        return Radiances(
            np.minimum(low, low_1), np.maximum(high, high_1), np.maximum(through, through_1)
        )


class AbsorbingSlabs:
    """Bound on the error of a pixel if a thick, absorbing layer is divided into slabs.

    Parameters
    ----------
    bounds : SceneBounds
        Bounds of the scene in front of its camera.
    layer : Layer
        Layer with a thickness and an optical thickness.
    """

    def __init__(self, bounds: SceneBounds, layer: Layer):
        self._layer = layer
        # The layer is surrounded by one empty cell.
        emission, tau = np.pad(layer.texture, 1), np.pad(layer.optical_thickness, 1)
        travels = [_travel_mm(bounds, layer, axis) for axis in (0, 1)]
        cells = [bounds.steps[layer, axis].cell_mm for axis in (0, 1)]
        met = [
            min(math.ceil(travel / cell), max(tau.shape))
            for travel, cell in zip(travels, cells, strict=True)
        ]
        self._moves, self._windows, self._steps, sides = [], [], [], []
        radiances = _arriving(emission, tau, met, bounds.behind[layer])
        for axis, (cell, travel) in enumerate(zip(cells, travels, strict=True)):
            box = box_mm(bounds, layer, axis)
            on_sides = [_least(tau, axis, side, met[axis]) for side in (-1, 1)]
            before, behind = _pairs(on_sides[0], axis)[0], _pairs(on_sides[1], axis)[1]
            (emission_0, emission_1), (tau_0, tau_1) = _pairs(emission, axis), _pairs(tau, axis)
            changes = emission_1 - emission_0, tau_1 - tau_0
            thickest = np.maximum(tau_0, tau_1)
            self._steps.append(
                _matter_steps(*changes, before, behind, radiances.between(axis), thickest)
            )
            self._moves.append(travel / max(box, 1e-300))
            self._windows.append(math.ceil((travel + box) / cell) + 1)
            sides += on_sides
        least, most = np.min(sides, axis=0), np.max(sides, axis=0)
        self._whole = _matter_steps(emission, tau, least, most, radiances, tau)

    def change(self, slabs: int) -> float:
        """Bound on the error of any pixel with this number of slabs."""
        edges, error = slab_edges(self._layer, slabs), 0.0
        for steps, move, window in zip(self._steps, self._moves, self._windows, strict=True):
            changed = BOX_EDGES * steps.at_edges(edges) + steps.inside(edges)
            error += move * _largest_sum(changed, window) / KINK
        bend = float(self._whole.at_edges(edges).max())
        return error + 4 * math.prod(self._moves) * bend / CURVATURE


def _travel_mm(bounds: SceneBounds, layer: Layer, axis: int) -> float:
    """Largest displacement of a ray across a layer between its front and its back, in mm."""
    here = bounds.footprints[layer, axis]
    faces = (layer.depth_mm + side * layer.thickness_mm / 2 for side in (-1, 1))
    return sum(farthest_move_mm(bounds.camera, here, axis, face) for face in faces)


def _arriving(emission: np.ndarray, tau: np.ndarray, near: list[int], behind: float) -> Radiances:
    """Bound the radiance that arrives at each cell from behind.

    Parameters
    ----------
    emission, tau : ndarray, shape (rows, columns)
        Emission and optical thickness of the cells.
    near : list of int
        Number of cells to each side that a ray through a cell can meet, along each axis.
    behind : float
        Radiance from behind the layer.
    """
    size = [2 * cells + 1 for cells in near]
    absorbs, clear_glow = tau > 0, (emission > 0) & (tau == 0)
    source = np.divide(emission, tau, out=np.zeros_like(tau), where=absorbs)
    low = minimum_filter(np.where(absorbs, source, np.inf), size, mode="nearest")
    high = maximum_filter(source, size, mode="nearest")
    # Cells that emit and do not absorb have no source function; all of their light is the bound.
    unbound = maximum_filter(clear_glow, size, mode="nearest")
    low, high = np.where(unbound | ~np.isfinite(low), 0.0, low), np.maximum(high, 0.0)
    most = np.where(unbound, behind + emission.max(), high)
    return Radiances(low, most, np.maximum(most, behind))


def _matter_steps(
    emission, tau, one_side, other_side, arriving: Radiances, thickest
) -> MatterSteps:
    shown = np.maximum(
        np.abs(emission - arriving.low * tau), np.abs(emission - arriving.high * tau)
    )
    least, most = np.minimum(one_side, other_side), np.maximum(one_side, other_side)
    return MatterSteps(shown, arriving.through * np.abs(tau), least, most, thickest)


def _by_distance(
    distances: np.ndarray, widths: np.ndarray, tau: float
) -> list[tuple[float, float, float]]:
    """Group slabs by distance: smallest distance, largest width, and sum of squared widths."""
    places = np.append(0, np.geomspace(NEAREST / max(tau, 1), 1, PLACES - 1))
    group, found = np.searchsorted(places, distances, side="right") - 1, []
    for inside in (group == number for number in np.unique(group)):
        width = widths[inside]
        found.append((float(distances[inside].min()), float(width.max()), float(width @ width)))
    return found


def _pairs(cells: np.ndarray, axis: int) -> tuple[np.ndarray, np.ndarray]:
    """Each line and the next one along an axis, which comes first."""
    lines = np.moveaxis(cells, axis, 0)
    return lines[:-1], lines[1:]


def _least(tau: np.ndarray, axis: int, side: int, cells: int) -> np.ndarray:
    """Smallest mean optical thickness over a cell and the next ones on one side of it.

    It is the smallest over all numbers of cells, up to `cells`, that a ray can pass there.
    """
    lines = np.moveaxis(tau, axis, 0)[::-side]
    sums = np.cumsum(np.pad(lines, [(1, 0), (0, 0)]), axis=0)
    least = lines.copy()
    for count in range(2, min(cells, len(lines)) + 1):
        before = np.maximum(np.arange(len(lines)) + 1 - count, 0)  # outside, the thickness is 0
        np.minimum(least, (sums[1:] - sums[before]) / count, out=least)
    return np.moveaxis(least[::-side], 0, axis)


def _largest_sum(steps: np.ndarray, window: int) -> float:
    """Largest sum of `window` consecutive steps along the first axis."""
    sums = np.cumsum(np.pad(steps, [(1, 0), (0, 0)]), axis=0)
    window = min(window, len(steps))
    return float((sums[window:] - sums[:-window]).max())
