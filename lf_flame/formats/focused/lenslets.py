"""Lenslets of a focused plenoptic camera: positions of the micro-images, and kinds of lenslets.

In a focused camera each lenslet images a part of the picture that the main lens forms, so that
neighbouring micro-images show the same detail, displaced. At the virtual depth v, the distance of
that picture from the lenslets over their distance from the sensor, the place Y of the picture is
seen in the micro-image centred at m at the offset ``d = (Y - m) / v`` (Perwass and Wietzke 2012).
A negative v is a picture in front of the lenslets. All are in pixels of the raw picture, and the
centres m are those of micro-images, which lie a little wider apart than the lenslets: v is larger
by the same ratio as in a camera with its main lens at infinity.
"""

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np

from lf_flame._common.input_files import read_text
from lf_flame.errors import InputError
from lf_flame.formats.raw.lenslet_grid import LensletGrid

SIXTH = math.pi / 3
"""Angle by which a hexagonal array can be turned without a change."""


class Array(NamedTuple):
    """Lenslets around a picture, by row and column of the array.

    `centres`, shape (rows, columns, 2), are the places ``(y, x)`` of the micro-images; `whole` says
    which lie whole in the picture, and `kinds` which focal length they have, 0 to 2, each of shape
    (rows, columns). In a rectangular array all are of kind 0.
    """

    rows: np.ndarray
    columns: np.ndarray
    centres: np.ndarray
    whole: np.ndarray
    kinds: np.ndarray


@dataclass(frozen=True)
class FocusedLenslets:
    """Grid of micro-images, width in pixels of their unused rim, and ranges of virtual depth.

    The ranges are those in which the lenslets of each of three kinds are in focus; the lenslet in
    row i and column j is of the kind ``(j - i % 2) % 3``. Without ranges all lenslets are alike.
    """

    grid: LensletGrid
    border: float = 1.0
    ranges: tuple[tuple[float, float], ...] = ()

    def __post_init__(self):
        if self.grid.columns:  # a hexagonal array, whose rows are 30 degrees off
            turn = math.remainder(math.pi / 2 - self.grid.rotation, SIXTH)
            grid = replace(self.grid, rotation=turn, columns=False)
            object.__setattr__(self, "grid", grid)
        side = min(self.grid.window)
        if not side >= 8:
            raise InputError(
                f"The micro-images of focused lenslets must be at least 8 pixels wide, got "
                f"{side:.4g}."
            )
        if not 0 <= self.border <= side / 4:
            raise InputError(
                f"border must be from 0 to a quarter of the {side:.4g} pixels of a micro-image, "
                f"got {self.border}."
            )

    @property
    def radius(self) -> float:
        """Radius in pixels of the part of a micro-image that is used."""
        return min(self.grid.window) / 2 - self.border

    def array(self, shape: tuple[int, ...]) -> Array:
        """Lenslets around a picture; refused if fewer than 3 x 3 lie whole in it."""
        rows, columns = self.grid.indices(shape)
        centres = np.stack(self.grid.position(rows[:, None], columns), axis=-1)
        reach = self.radius + 1
        inside = (centres >= reach) & (centres <= np.array(shape[:2]) - 1 - reach)
        whole = np.logical_and.reduce(inside, axis=2)
        if min(len(np.unique(found)) for found in np.nonzero(whole)) < 3:
            raise InputError(
                f"Fewer than 3 x 3 micro-images of {self.grid.pitch:.4g} pixels lie whole in the "
                f"picture of {shape[0]} x {shape[1]}: the calibration does not fit it."
            )
        kinds = (columns - rows[:, None] % 2) % (3 if self.grid.layout == "hexagonal" else 1)
        return Array(rows, columns, centres, whole, kinds)

    def in_focus(self, array: Array, depth: np.ndarray) -> np.ndarray:
        """Whether each lenslet is in focus at its virtual depth: bool, shape (rows, columns)."""
        if not self.ranges:
            return np.ones(array.whole.shape, bool)
        low, high = np.moveaxis(np.array(self.ranges)[array.kinds], 2, 0)
        return (low <= depth) & (depth <= high)

    def describe(self) -> str:
        """One line that describes the lenslets."""
        kinds = ", ".join(f"{low:.3g} to {high:.3g}" for low, high in self.ranges)
        return f"focused lenslets: {self.grid.describe()}" + (
            f", three kinds in focus at virtual depths of {kinds}" if kinds else ""
        )


# Calibration files --------------------------------------------------------------------------------


def is_raytrix(path: str | Path) -> bool:
    """Whether a file is a calibration by its ending."""
    return Path(path).suffix.lower() == ".xml"


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
        raise InputError(f"{path} is no calibration of a Raytrix camera (RayCalibData).")
    try:
        grid = LensletGrid(
            (shape[1] - 1) / 2 + _number(root, "offset/x"),
            (shape[0] - 1) / 2 - _number(root, "offset/y"),
            _number(root, "diameter"),
            math.remainder(-_number(root, "rotation"), SIXTH),  # y runs down in a picture
            "hexagonal",
        )
        border = 1.0 if root.find("lens_border") is None else _number(root, "lens_border")
        return FocusedLenslets(grid, border, _ranges(root, grid))
    except InputError as error:
        raise InputError(f"{path} cannot be used: {error}") from None


def _ranges(root: ElementTree.Element, grid: LensletGrid) -> tuple[tuple[float, float], ...]:
    """Ranges of virtual depth of the kinds, in the order of `FocusedLenslets`."""
    found = {}
    for kind in root.findall("lens_type"):
        low, high = (_number(kind, f"depth_range/{end}") for end in ("min", "max"))
        if not 0 < low < high:
            raise InputError(
                f"a range of virtual depth must rise from above 0, got {low} to {high}."
            )
        right, up = (grid.pitch * _number(kind, f"offset/{axis}") for axis in "xy")
        found[_kind_at(grid, right, -up)] = (low, high)
    if len(found) not in (0, 3):
        raise InputError(
            f"it must state none or three kinds of lenslets (lens_type) at different offsets, got "
            f"{len(found)}."
        )
    return tuple(found[kind] for kind in sorted(found))


def _kind_at(grid: LensletGrid, right: float, down: float) -> int:
    """Kind of the lenslet nearest to a place, in pixels from that in row 0 and column 0."""
    row, column = (axis.ravel() for axis in np.mgrid[-4:5, -6:7])
    y, x = grid.position(row, column)
    nearest = np.hypot(y - grid.y0 - down, x - grid.x0 - right).argmin()
    return int(column[nearest] - row[nearest] % 2) % 3


def _number(element: ElementTree.Element, name: str) -> float:
    """Finite number of an element below another."""
    text = element.findtext(name)
    try:
        number = float(text or "nan")
    except ValueError:
        number = math.nan
    if not abs(number) <= 1e6:
        got = "nothing" if text is None else repr(text[:40])
        raise InputError(f"it must state {name} as a number, got {got}.")
    return number
