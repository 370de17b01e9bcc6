"""Resampling of the pixels under lenslets into equal parts of each micro-image."""

import math
from itertools import product
from typing import NamedTuple

import numpy as np

from lf_flame._common.arrays import centred
from lf_flame.errors import InputError
from lf_flame.formats.raw._decode_kernels import MARGIN, filter_columns, filter_rows, resample
from lf_flame.formats.raw.bayer import Lattice, lattices
from lf_flame.formats.raw.lenslet_grid import LensletGrid

STEPS = 256
"""Number of steps per pixel in a table of weights; linear interpolation errs by 4e-6."""


MOVE = 1 / 128
"""Distance in pixels over which weights change linearly with it; they err by 2e-5."""

NARROW = 1e-3
"""Breadth of a box, in pixels, below which averaging over it changes nothing."""


class Weights(NamedTuple):
    """Weights of the coefficients beside a position."""

    values: np.ndarray
    """Table of float32, shape (fractions, taps)."""
    start: float
    """Distance of the first coefficient: the largest whole number up to a position plus this."""
    steps: int
    """Number of fractions per pixel."""


class Array(NamedTuple):
    """The lenslets, in pixels of a lattice."""

    rows: np.ndarray
    columns: np.ndarray
    pitch: float
    row_pitch: float
    offset: float
    """Offset of odd rows, in pitches."""
    cos: float
    sin: float
    part_down: np.ndarray
    """Centres of the parts of a micro-image, from its centre."""
    part_along: np.ndarray
    lines: int
    """Number of pixel rows that the parts of a micro-image need."""
    block: int
    """Number of parts along that a rotated array moves down by less than `MOVE`."""
    together: int
    """Number of pixel rows over which it moves a column by less than `MOVE`."""
    slack: float


class Places(NamedTuple):
    """Lattices of pixels of one colour, each with the padded position of lenslet (0, 0)."""

    left: np.ndarray
    top: np.ndarray
    channel: np.ndarray
    share: np.ndarray
    """Share of a lattice in its channel."""


class Joined(NamedTuple):
    """Linear interpolation along the rows of a hexagonal array, (parity of the row, column)."""

    left: np.ndarray
    share: np.ndarray


NOT_JOINED = Joined(np.empty((0, 0), np.int64), np.empty((0, 0), np.float32))
"""In place of the interpolation, where there is none."""


class Resampling:
    """Resampling of images of one shape into the parts of their micro-images.

    Parameters
    ----------
    grid : LensletGrid
    shape : (int, int) or (int, int, int)
        Shape of the images.
    views : int
        Number of parts along each axis of a micro-image.
    bayer : str or None
        Pattern of a mosaic.

    Raises
    ------
    InputError
        If no micro-image lies whole in the image.
    """

    def __init__(self, grid: LensletGrid, shape: tuple[int, ...], views: int, bayer: str | None):
        self.grid, self.views, self.bayer = grid, views, bayer
        self.step = 1 if bayer is None else 2
        rows, columns = grid.block(shape)
        self._array, self._across, self._along = _geometry(grid, views, self.step, rows, columns)
        self._joined = _joined(grid, len(columns)) if grid.layout == "hexagonal" else None

    def __call__(
        self,
        image: np.ndarray,
        black: np.ndarray | None,
        gain: np.ndarray | None = None,
        *,
        square: bool = True,
    ) -> np.ndarray:
        """Resample an image, (rows, columns, channels), less its black level.

        Parameters
        ----------
        gain : ndarray of float32, shape (v, u, row, column, channel), optional
            Factor of each part.
        square : bool, optional
            Whether a hexagonal array is resampled to a square one.

        Returns
        -------
        ndarray of float32, shape (v, u, row, column, channel)
        """
        if black is not None and black.shape[2] > image.shape[2]:
            image = np.repeat(image, black.shape[2], axis=2)
        colours = lattices(self.bayer, image.shape)
        coefficients = self._coefficients(image, black, colours)
        places = Places(
            left=np.array([(self.grid.x0 - one.left) / self.step + MARGIN for one in colours]),
            top=np.array([(self.grid.y0 - one.top) / self.step + MARGIN for one in colours]),
            channel=np.array([one.channel for one in colours]),
            share=np.array([one.share for one in colours], np.float32),
        )
        joined = self._joined if square else None
        columns = self._array.columns.size if joined is None else joined.left.shape[1]
        channels = image.shape[2] if self.bayer is None else 3
        shape = self.views, self.views, self._array.rows.size, columns, channels
        out = np.empty(shape, np.float32)
        # One type for all cases, for which the loops are compiled once.
        if gain is None:
            gain = np.empty((0,) * 5, np.float32)
        else:
            gain = np.ascontiguousarray(np.broadcast_to(gain, (*gain.shape[:4], channels))).view()
        gain.flags.writeable = False
        across, along = self._across, self._along
        taps, taps_down = ((0,) * one.values.shape[1] for one in (along, across))
        resample(
            coefficients, places, self._array, across, along, taps, taps_down, gain,
            NOT_JOINED if joined is None else joined, out,
        )  # fmt: skip
        return out

    def joined(self, flags: np.ndarray) -> np.ndarray:
        """Combine flags of parts, (v, u, row, column), that a lenslet of the views is read from."""
        if self._joined is None:
            return flags
        out = np.empty((*flags.shape[:3], self._joined.left.shape[1]), bool)
        for r, row in enumerate(self._array.rows):
            left, share = self._joined.left[row % 2], self._joined.share[row % 2]
            line = flags[:, :, r]
            out[:, :, r] = (line[..., left] | (share == 1)) & (line[..., left + 1] | (share == 0))
        return out

    def _coefficients(
        self, image: np.ndarray, black: np.ndarray | None, colours: list[Lattice]
    ) -> np.ndarray:
        """Spline coefficients of the pixels of each lattice; of a mosaic, the pixels themselves."""
        height, width = (n // self.step for n in image.shape[:2])
        padded = len(colours), height + 2 * MARGIN, width + 2 * MARGIN
        coefficients = np.empty(padded, np.float32)
        flat = image.reshape(image.shape[0], -1)
        if black is not None:
            black = np.ascontiguousarray(np.broadcast_to(black, image.shape)).reshape(flat.shape)
        steps, filtered = (self.step, self.step * image.shape[2]), self.step == 1
        for one, out in zip(colours, coefficients, strict=True):
            first = one.top, one.left * image.shape[2] + one.source
            filter_rows(flat, black, first, steps, filtered, out)
            if filtered:
                filter_columns(out)
        return coefficients


def _geometry(
    grid: LensletGrid, views: int, step: int, rows: np.ndarray, columns: np.ndarray
) -> tuple[Array, Weights, Weights]:
    """Lenslets in pixels of a lattice, and the weights across and along their rows.

    Resampling runs along the pixel rows first and down after: a part is as wide as its distance to
    the next along a pixel row, and as high as that along a pixel column.
    """
    cos, sin = math.cos(grid.rotation), math.sin(grid.rotation)
    height, width = (side / views for side in grid.window)
    across = _weights(height * cos, step, 1 + 2 * MOVE)
    array = Array(
        rows=rows,
        columns=columns,
        pitch=grid.pitch / step,
        row_pitch=grid.row_pitch / step,
        offset=0.5 if grid.layout == "hexagonal" else 0.0,
        cos=cos,
        sin=sin,
        part_down=height * centred(views) / step,
        part_along=width * centred(views) / step,
        lines=int(cos * height * (views - 1) / step) + across.values.shape[1],
        block=1 + int(MOVE / max(abs(sin) * width / step, MOVE / views)),
        together=1 + int(MOVE / max(abs(sin / cos), MOVE / MARGIN**2)),
        slack=MOVE,
    )
    return array, across, _weights(width / cos, step)


def _weights(part: float, step: int, beyond: float = 0.0) -> Weights:
    """Tabulate the kernel for positions up to 1 + `beyond` pixels after the first coefficient's.

    On the full lattice, the parabolic B-spline is averaged over the part. Pixels two apart, which
    are interpolated linearly, are already averaged over one pixel of the part.
    """
    boxes = [1.0, 1.0, 1.0, part] if step == 1 else [1.0, 1.0, max(part - 1, 0.0) / step]
    boxes = [box for box in boxes if box > NARROW]
    reach = sum(boxes) / 2
    fractions = np.arange(int((1 + beyond) * STEPS) + 2) / STEPS
    taps = math.ceil(2 * reach + beyond)
    values = _kernel(fractions[:, None] + reach - 1 - np.arange(taps), boxes)
    return Weights(values.astype(np.float32), 1 - reach, STEPS)


def _kernel(distance: np.ndarray, boxes: list[float]) -> np.ndarray:
    """Boxes of these breadths, convolved: B-splines, averaged (de Boor 2001, chapter 9)."""
    powers = np.zeros(distance.shape)
    for signs in product((-1, 1), repeat=len(boxes)):
        knot = np.dot(signs, boxes) / 2
        powers += np.prod(signs) * np.maximum(distance + knot, 0.0) ** (len(boxes) - 1)
    return powers / math.factorial(len(boxes) - 1) / np.prod(boxes)


def _joined(grid: LensletGrid, columns: int) -> Joined:
    """Interpolate a hexagonal array to a square grid that both kinds of rows share."""
    spacing = grid.row_pitch / grid.pitch
    count = int((columns - 1.5) / spacing) + 1 if columns > 1 else 0
    if count < 1:
        raise InputError(
            f"A hexagonal array needs at least two whole lenslets along a row, got {columns}."
        )
    place = 0.5 + spacing * np.arange(count) - np.array([[0.0], [0.5]])  # in pitches along the row
    left = np.minimum(place.astype(int), columns - 2)
    return Joined(left, (place - left).astype(np.float32))
