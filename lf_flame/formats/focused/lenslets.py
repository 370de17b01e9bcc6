"""Lenslets of a focused plenoptic camera: positions, kinds, and virtual depths.

In a focused camera each lenslet images a part of the picture that the main lens forms, so that
neighbouring micro-images show the same detail, displaced. At the virtual depth v, the distance of
that picture from the lenslets over their distance from the sensor, the point Y of the picture is
seen in the micro-image centred at m at the offset ``d = (Y - m) / v`` (Perwass and Wietzke 2012).
A negative v is a picture in front of the lenslets. All are in pixels of the raw picture, and the
centres m are those of micro-images, which lie wider apart than the lenslets by the factor 1 + g, g
being the ratio of the lenslets' distances from sensor and main lens: the v that is found is that of
the geometry times (1 + g) / (1 + g v), a few per cent less.
"""

import cmath
import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from scipy.spatial import cKDTree

from lf_flame._common.input_files import read_text
from lf_flame.errors import InputError
from lf_flame.formats.focused._kernels import match
from lf_flame.formats.raw.lenslet_grid import LensletGrid


@dataclass(frozen=True, eq=False)
class FocusedLenslets:
    """Grid of micro-images in pictures of a shape, their unused rim in pixels, ranges of depth.

    The ranges are those of virtual depth in which the lenslets of each of three kinds are in focus;
    the lenslet in row i and column j is of the kind ``(j - i % 2) % 3``. Without ranges all
    lenslets are taken to be in focus.
    """

    grid: LensletGrid
    shape: tuple[int, ...]
    border: float = 1.0
    ranges: tuple[tuple[float, float], ...] = ()

    def __post_init__(self):
        side, used = min(self.grid.window), 2 * self.radius
        if not 6 <= used <= side:
            raise InputError(
                f"The micro-images of focused lenslets must be at least 6 pixels wide within their "
                f"border, got {used:.4g} of {side:.4g}."
            )

    @property
    def radius(self) -> float:
        """Radius in pixels of the part of a micro-image that is used."""
        return min(self.grid.window) / 2 - self.border

    @cached_property
    def array(self) -> tuple[np.ndarray, np.ndarray]:
        """Centres ``(y, x)``, shape (n, 2), and kinds of the lenslets entirely in a picture.

        Kinds are 0 to 2, in a rectangular array all 0. Fewer than 3 x 3 lenslets are refused.
        """
        rows, columns = self.grid.indices(self.shape)
        centres = np.stack(self.grid.position(rows[:, None], columns), axis=-1)
        reach = self.radius + 1
        inside = (centres >= reach) & (centres <= np.array(self.shape[:2]) - 1 - reach)
        whole = inside.all(axis=2)
        if min(len(np.unique(found)) for found in np.nonzero(whole)) < 3:
            raise InputError(
                f"Fewer than 3 x 3 micro-images of {self.grid.pitch:.4g} pixels lie entirely in "
                f"the picture of {self.shape[0]} x {self.shape[1]}: the calibration does not fit."
            )
        kinds = (columns - rows[:, None] % 2) % (3 if self.grid.layout == "hexagonal" else 1)
        return centres[whole], kinds[whole]

    def in_focus(self, depth: np.ndarray) -> np.ndarray:
        """Whether each lenslet is in focus at its virtual depth: bool, shape (n,)."""
        if not self.ranges:
            return np.ones(depth.shape, bool)
        low, high = np.array(self.ranges)[self.array[1]].T
        return (low <= depth) & (depth <= high)

    def describe(self) -> str:
        """One line that describes the lenslets."""
        kinds = ", ".join(f"{low:.3g} to {high:.3g}" for low, high in self.ranges)
        return f"focused lenslets: {self.grid.describe()}" + (
            f", three kinds in focus at virtual depths of {kinds}" if kinds else ""
        )


# Virtual depth ------------------------------------------------------------------------------------


def find_virtual_depth(image: np.ndarray, lenslets: FocusedLenslets) -> np.ndarray:
    """Find the virtual depth of each lenslet, shape (n,), in a levelled picture.

    The similarity of a micro-image to its neighbours within 1.8 pitches is largest at an inverse
    depth, which neighbours within 3.1 pitches refine. A depth is NaN without texture (a similarity
    below 0.5), where several fit (another is less than 0.1 lower), or where fewer than two
    neighbours agree within 10 %: where texture is faint, single ones match by accident.
    """
    grey = np.ascontiguousarray(image.mean(axis=2, keepdims=True), np.float32)
    centres, pitch, near, far = lenslets.array[0], lenslets.grid.pitch, 1.8, 3.1
    step = 0.5 / (near * pitch)  # displaces the farthest neighbours by half a pixel
    count = int(np.ceil(0.55 / step))
    inverses = step * np.arange(-2 if lenslets.ranges else -count, count + 1)
    coarse = _similarity(grey, lenslets, near, np.zeros(len(centres)), inverses)
    best = coarse.argmax(axis=1)
    start = inverses[best]
    fine = np.arange(-8, 9) * step / 4
    found = start + _peak_places(_similarity(grey, lenslets, far, start, fine), fine)
    # Inverse depths as near as that belong to the same peak.
    apart = np.abs(inverses - start[:, None]) > max(0.07, 2 / pitch)
    similarity, other = coarse.max(axis=1), np.where(apart, coarse, 0).max(axis=1)
    known = (similarity >= 0.5) & (similarity - other >= 0.1)
    known &= (best > 0) & (best < inverses.size - 1)
    # Above 0.5 no point is seen entirely by two lenslets; below 2 pixels any two micro-images
    # match.
    known &= (np.abs(found) <= 0.52) & (np.abs(found) * pitch >= 2)
    found[~known] = np.nan
    pairs = cKDTree(centres).query_pairs(1.1 * pitch, output_type="ndarray")
    one, other = np.vstack([pairs, pairs[:, ::-1]]).T
    agree = np.abs(found[one] - found[other]) < 0.1 * np.abs(found[one])
    found[np.bincount(one[agree], minlength=found.size) < 2] = np.nan
    return 1 / found


def _similarity(grey, lenslets: FocusedLenslets, reach: float, start, steps) -> np.ndarray:
    """Similarity to the neighbours within a reach in pitches, at inverse depths around `start`."""
    (centres, kinds), radius = lenslets.array, lenslets.radius
    stride = max(1.0, radius / 7)  # between points that are compared
    half = int(radius / stride)
    spots = stride * np.mgrid[-half : half + 1, -half : half + 1].reshape(2, -1).T
    spots = np.ascontiguousarray(spots[np.hypot(*spots.T) <= radius])
    # A hexagonal array has 37 lenslets within 3.1 pitches, the first of which is the central one.
    reach *= lenslets.grid.pitch
    _, near = cKDTree(centres).query(centres, 40, distance_upper_bound=reach)
    near, out = np.ascontiguousarray(near[:, 1:]), np.zeros((len(centres), len(steps)))
    match(grey, centres, kinds, near, spots, radius, start, steps, out)
    return out


def _peak_places(similarity: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Positions of the largest similarity, by a parabola through the five values around it."""
    top = np.clip(similarity.argmax(axis=1), 2, len(steps) - 3)
    near = np.take_along_axis(similarity, top[:, None] + np.arange(-2, 3), axis=1)
    slope = near @ np.array([-2, -1, 0, 1, 2]) / 10
    bend = near @ np.array([2, -1, -2, -1, 2]) / 14
    shift = np.where(bend < 0, -slope / np.where(bend < 0, 2 * bend, 1), 0)
    return steps[top] + np.clip(shift, -2, 2) * (steps[1] - steps[0])


# Calibration files --------------------------------------------------------------------------------


def read_raytrix(path: str | Path, shape: tuple[int, ...]) -> FocusedLenslets:
    """Read the lenslets of a Raytrix camera, for pictures of a shape, from ``RayCalibData``.

    Facts of the format, from three files that the maker's program wrote: lengths are in pixels of
    the raw picture and in diameters of a lenslet; y runs up; the offset leads from the centre of
    the picture to a lenslet of the first kind; the rotation is counter-clockwise and complete, as
    ``lens_base_x`` repeats it only in whole steps. The main lens's distortion is not used.
    """
    text = read_text(path, 1 << 16)  # the maker's files have 1.7 kB
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise InputError(f"{path} cannot be read: it declares a document type or entities.")
    try:
        root = ElementTree.fromstring(text)  # noqa: S314 - of bounded size, without entities
    except ElementTree.ParseError as error:
        raise InputError(f"{path} cannot be read as XML: {error}.") from None
    if root.tag != "RayCalibData":
        raise InputError(f"{path} is not a calibration of a Raytrix camera (RayCalibData).")
    try:
        grid = LensletGrid(
            (shape[1] - 1) / 2 + _number(root, "offset/x"),
            (shape[0] - 1) / 2 - _number(root, "offset/y"),
            _number(root, "diameter"),
            # y runs down in a picture; sixths of a turn leave a hexagonal array as it is.
            math.remainder(-_number(root, "rotation"), math.pi / 3),
            "hexagonal",
        )
        border = 1.0 if root.find("lens_border") is None else _number(root, "lens_border")
        return FocusedLenslets(grid, shape, border, _ranges(root, grid))
    except InputError as error:
        raise InputError(f"{path} cannot be used: {error}") from None


def _ranges(root: ElementTree.Element, grid: LensletGrid) -> tuple[tuple[float, float], ...]:
    """Ranges of virtual depth of the kinds, in the order of `FocusedLenslets`."""
    found = {}
    for kind in root.findall("lens_type"):
        low, high = (_number(kind, f"depth_range/{end}") for end in ("min", "max"))
        if not 0 < low < high:
            raise InputError(
                f"a range of virtual depth must increase from above 0, got {low} to {high}."
            )
        right, up = (_number(kind, f"offset/{axis}") for axis in "xy")  # in pitches
        place = complex(right, -up) * cmath.exp(-1j * grid.rotation)
        row = round(place.imag / math.sqrt(0.75))
        found[(round(place.real - row % 2 / 2) - row % 2) % 3] = (low, high)
    if len(found) not in (0, 3):
        raise InputError(
            f"it must state no or three kinds of lenslets (lens_type) at different offsets, got "
            f"{len(found)}."
        )
    return tuple(found[kind] for kind in sorted(found))


def _number(element: ElementTree.Element, name: str) -> float:
    """Finite number of an element below another."""
    text = element.findtext(name, "nothing")
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not abs(number) <= 1e6:
        raise InputError(f"it must state {name} as a number, got {text[:40]!r}.")
    return number
