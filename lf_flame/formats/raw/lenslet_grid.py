"""The array of micro-images in a raw lenslet image.

Pixel centres are at integers; x runs right with the columns and y down with the rows. The
micro-image in row i and column j of the array is centred at
``(x0, y0) + R(rotation) (pitch (j + offset), row_pitch i)``. The offset is 1/2 in the odd rows of a
hexagonal array, else 0; a positive rotation takes the x axis towards the y axis. Where lenslets
form straight columns, all this applies to the transposed image.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from lf_flame._common.arrays import Number
from lf_flame.errors import InputError


@dataclass(frozen=True)
class LensletGrid:
    """Positions of the micro-images in a raw lenslet image.

    All fields are numbers or text: ``dataclasses.asdict`` gives JSON values.

    Parameters
    ----------
    x0, y0 : float
        Centre of the micro-image in row 0 and column 0, in pixels; it need not be the first one.
    pitch : float
        Distance between neighbouring micro-image centres along a row, in pixels.
    rotation : float, optional
        Angle in rad from the image's rows to the array's rows, x towards y, within pi/4.
    layout : {"rectangular", "hexagonal"}, optional
        Arrangement of the lenslets.
    row_pitch : float, optional
        Distance between neighbouring rows, in pixels. Default: the pitch, times sqrt(3)/2 in a
        hexagonal array.
    columns : bool, optional
        Whether the lenslets of a hexagonal array form straight columns: the array's rows run
        down the image, and a positive rotation takes the y axis towards the x axis.

    Raises
    ------
    InputError
        If a value is out of range; the message names it.

    Examples
    --------
    >>> from lf_flame.formats import LensletGrid
    >>> grid = LensletGrid(4.5, 4.5, 10.0)
    >>> grid.centres((60, 80)).shape
    (6, 8, 2)
    """

    x0: float
    y0: float
    pitch: float
    rotation: float = 0.0
    layout: str = "rectangular"
    row_pitch: float = None  # type: ignore[assignment]  # a number from the first moment on
    columns: bool = False

    def __post_init__(self):
        if self.layout not in ("rectangular", "hexagonal"):
            raise InputError(f"layout must be rectangular or hexagonal, got {self.layout!r}.")
        if self.row_pitch is None:
            rows = math.sqrt(3) / 2 if self.layout == "hexagonal" else 1.0
            object.__setattr__(self, "row_pitch", rows * self.pitch)
        for name in ("x0", "y0", "pitch", "rotation", "row_pitch"):
            object.__setattr__(self, name, float(getattr(self, name)))
        for name in ("pitch", "row_pitch"):
            if not 1 <= getattr(self, name) < math.inf:
                raise InputError(f"{name} must be at least 1 pixel, got {getattr(self, name)}.")
        if not abs(self.rotation) <= math.pi / 4:
            raise InputError(f"rotation must lie within pi/4 rad, got {self.rotation}.")
        if not math.isfinite(self.x0 + self.y0):
            raise InputError(f"The centre must be finite, got {self.x0}, {self.y0}.")

    def position(self, row: Number, column: Number) -> tuple[Number, Number]:
        """Centre ``(y, x)`` in pixels of the micro-image in a row and column of the array.

        Parameters
        ----------
        row, column : int or ndarray of int
        """
        if self.columns:
            x, y = self.upright.position(row, column)
            return y, x
        offset = row % 2 / 2 if self.layout == "hexagonal" else 0.0
        y, x = self.rotated(self.row_pitch * row, self.pitch * (column + offset))
        return self.y0 + y, self.x0 + x

    @property
    def upright(self) -> "LensletGrid":
        """Grid of rows: of the transposed image, if the lenslets form columns."""
        return replace(self, x0=self.y0, y0=self.x0, columns=False) if self.columns else self

    def rotated(self, down: Number, along: Number) -> tuple[Number, Number]:
        """Rotate a vector (across, along) the array's rows to ``(y, x)`` of the image."""
        cos, sin = math.cos(self.rotation), math.sin(self.rotation)
        return sin * along + cos * down, cos * along - sin * down

    @property
    def window(self) -> tuple[float, float]:
        """Height and width of a micro-image in pixels.

        In a hexagonal array it is the square around the round micro-image; its corners overlap
        the neighbours.
        """
        height = self.row_pitch if self.layout == "rectangular" else self.pitch
        return height, self.pitch

    def block(self, shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
        """Rows and columns of the largest block of whole micro-images in an image of this shape.

        Both are consecutive numbers.
        """
        if self.columns:
            return self.upright.block(shape[1::-1])
        rows, columns = self.indices(shape)
        y, x = self.position(rows[:, None], columns)
        height, width = self.window
        cos, sin = math.cos(self.rotation), abs(math.sin(self.rotation))
        half_y, half_x = (cos * height + sin * width) / 2, (cos * width + sin * height) / 2
        # The image ends half a pixel beyond its last ones, and half a pixel more may be missing.
        inside = (y - half_y >= -1) & (y + half_y <= shape[0])
        inside &= (x - half_x >= -1) & (x + half_x <= shape[1])
        first = np.where(inside.any(axis=1), inside.argmax(axis=1), len(columns))
        last = len(columns) - 1 - inside[:, ::-1].argmax(axis=1)
        top, bottom, left, right = _largest_block(first, last)
        if top == bottom:
            raise InputError(
                f"No micro-image of {height:.4g} x {width:.4g} pixels lies entirely in the image "
                f"of {shape[0]} x {shape[1]}."
            )
        return rows[top:bottom], columns[left:right]

    def centres(self, shape: tuple[int, ...]) -> np.ndarray:
        """Centres ``(y, x)`` of the whole micro-images, shape (rows, columns, 2), float64."""
        rows, columns = self.block(shape)
        return np.stack(self.position(rows[:, None], columns), axis=-1)

    def describe(self) -> str:
        """One line that describes the array: layout, pitches, rotation."""
        lines = "columns" if self.columns else "rows"
        stand = " in straight columns" if self.columns else ""
        return (
            f"{self.layout} lenslets{stand}, pitch {self.pitch:.3f} pixels along {lines} and "
            f"{self.row_pitch:.3f} between them, rotated by {self.rotation:+.5f} rad"
        )

    def indices(self, shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
        """Rows and columns of the array that may be in the image, and a few more."""
        if self.columns:
            return self.upright.indices(shape[1::-1])
        y, x = np.meshgrid([0.0, shape[0]], [0.0, shape[1]])
        back = replace(self, rotation=-self.rotation)
        down, along = back.rotated(y - self.y0, x - self.x0)
        rows, columns = (
            np.arange(math.floor(i.min()) - 1, math.ceil(i.max()) + 2)
            for i in (down / self.row_pitch, along / self.pitch)
        )
        return rows, columns


def _largest_block(first: np.ndarray, last: np.ndarray) -> tuple[int, int, int, int]:
    """Largest block (top, bottom, left, right) of rows that are filled from first to last."""
    largest, block = 0, (0, 0, 0, 0)
    for top in range(len(first)):
        left = np.maximum.accumulate(first[top:])
        width = np.minimum.accumulate(last[top:]) + 1 - left
        area = np.maximum(width, 0) * np.arange(1, len(width) + 1)
        k = int(area.argmax())
        if area[k] > largest:
            largest, block = area[k], (top, top + k + 1, int(left[k]), int(left[k] + width[k]))
    return block


def grid_from_pitch(
    shape: tuple[int, ...], pitch: float, layout: str = "rectangular"
) -> LensletGrid:
    """Grid of an upright array that is centred in the image, with as many lenslets as fit.

    Parameters
    ----------
    shape : (int, int)
        Number of rows and columns of the image; further entries are ignored.
    pitch : float
        Distance between neighbouring micro-image centres along a row, in pixels.
    layout : {"rectangular", "hexagonal"}, optional

    Raises
    ------
    InputError
        If a value is out of range.

    Examples
    --------
    >>> from lf_flame.formats import grid_from_pitch
    >>> grid_from_pitch((60, 80), 10.0).centres((60, 80)).shape
    (6, 8, 2)
    """
    grid = LensletGrid(0.0, 0.0, pitch, layout=layout)
    height, width = grid.window
    half = 0.5 if layout == "hexagonal" else 0.0
    # Slightly more, so that rounding does not cost a row where micro-images tile the image.
    rows = max(math.floor((shape[0] - height) / grid.row_pitch + 1 + 1e-6), 1)
    columns = max(math.floor((shape[1] - width) / pitch + 1 - half + 1e-6), 1)
    up, left = (rows - 1) / 2 * grid.row_pitch, (columns - 1 + half) / 2 * pitch
    return replace(grid, y0=(shape[0] - 1) / 2 - up, x0=(shape[1] - 1) / 2 - left)
