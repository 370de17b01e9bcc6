"""How far the slabs of a thick layer that absorbs can be off; "How many slabs" derives it."""

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
"""Distances from a face at which a layer's light is bounded."""

NEAREST = 1e-2
"""The smallest of them that is not 0, in mean free paths."""

BOX_EDGES = 2
"""Edges of a box along one axis."""

KINK = 8
"""Of a slope that jumps by J inside a part of width h, midpoints err by at most J h^2 / KINK."""

CURVATURE = 24
"""Of a second derivative g, midpoints of parts of width h err by g h^2 / CURVATURE."""


@dataclass(frozen=True, eq=False)
class MatterSteps:
    """What a ray sees change where it passes from some cells to others.

    Per share of the layer's thickness and, as an upper bound, before any matter dims it.

    Attributes
    ----------
    shown, passed : ndarray of float64, shape (rows, columns)
        Of what the changed cells show of themselves, through the matter in front of them; and of
        what comes through all matter on the ray.
    least, most : ndarray of float64, shape (rows, columns)
        Of the optical thicknesses on either side, at least: the lesser and the greater.
    thickest : ndarray of float64, shape (rows, columns)
        Greatest optical thickness of the cells themselves.
    """

    shown: np.ndarray
    passed: np.ndarray
    least: np.ndarray
    most: np.ndarray
    thickest: np.ndarray

    def at_edges(self, edges: np.ndarray) -> np.ndarray:
        """Largest change, times its width squared, that any slab makes."""
        return sum(
            part * np.exp(-extra) * np.max([w**2 * np.exp(-rate * d) for d, w, _ in slabs], axis=0)
            for part, rate, extra, slabs in self._parts(edges)
        )

    def inside(self, edges: np.ndarray) -> np.ndarray:
        """Sum over all slabs of change times width squared, where light fades within a slab."""
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
    """Radiances that decide what misplaced matter changes, near each cell.

    Attributes
    ----------
    low, high : ndarray of float64, shape (rows, columns)
        Least and greatest that the matter tends to in depth.
    through : ndarray of float64, shape (rows, columns)
        Greatest of that, and of what shines on it from behind.
    """

    low: np.ndarray
    high: np.ndarray
    through: np.ndarray

    def between(self, axis: int) -> "Radiances":
        """Join each cell and its next along an axis, which is put first."""
        (low, low_1), (high, high_1), (through, through_1) = (_pairs(x, axis) for x in self)
        return Radiances(
            np.minimum(low, low_1), np.maximum(high, high_1), np.maximum(through, through_1)
        )


class AbsorbingSlabs:
    """Bound on the change of a pixel when a thick layer that absorbs is cut into slabs.

    Parameters
    ----------
    bounds : SceneBounds
    layer : Layer
        With a thickness and an optical thickness.
    """

    def __init__(self, bounds: SceneBounds, layer: Layer):
        self._layer = layer
        # One cell of nothing around the layer.
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
        """Bound on the change of any pixel with so many slabs in place of the whole."""
        edges, error = slab_edges(self._layer, slabs), 0.0
        for steps, move, window in zip(self._steps, self._moves, self._windows, strict=True):
            changed = BOX_EDGES * steps.at_edges(edges) + steps.inside(edges)
            error += move * _largest_sum(changed, window) / KINK
        bend = float(self._whole.at_edges(edges).max())
        return error + 4 * math.prod(self._moves) * bend / CURVATURE


def _travel_mm(bounds: SceneBounds, layer: Layer, axis: int) -> float:
    """Farthest that a ray moves over a layer from its front to its back."""
    here = bounds.footprints[layer, axis]
    faces = (layer.depth_mm + side * layer.thickness_mm / 2 for side in (-1, 1))
    return sum(farthest_move_mm(bounds.camera, here, axis, face) for face in faces)


def _arriving(emission: np.ndarray, tau: np.ndarray, near: list[int], behind: float) -> Radiances:
    """Find what rays that meet a cell can bring from behind it; near: cells to each side."""
    size = [2 * cells + 1 for cells in near]
    absorbs, clear_glow = tau > 0, (emission > 0) & (tau == 0)
    source = np.divide(emission, tau, out=np.zeros_like(tau), where=absorbs)
    low = minimum_filter(np.where(absorbs, source, np.inf), size, mode="nearest")
    high = maximum_filter(source, size, mode="nearest")
    # What glows and does not absorb has no bound in depth but that of all its light.
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
    """Slabs in groups of about one distance: its least, greatest width, sum of squared widths."""
    places = np.append(0, np.geomspace(NEAREST / max(tau, 1), 1, PLACES - 1))
    group, found = np.searchsorted(places, distances, side="right") - 1, []
    for inside in (group == number for number in np.unique(group)):
        width = widths[inside]
        found.append((float(distances[inside].min()), float(width.max()), float(width @ width)))
    return found


def _pairs(cells: np.ndarray, axis: int) -> tuple[np.ndarray, np.ndarray]:
    """Put an axis first; all lines but the last, and all but the first."""
    lines = np.moveaxis(cells, axis, 0)
    return lines[:-1], lines[1:]


def _least(tau: np.ndarray, axis: int, side: int, cells: int) -> np.ndarray:
    """Least mean optical thickness of a cell and those behind it that a ray can meet there."""
    lines = np.moveaxis(tau, axis, 0)[::-side]
    sums = np.cumsum(np.pad(lines, [(1, 0), (0, 0)]), axis=0)
    least = lines.copy()
    for count in range(2, min(cells, len(lines)) + 1):
        before = np.maximum(np.arange(len(lines)) + 1 - count, 0)  # outside there is nothing
        np.minimum(least, (sums[1:] - sums[before]) / count, out=least)
    return np.moveaxis(least[::-side], 0, axis)


def _largest_sum(steps: np.ndarray, window: int) -> float:
    """Largest sum of so many steps, one behind the other along the first axis."""
    sums = np.cumsum(np.pad(steps, [(1, 0), (0, 0)]), axis=0)
    window = min(window, len(steps))
    return float((sums[window:] - sums[:-window]).max())
