"""Error of a number of slabs or colours, measured on some pixels of a layer's image.

The first-order bounds of `lf_flame.simulation.planning.effects` hold for all textures, but for most
they are many times too large: thickness and colour spread light to both sides, and most of the
changes cancel. If the bounds do not allow a single plane for a thick layer, or a single focal
length for a band of light, some pixels are integrated exactly, with a number of parts (slabs or
colours) and with four times as many; the difference gives the error. This is valid if light only
adds up and reaches each pixel through its own lenslet; otherwise only the bounds are used.
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
"""Largest number of rows, and of columns, at whose crossings pixels are measured."""

NEAR_AXIS = 0.1
"""Weight of lines on the optical axis when lines are chosen; the farthest lines have 1 more."""

SAFETY = 2.0
"""Factor on the largest error of a measured pixel, for the pixels that are not measured."""

REFINED = 4
"""Ratio of the numbers of parts of the two images that are compared. Errors fall at least as one
over the number of parts, so the error of the finer image is at most a third of the difference."""


CHUNK = 16
"""Number of parts that are integrated at once, to limit memory."""


class Probes:
    """Pixels of a layer's image at crossings of rows and columns where its texture changes most.

    Parameters
    ----------
    bounds : SceneBounds
        Bounds of the scene in front of its camera.
    layer : Layer
    band : bool
        Whether parts are colours of the band of light; otherwise they are slabs of the layer.
    """

    def __init__(self, bounds: SceneBounds, layer: Layer, band: bool):
        self._texture = layer.texture
        # A stop can reduce a bundle to a part of a pixel; in the limit, a point, it blurs nothing.
        self._blurs = sorted({bounds.defocus, bounds.defocus and not round_stops(bounds.camera)})
        self._lines = [ProbedLines.choose(bounds.camera, layer, axis, band) for axis in (0, 1)]
        self._images: dict[int, list[np.ndarray]] = {}

    def error(self, parts: int) -> float:
        """Error of the image with this number of parts, in the unit of the texture.

        It is the largest error of a measured pixel, times `SAFETY`.
        """
        few, many = self._image(parts), self._image(REFINED * parts)
        largest = (np.abs(a - b).max(initial=0.0) for a, b in zip(few, many, strict=True))
        return SAFETY * float(max(largest))

    def _image(self, parts: int) -> list[np.ndarray]:
        """Images of the pixels from the middles of equal parts, one image for each kind of blur."""
        if parts not in self._images:
            middles = (np.arange(parts) + 0.5) / parts
            chunks = np.array_split(middles, math.ceil(parts / CHUNK))
            self._images[parts] = [
                np.add.reduce([self._integrate(chunk, blur) for chunk in chunks]) / parts
                for blur in self._blurs
            ]
        return self._images[parts]

    def _integrate(self, places: np.ndarray, blur: bool) -> np.ndarray:
        """Sum of the images of the pixels for light from each of some places of the spread."""
        (top, down), (left, right) = (lines.bands(places, blur) for lines in self._lines)
        # Sum over the cells of each row's band, then over those of each column's; the axes are
        # place, cell, row.
        rows = sum(down[..., k, None] * self._texture[top + k] for k in range(down.shape[2]))
        rows, each = np.ascontiguousarray(rows.swapaxes(1, 2)), np.arange(len(places))[:, None]
        pixels = sum(right[..., k, None] * rows[each, left + k] for k in range(right.shape[2]))
        return pixels.sum(axis=0)


class ProbedLines(NamedTuple):
    """Rows or columns of pixels, and their bundles on a layer at both ends of a spread.

    Attributes
    ----------
    edges_mm : ndarray of float64, shape (cells + 1,)
        Edges of the layer's cells.
    centres_mm : ndarray of float64, shape (2, lines)
        Intersection of the bundles' central rays with the layer, at both ends of the spread.
    lenslet_mm, pixel_mm : ndarray of float64, shape (2,)
        Signed widths of the images of lenslet and pixel on the layer, at both ends.
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

        Parameters
        ----------
        camera : PlenopticCamera
        layer : Layer
        axis : int
            0 for rows, 1 for columns.
        band : bool
            Whether the spread is the band of light; otherwise it is the layer's thickness.
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
        """Weights of the cells that each line sees.

        Parameters
        ----------
        places : ndarray, shape (places,)
            Places in the spread of depth or focal length, from 0 to 1.
        blur : bool
            Whether the width of a pixel's bundle is included.

        Returns
        -------
        start : ndarray of int64, shape (places, lines)
            Index of the first cell.
        weights : ndarray of float64, shape (places, lines, cells of a band)
            Weights of this cell and of the following ones.
        """
        # The position of a ray on a layer is linear in depth and in the power of the lens.
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
    """Probes of layers; an empty list if measurements would not be valid.

    They are valid if light only adds up, and reaches each pixel through its own lenslet.

    Parameters
    ----------
    bounds : SceneBounds
    layers : iterable of Layer
    effect : {"thickness", "chromatic"}
    """
    camera = bounds.camera
    matter = any(layer.opaque or layer.optical_thickness.any() for layer in bounds.layers)
    if matter or any(misplaced_mm(camera)) or neighbours(camera):
        return []
    return [Probes(bounds, layer, effect == "chromatic") for layer in layers]


def measured_change(bounds: SceneBounds, layer: Layer, effect: str) -> float:
    """Measure the change of the image if all light of a layer had its middle depth or colour.

    Parameters
    ----------
    bounds : SceneBounds
    layer : Layer
    effect : {"thickness", "chromatic"}

    Returns
    -------
    float
        Largest change of a pixel in the unit of the textures; infinite if it cannot be measured.
    """
    probes = find_probes(bounds, [layer], effect)
    return probes[0].error(1) if probes else math.inf


def _choose(camera: PlenopticCamera, layer: Layer, axis: int) -> np.ndarray:
    """Choose lines that see a layer: the one that may change most in each part, and of all.

    Returns
    -------
    ndarray of int64, shape (lines,)
        Indices of the lines, counted over views and then over lenslets.
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
    # The displacement of light is proportional to its distance from the optical axis.
    change = roughness * (NEAR_AXIS + np.abs(centres[lines]) / max(np.abs(centres).max(), 1e-300))
    parts = np.array_split(np.arange(lines.size), min(PROBES // 2, lines.size) or 1)
    spread = [part[change[part].argmax()] for part in parts if part.size]
    return lines[np.union1d(spread, np.argsort(change, kind="stable")[-PROBES // 2 :]).astype(int)]


def _roughness(texture: np.ndarray, axis: int) -> np.ndarray:
    """Largest change of light at each boundary of cells along an axis, or in cells next to it."""
    cells = np.pad(np.moveaxis(texture, axis, 0), 1)
    beside = np.abs(np.diff(cells, axis=1)).max(axis=1)
    return np.maximum(
        np.abs(np.diff(cells, axis=0)).max(axis=1), np.maximum(beside[1:], beside[:-1])
    )
