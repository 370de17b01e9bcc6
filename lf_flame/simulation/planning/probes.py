"""Error of a number of slabs or colours, measured on some pixels of a layer's image.

The first-order bounds of `lf_flame.simulation.planning.effects` hold for all textures, but for most
they are many times too large: thickness and colour spread light to both sides, and most of the
changes cancel. If the bounds do not allow a single plane for a thick layer, or a single focal
length for a band of light, some pixels are integrated exactly, with a number of parts (slabs or
colours) and with four times as many; the difference gives the error. This is valid if light only
adds up and reaches each pixel through its own lenslet; otherwise only the bounds are used.
"""

import math
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np
from scipy import sparse

from lf_flame.optics.camera import PlenopticCamera
from lf_flame.optics.ray_bundle import trace_footprint, trapezoid_cdf
from lf_flame.scenes.scene import Layer
from lf_flame.simulation.bundle_shifts import misplaced_mm
from lf_flame.simulation.planning.scene_bounds import SceneBounds
from lf_flame.simulation.stops import neighbours, round_stops

PROBES = 64
"""Largest number of rows, and of columns, at whose crossings pixels are measured."""

SAFETY = 2.0
"""Factor on the largest error of a measured pixel, for the pixels that are not measured."""

REFINED = 4
"""Ratio of the numbers of parts of the two images that are compared. Errors fall at least as one
over the number of parts, so the error of the finer image is at most a third of the difference."""

CHUNK = 16
"""Number of places in a spread that are integrated at once, to limit memory."""

LINES = 1024
"""Number of lines that are integrated at once to choose among them, to limit memory."""


class Probes:
    """Pixels of a layer's image at crossings of the rows and columns that change most.

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
        rows, columns = (ProbedLines.of(bounds.camera, layer, axis, band) for axis in (0, 1))
        self._lines = self._choose(rows, columns)

    def error(self, parts: int) -> float:
        """Error of the image with this number of parts, in the unit of the texture.

        It is the largest error of a measured pixel, times `SAFETY`.
        """
        return SAFETY * float(self._errors(*self._lines, parts).max())

    def _errors(self, rows: "ProbedLines", columns: "ProbedLines", parts: int) -> np.ndarray:
        """Error of each crossing of some lines, the largest of all kinds of blur."""
        rules = Rule.of_middles(parts), Rule.with_ends(REFINED * parts)
        errors = []
        for blur in self._blurs:
            few, many = (
                sum(self._integrate(rows, columns, some, blur) for some in rule.chunks())
                for rule in rules
            )
            errors.append(np.abs(few - many))
        return np.max(errors, axis=0)

    def _integrate(
        self, rows: "ProbedLines", columns: "ProbedLines", rule: "Rule", blur: bool
    ) -> np.ndarray:
        """Image of the crossings, integrated over a part of the spread."""
        texture, turned = self._texture, columns.number < rows.number
        if turned:  # the fewer lines first, which takes less memory
            rows, columns, texture = columns, rows, texture.T
        places = len(rule.places)
        seen = (rows.shares(rule.places, blur) @ texture).reshape(places, rows.number, -1)
        seen = np.ascontiguousarray(seen.swapaxes(1, 2)).reshape(-1, rows.number)
        pixels = columns.shares(rule.places, blur, apart=True) @ seen
        image = np.tensordot(rule.weights, pixels.reshape(places, columns.number, -1), 1)
        return image if turned else image.T

    def _choose(
        self, rows: "ProbedLines", columns: "ProbedLines"
    ) -> tuple["ProbedLines", "ProbedLines"]:
        """Choose the lines of which a single part changes a cell or a crossing most.

        The first rows are those in which any column of cells changes most, and the first columns
        those in which any row of cells does. Then come the rows that change most where they cross
        the first columns, and the columns that do where they cross the first rows.
        """
        first = (
            _largest(self._changes_along(rows, self._texture)),
            _largest(self._changes_along(columns, self._texture.T)),
        )
        errors = (
            self._errors(rows, columns.take(first[1]), 1).max(axis=1),
            self._errors(rows.take(first[0]), columns, 1).max(axis=0),
        )
        chosen = (
            lines.take(np.union1d(some, _largest(error)))
            for lines, some, error in zip((rows, columns), first, errors, strict=True)
        )
        return next(chosen), next(chosen)

    def _changes_along(self, lines: "ProbedLines", cells: np.ndarray) -> np.ndarray:
        """Largest change of each line by a single part, over all cells of the other axis."""
        largest = np.zeros(lines.number)
        rule = Rule.with_ends(REFINED)
        for blur in self._blurs:
            change = lines.shares(np.array([0.5]), blur)
            for place, weight in zip(*rule, strict=True):
                change = change - weight * lines.shares(place[None], blur)
            for start in range(0, lines.number, LINES):
                some = slice(start, start + LINES)
                here = np.abs(change[some] @ cells).max(axis=1)
                largest[some] = np.maximum(largest[some], here)
        return largest


class Rule(NamedTuple):
    """Places in a spread, from 0 to 1, and their weights in an integral over it."""

    places: np.ndarray
    weights: np.ndarray

    @classmethod
    def of_middles(cls, parts: int) -> "Rule":
        """Give the middles of equal parts."""
        return cls((np.arange(parts) + 0.5) / parts, np.full(parts, 1 / parts))

    @classmethod
    def with_ends(cls, parts: int) -> "Rule":
        """Give the ends of equal parts: light that only an end of the spread sends is counted."""
        weights = np.full(parts + 1, 1 / parts)
        weights[[0, -1]] /= 2
        return cls(np.arange(parts + 1) / parts, weights)

    def chunks(self) -> Iterator["Rule"]:
        """Split into a few places at a time, to limit memory."""
        for start in range(0, len(self.places), CHUNK):
            some = slice(start, start + CHUNK)
            yield Rule(self.places[some], self.weights[some])


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
    def of(cls, camera: PlenopticCamera, layer: Layer, axis: int, band: bool) -> "ProbedLines":
        """All lines along an axis, by the place where they see a layer.

        Parameters
        ----------
        camera : PlenopticCamera
        layer : Layer
        axis : int
            0 for rows, 1 for columns.
        band : bool
            Whether the spread is the band of light; otherwise it is the layer's thickness.
        """
        shift, ends = camera.chromatic_shift if band else 0.0, []
        for side in (-0.5, 0.5):
            focal_mm = camera.main_lens_focal_mm * (1 + shift * side)
            depth_mm = layer.depth_mm + layer.thickness_mm * side * (not band)
            ends.append(trace_footprint(camera, depth_mm, axis, focal_mm))
        centres = np.array([end.centres_mm.ravel() for end in ends])
        return cls(
            layer.cell_edges_mm(axis),
            centres[:, np.argsort(centres.sum(axis=0), kind="stable")],
            np.array([end.lenslet_width_mm for end in ends]),
            np.array([end.pixel_width_mm for end in ends]),
            shift,
        )

    @property
    def number(self) -> int:
        """Number of lines."""
        return self.centres_mm.shape[1]

    def take(self, chosen: np.ndarray) -> "ProbedLines":
        """Take some lines, by index."""
        return self._replace(centres_mm=self.centres_mm[:, chosen])

    def shares(self, places: np.ndarray, blur: bool, apart: bool = False) -> sparse.csr_array:
        """Fraction of each line's light from each cell.

        The first arguments are those of `bands`; `apart` gives each place cells of its own.

        Returns
        -------
        csr_array, shape (places * lines, cells) or (places * lines, places * cells)
        """
        start, weights = self.bands(places, blur)
        cells, width = self.edges_mm.size - 1, weights.shape[2]
        if apart:
            start = start + cells * np.arange(len(places))[:, None]
        seen = start[..., None] + np.arange(width)
        ends = np.arange(start.size + 1) * width
        size = start.size, cells * (len(places) if apart else 1)
        return sparse.csr_array((weights.ravel(), seen.ravel(), ends), size)

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


def _largest(changes: np.ndarray) -> np.ndarray:
    """Choose the lines of the largest changes, half as many as are measured."""
    return np.sort(np.argsort(changes, kind="stable")[-PROBES // 2 :])
