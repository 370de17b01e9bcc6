"""How many slabs and colours a layer's image takes, measured on some of its pixels.

The bounds by the farthest move (`lf_flame.simulation.planning.effects`) hold for every texture, and
are many times too wide for most: thickness and colour spread light to both sides, and what comes
from one side makes up for what goes to the other. Where they do not allow one plane for a thick
layer, or one focal length for a band of colours, some pixels are integrated exactly, by few parts
and by four times as many, until both agree. What is measured holds where light only adds and
reaches a pixel through its own lenslet; elsewhere the bounds alone decide.
"""

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from lf_flame.optics.camera import PlenopticCamera
from lf_flame.optics.ray_bundle import trace_footprint, trapezoid_cdf
from lf_flame.scenes.scene import Layer
from lf_flame.simulation.bundle_shifts import focus_spread, misplaced_mm
from lf_flame.simulation.planning.scene_bounds import SceneBounds
from lf_flame.simulation.stops import neighbours, round_stops

PROBES = 64
"""Number of rows and of columns at whose crossings pixels are measured."""

NEAR_AXIS = 0.1
"""Weight of lines on the axis, beside that of the farthest, when lines are chosen."""

SAFETY = 2.0
"""Factor on the largest error of a measured pixel, for the pixels that are not measured."""

REFINED = 4
"""Number of parts that stand for each part whose error is measured. Errors fall at least as one
over their number, so that the finer image has at most a third of the difference left."""


CHUNK = 16
"""Number of parts that are integrated at a time."""


class Probes:
    """Pixels of a layer's image, at crossings of rows and columns where the texture changes most.

    Parameters
    ----------
    bounds : SceneBounds
    layer : Layer
    band : bool
        Whether the parts are colours; else they are slabs of the layer's thickness.
    """

    def __init__(self, bounds: SceneBounds, layer: Layer, band: bool):
        self._texture = layer.texture
        # A stop may cut bundles down to a part of a pixel: the narrowest, a point, blurs nothing.
        self._blurs = sorted({bounds.defocus, bounds.defocus and not round_stops(bounds.camera)})
        self._lines = [ProbedLines.choose(bounds.camera, layer, axis, band) for axis in (0, 1)]
        self._images: dict[int, list[np.ndarray]] = {}

    def error(self, parts: int) -> float:
        """Largest error of a pixel by so many parts, in the unit of the texture."""
        few, many = self._image(parts), self._image(REFINED * parts)
        largest = (np.abs(a - b).max(initial=0.0) for a, b in zip(few, many, strict=True))
        return SAFETY * float(max(largest))

    def _image(self, parts: int) -> list[np.ndarray]:
        """Mean over the middles of equal parts, for each blur by the pixel's own width."""
        if parts not in self._images:
            middles = (np.arange(parts) + 0.5) / parts
            chunks = np.array_split(middles, math.ceil(parts / CHUNK))
            self._images[parts] = [
                np.add.reduce([self._integrate(chunk, blur) for chunk in chunks]) / parts
                for blur in self._blurs
            ]
        return self._images[parts]

    def _integrate(self, places: np.ndarray, blur: bool) -> np.ndarray:
        """Add up the pixels as if all light stood at each of some places of the spread."""
        (top, down), (left, right) = (lines.bands(places, blur) for lines in self._lines)
        # Over the cells of each row's band, then over those of each column's: [place, cell, row].
        rows = sum(down[..., k, None] * self._texture[top + k] for k in range(down.shape[2]))
        rows, each = np.ascontiguousarray(rows.swapaxes(1, 2)), np.arange(len(places))[:, None]
        pixels = sum(right[..., k, None] * rows[each, left + k] for k in range(right.shape[2]))
        return pixels.sum(axis=0)


class ProbedLines(NamedTuple):
    """Rows or columns of pixels, and their bundles on a layer at the ends of a spread.

    Attributes
    ----------
    edges_mm : ndarray of float64, shape (cells + 1,)
        Edges of the layer's cells.
    centres_mm : ndarray of float64, shape (2, lines)
        Where the bundles' central rays meet the layer, at both ends.
    lenslet_mm, pixel_mm : ndarray of float64, shape (2,)
        Signed images of the lenslet and of the pixel.
    shift : float
        Relative change of the focal length over the spread; 0 for a spread of depth.
    """

    edges_mm: np.ndarray
    centres_mm: np.ndarray
    lenslet_mm: np.ndarray
    pixel_mm: np.ndarray
    shift: float

    @classmethod
    def choose(cls, camera: PlenopticCamera, layer: Layer, axis: int, band: bool) -> "ProbedLines":
        """Choose lines along an axis that see a layer.

        band: whether the spread is one of colours; else it is the layer's thickness.
        """
        chosen, ends = _choose(camera, layer, axis), []
        shift = camera.chromatic_shift if band else 0.0
        for side in (-0.5, 0.5):
            focal_mm = camera.main_lens_focal_mm * (1 + shift * side)
            depth_mm = layer.depth_mm + layer.thickness_mm * side * (not band)
            ends.append(trace_footprint(camera, depth_mm, axis, focal_mm))
        return cls(
            layer.cell_edges_mm(axis),
            np.array([end.centres_mm.ravel()[chosen] for end in ends]),
            np.array([end.lenslet_width_mm for end in ends]),
            np.array([end.pixel_width_mm for end in ends]),
            shift,
        )

    def bands(self, places: np.ndarray, blur: bool) -> tuple[np.ndarray, np.ndarray]:
        """First cell of each line's band, and the weights of its cells.

        places: in depth or in focal length, from 0 to 1.

        Returns
        -------
        start : ndarray of int64, shape (places, lines)
        weights : ndarray of float64, shape (places, lines, cells of a band)
        """
        # A ray's place is linear in depth, and in the power of the lens.
        places = places * (1 + self.shift / 2) / (1 + self.shift * (places - 0.5))
        between = np.stack([1 - places, places], axis=1)
        centres = (between @ self.centres_mm)[..., None]
        lenslet, pixel = (
            np.abs(between @ width)[:, None, None] for width in (self.lenslet_mm, self.pixel_mm)
        )
        reach, cell_mm = (lenslet + pixel * blur) / 2, self.edges_mm[1] - self.edges_mm[0]
        cells = self.edges_mm.size - 1
        band = min(cells, math.ceil(2 * reach.max() / cell_mm) + 1)
        start = np.floor((centres - reach - self.edges_mm[0]) / cell_mm).astype(np.int64)
        start = start.clip(0, cells - band)
        passed = trapezoid_cdf(
            self.edges_mm[start + np.arange(band + 1)] - centres, lenslet, pixel * blur
        )
        return start[..., 0], np.diff(passed, axis=2)


def find_probes(bounds: SceneBounds, layers: Iterable[Layer], effect: str) -> list[Probes]:
    """Lay probes over layers; none where what they show would not hold.

    Light has to add only, and to reach each pixel through its own lenslet.

    effect: "thickness" or "chromatic".
    """
    camera = bounds.camera
    matter = any(layer.opaque or layer.optical_thickness.any() for layer in bounds.layers)
    if matter or any(misplaced_mm(camera)) or neighbours(camera):
        return []
    return [Probes(bounds, layer, effect == "chromatic") for layer in layers]


def measured_change(bounds: SceneBounds, layer: Layer, effect: str) -> float:
    """Largest change of a pixel if a layer's light stood at its middle depth or mean colour.

    effect: "thickness" or "chromatic".

    Returns
    -------
    float
        In the unit of the textures; infinite where it cannot be measured.
    """
    probes = find_probes(bounds, [layer], effect)
    return probes[0].error(1) if probes else math.inf


def _choose(camera: PlenopticCamera, layer: Layer, axis: int) -> np.ndarray:
    """Choose lines that see a layer and may change most: one in each part of the image, and more.

    Returns
    -------
    ndarray of int64, shape (lines,)
        Numbers of (view, lenslet), in this order.
    """
    low, high = layer.extent_mm(layer.texture, axis)
    lit: np.ndarray | np.bool_ = np.False_
    for depth_mm, focal_mm in focus_spread(camera, layer):
        footprint = trace_footprint(camera, depth_mm, axis, focal_mm)
        centres, reach = footprint.centres_mm, footprint.half_width_mm
        lit = lit | ((centres + reach > low) & (centres - reach < high))
    centres = trace_footprint(camera, layer.depth_mm, axis).centres_mm.ravel()
    lines = np.flatnonzero(lit)
    lines = lines[np.argsort(centres[lines], kind="stable")]
    edges = layer.cell_edges_mm(axis)
    nearest = np.rint((centres[lines] - edges[0]) / (edges[1] - edges[0])).astype(int)
    roughness = _roughness(layer.texture, axis)[nearest.clip(0, edges.size - 1)]
    # Light moves in proportion to its distance from the axis, at the focal plane least of all.
    change = roughness * (NEAR_AXIS + np.abs(centres[lines]) / max(np.abs(centres).max(), 1e-300))
    parts = np.array_split(np.arange(lines.size), min(PROBES // 2, lines.size) or 1)
    spread = [part[change[part].argmax()] for part in parts if part.size]
    return lines[np.union1d(spread, np.argsort(change, kind="stable")[-PROBES // 2 :]).astype(int)]


def _roughness(texture: np.ndarray, axis: int) -> np.ndarray:
    """Largest change of light at each boundary of cells along an axis, or beside it."""
    cells = np.pad(np.moveaxis(texture, axis, 0), 1)
    beside = np.abs(np.diff(cells, axis=1)).max(axis=1)
    return np.maximum(
        np.abs(np.diff(cells, axis=0)).max(axis=1), np.maximum(beside[1:], beside[:-1])
    )
