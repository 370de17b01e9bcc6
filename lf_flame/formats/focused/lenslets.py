"""Lenslets of a focused plenoptic camera: positions of the micro-images, and kinds of lenslets.

In a focused camera each lenslet images a part of the picture that the main lens forms, so that
neighbouring micro-images show the same detail, displaced. At the virtual depth v, the distance of
that picture from the lenslets over their distance from the sensor, the place Y of the picture is
seen in the micro-image centred at m at the offset ``d = (Y - m) / v`` (Perwass and Wietzke 2012).
A negative v is a picture in front of the lenslets. All are in pixels of the raw picture, and the
centres m are those of micro-images, which lie a little wider apart than the lenslets: v is larger
by the same ratio as in a camera with its main lens at infinity.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from lf_flame.errors import InputError
from lf_flame.formats.raw.lenslet_grid import LensletGrid

KINDS = 3
"""Number of kinds of lenslets in a hexagonal array of different focal lengths."""

SMALLEST_PITCH = 8.0
"""Smallest pitch in pixels; a smaller micro-image shows no detail that could be matched."""


class Lattice(NamedTuple):
    """Numbers of a grid, for compiled loops."""

    y0: float
    x0: float
    pitch: float
    row_pitch: float
    offset: float
    """Offset of odd rows, in pitches."""
    cos: float
    sin: float


class Array(NamedTuple):
    """Lenslets around a picture, by row and column of the array."""

    rows: np.ndarray
    columns: np.ndarray
    centres: np.ndarray
    """Centres ``(y, x)`` of the micro-images, shape (rows, columns, 2)."""
    whole: np.ndarray
    """Whether each micro-image lies whole in the picture, shape (rows, columns)."""


@dataclass(frozen=True)
class FocusedLenslets:
    """Lenslets of a focused plenoptic camera.

    Parameters
    ----------
    grid : LensletGrid
        Positions of the micro-images.
    border : float, optional
        Width of the rim of a micro-image that is not used, in pixels.
    ranges : tuple of (float, float), optional
        Ranges of virtual depth in which the lenslets of each of the three kinds are in focus. The
        lenslet in row i and column j of the array is of the kind ``(j - i % 2) % 3``. Default: all
        lenslets are alike.

    Raises
    ------
    InputError
        If a value is out of range; the message names it.

    Examples
    --------
    >>> from lf_flame.formats import FocusedLenslets, LensletGrid
    >>> grid = LensletGrid(50.0, 50.0, 24.0, layout="hexagonal")
    >>> lenslets = FocusedLenslets(grid, ranges=((1, 3), (2.8, 4), (3.8, 100)))
    >>> lenslets.radius
    11.0
    """

    grid: LensletGrid
    border: float = 1.0
    ranges: tuple[tuple[float, float], ...] = ()

    def __post_init__(self):
        side = min(self.grid.window)
        if not side >= SMALLEST_PITCH:
            raise InputError(
                f"The micro-images of focused lenslets must be at least {SMALLEST_PITCH:g} pixels "
                f"wide, got {side:.4g}."
            )
        if not 0 <= self.border <= side / 4:
            raise InputError(
                f"border must be from 0 to a quarter of the {side:.4g} pixels of a micro-image, "
                f"got {self.border}."
            )
        if self.ranges and (self.grid.layout != "hexagonal" or len(self.ranges) != KINDS):
            raise InputError(
                f"ranges must be those of the {KINDS} kinds of lenslets of a hexagonal array, got "
                f"{len(self.ranges)} in a {self.grid.layout} array."
            )
        for low, high in self.ranges:
            if not 0 < low < high:
                raise InputError(
                    f"A range of virtual depth must rise from above 0, got {low} to {high}."
                )

    @property
    def radius(self) -> float:
        """Radius in pixels of the part of a micro-image that is used."""
        return min(self.grid.window) / 2 - self.border

    @property
    def lattice(self) -> Lattice:
        """Numbers of the grid, for compiled loops."""
        grid = self.grid
        offset = 0.5 if grid.layout == "hexagonal" else 0.0
        turn = np.cos(grid.rotation), np.sin(grid.rotation)
        return Lattice(grid.y0, grid.x0, grid.pitch, grid.row_pitch, offset, *map(float, turn))

    def array(self, shape: tuple[int, ...]) -> Array:
        """Lenslets around a picture.

        Raises
        ------
        InputError
            If fewer than 3 x 3 micro-images lie whole in it.
        """
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
        return Array(rows, columns, centres, whole)

    def kinds(self, array: Array) -> np.ndarray:
        """Find each lenslet's kind, 0 to 2, shape (rows, columns); 0 in a rectangular array."""
        if self.grid.layout != "hexagonal":
            return np.zeros(array.whole.shape, np.int64)
        return (array.columns - array.rows[:, None] % 2) % KINDS

    def in_focus(self, array: Array, depth: np.ndarray) -> np.ndarray:
        """Whether each lenslet is in focus at its virtual depth: bool, shape (rows, columns)."""
        if not self.ranges:
            return np.ones(array.whole.shape, bool)
        low, high = np.moveaxis(np.array(self.ranges)[self.kinds(array)], 2, 0)
        return (low <= depth) & (depth <= high)

    def describe(self) -> str:
        """One line that describes the lenslets."""
        kinds = ", ".join(f"{low:.3g} to {high:.3g}" for low, high in self.ranges)
        return f"focused lenslets: {self.grid.describe()}" + (
            f", three kinds in focus at virtual depths of {kinds}" if kinds else ""
        )
