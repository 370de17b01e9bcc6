"""The plan by which raw lenslet images of one camera are resampled into views.

It is made once for a grid, a white and a dark image, and then decodes any number of frames.
Micro-image pixels stay in sensor order, not flipped (`lf_flame.lightfield`). The rows and columns
of views follow the array, so that a rotation of the array against the sensor is removed.
"""

from __future__ import annotations

import logging
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage

from lf_flame._common.arrays import centred
from lf_flame.errors import InputError
from lf_flame.formats.raw import sensor_images as sensor
from lf_flame.formats.raw._decode_kernels import resample
from lf_flame.formats.raw.lenslet_grid import LensletGrid
from lf_flame.lightfield import LightField

LOGGER = logging.getLogger(__name__)

TOUCHED = 0.02
"""Share of saturated or dead pixels of the sensor in a pixel of a view from which it is unknown."""

LEAST_LIT = 0.5
"""Smallest brightness, relative to its micro-image's centre, of what counts as lit. A darker pixel
is partly outside the image of the aperture, so that its light comes from its inner part."""

LEAST_LEVEL = 0.05
"""Smallest brightness of a micro-image, relative to the median, that is trusted."""

NONE = np.empty((0, 0, 0), np.float32)
"""In place of a black level or a white image, where there is none."""


class Lattices(NamedTuple):
    """Pixels of each colour.

    All pixels of a channel; in a mosaic, those of red and of blue, which are two apart, and all for
    green, of which every other one is green.
    """

    step: np.ndarray
    top: np.ndarray
    left: np.ndarray
    source: np.ndarray
    """Index in the image's last axis."""
    channel: np.ndarray
    """Channel of the light field."""
    green: np.ndarray
    """For green of a mosaic, whether its pixels have even (0) or odd (1) sums of row and column."""
    y: np.ndarray
    """Place of the lenslet in row and column 0, in pixels of the lattice."""
    x: np.ndarray


class Array(NamedTuple):
    """The lenslets, in pixels of a lattice."""

    first_row: int
    first_column: int
    columns: int
    """Number of lenslets along a row."""
    pitch: float
    row_pitch: float
    offset: float
    """Offset of odd rows, in pitches."""
    cos: float
    sin: float
    part_down: float
    """Height of the parts of a micro-image, down a column of pixels."""
    part_along: float
    """Width of them along a row of pixels."""
    half_down: float
    """Largest distance of own pixels from the centre, across and along the array's rows."""
    half_along: float
    radius: float
    """Largest distance of own pixels of a round micro-image; 0 if it is square."""
    high: float
    """Half the height of the own pixels."""
    wide: float
    """Half the width of the pixels that parts cover."""
    margin: int
    """Number of lines that parts cover beyond the own pixels, above or below."""
    reach: int
    """Number of lines over which light goes on linearly there; corners of round micro-images, which
    no view that counts shows, are farther."""
    shear: float
    """Displacement of parts down a column of pixels, for each pixel along."""
    fewest: int
    """Smallest number of own pixels of a line that is read."""


class Join(NamedTuple):
    """Linear interpolation along the rows of lenslets, (parity of the row, column)."""

    left: np.ndarray
    share: np.ndarray


class DecodePlan:
    """Plan for decoding the raw images of one camera.

    A micro-image is divided into views x views equal parts, so that a slope does not depend on how
    many pixels it has. A view's pixel is the mean radiance of its part. It is found from the
    lenslet's own pixels alone: those that lie whole in its micro-image, which is round in a
    hexagonal array, and are lit in the white image. Beyond them light goes on linearly. So a
    part's light comes from its centre also at the rim of round micro-images that
    touch, and none comes from a neighbour. Between pixels the light is a cubic's, which conserves
    it (Colella and Woodward 1984) and reproduces the pixels where parts coincide with them. Parts
    of a rotated array have their true centres; their edges stay parallel to the sensor's, right
    to first order in the rotation.

    The pixels of each colour of a Bayer mosaic are used by themselves, without a demosaic: no
    light moves between colours, and none farther than two pixels.

    A hexagonal array is resampled to a square grid with the distance of its rows: the rows stay,
    and along each row linear interpolation removes the offset of every other row and changes the
    column distance from the pitch to the row distance. Slopes of the result are in row distances
    per view: 2 / sqrt(3) times those in pitches per view. An array in straight columns is decoded
    in the same way with rows and columns exchanged.

    A hot pixel, which is far brighter in the dark image than all around it, is replaced by its
    neighbours of the same colour. A pixel of a view is unknown (`LightField.valid`) if more than
    2 % of it comes from saturated pixels; or, in the views that count, if it is too dark in the
    white image, or bad pixels change its light there by 2 % (it then holds 0).

    Views that are mostly dark in the white image get weight 0, and in a hexagonal array those
    whose parts reach beyond the circle that touches the neighbours.

    Parameters
    ----------
    grid : LensletGrid
        Positions of the micro-images, from `estimate_grid` or `grid_from_pitch`.
    shape : (int, int) or (int, int, int)
        Shape of the raw images: rows, columns and, for colour, channels.
    views : int, optional
        Number of views along each axis. Default: the largest odd number not above the rounded
        pitch.
    white : array_like, shape as raw, or without channels; optional
        White image (flat field), by which the pixels are divided, relative to the median of its
        central view (in each channel or colour): views keep the unit and the colour of the raw
        image. For reflectance, divide them by the views of the white image, decoded alike. Pixels
        darker than half the centre of their micro-image are not used. Default: no division.
    dark : array_like, shape as raw, or without channels; optional
        Image without light, in the same units. It is subtracted from both raw and white image,
        because each contains the sensor's black level. Default: black is 0.
    bayer : {"rggb", "bggr", "grbg", "gbrg"}, optional
        Colours of the upper left 2 x 2 pixels of a mosaic, row by row. Default: no mosaic. The
        white image tells which two are green, not which one is red.
    saturation : float, optional
        Level of the raw images from which a pixel is saturated. Default: the largest level of 8,
        10, 12, 14 or 16 bits, if at least ten pixels have it.

    Attributes
    ----------
    weights : ndarray of bool, shape (views, views)
        Whether each view counts.

    Raises
    ------
    InputError
        If an argument cannot be used, no micro-image lies whole in the image, or the white image
        is a calibration with a closed aperture.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame.formats import DecodePlan, grid_from_pitch
    >>> frames = np.random.default_rng(1).uniform(size=(3, 60, 80))
    >>> plan = DecodePlan(grid_from_pitch((60, 80), 10.0), shape=(60, 80))
    >>> [plan.decode(frame).shape for frame in frames]
    [(9, 9, 6, 8), (9, 9, 6, 8), (9, 9, 6, 8)]
    """

    def __init__(
        self,
        grid: LensletGrid,
        *,
        shape: tuple[int, ...],
        views: int | None = None,
        white: ArrayLike | None = None,
        dark: ArrayLike | None = None,
        bayer: str | None = None,
        saturation: float | None = None,
    ):
        if len(shape) not in (2, 3):
            raise InputError(
                f"shape must be that of raw images, (rows, columns[, channels]), got {shape}."
            )
        self.grid, self.shape = grid, tuple(shape)
        self.bayer = None if bayer is None else sensor.check_bayer(bayer, self.shape)
        self.views = views = _count_views(grid, views)
        # All else is of rows: the images of an array in columns are transposed, and so the views.
        self._grid = grid.upright
        pattern = self.bayer
        if pattern is not None and grid.columns:
            pattern = pattern[0] + pattern[2] + pattern[1] + pattern[3]
        self._step = 1 if pattern is None else 2
        channels = self.shape[2] if len(self.shape) == 3 else 1
        self._lattices = _lattices(self._grid, pattern, channels)
        size = self.shape[1::-1] if grid.columns else self.shape[:2]
        rows, columns = self._grid.block(size)
        self._arrays = tuple(_array(self._grid, views, n, rows, columns) for n in (1, 2))
        self._rows, self._join = len(rows), _join(self._grid, len(columns))
        self._saturation, self._is_new = saturation, True
        self._notes: list[str] = []
        self._black, light = (
            None if one is None else self._upright(sensor.fitting(one, name, self.shape))
            for one, name in ((dark, "dark"), (white, "white"))
        )
        self._hot = None
        if self._black is not None:
            self._black = self._black.astype(np.float32)
            self._hot = sensor.find_hot_pixels(self._black, self._step)
            self._black = self._mended(self._black)
        self._gain: np.ndarray | None = None
        self._micro_images: np.ndarray | None = None
        self._valid: np.ndarray | None = None
        self._lit, self._bright = np.ones((views, views), bool), 0.0
        if light is not None:
            self._use_white(light, pattern)
        self.weights = _own_views(self._grid, views) & self._lit
        self._valid = self._known(self._valid)

    def decode(self, raw: ArrayLike) -> LightField:
        """Decode one raw image.

        Parameters
        ----------
        raw : array_like, shape as planned
            Image, linear in radiance, of any real type.

        Returns
        -------
        LightField
            Views of the largest block of whole micro-images, with the weights of views, and which
            of their pixels are known.

        Raises
        ------
        InputError
            If the image has another shape, is not finite, or, being the first, shows the 2 x 2
            pattern of a mosaic that is not stated, or does not fit the white or the dark image.
        """
        image = sensor.as_image(raw, "raw")
        if image.shape != (*self.shape, 1)[:3]:
            raise InputError(
                f"A raw image must have the plan's shape {self.shape}, got {np.shape(raw)}."
            )
        image = self._upright(image)
        saturated = sensor.find_saturated(image, self._saturation)
        if self._is_new:
            self._check(image, saturated)
        views = self._resample(self._mended(image), self._black, self._gain)
        valid = self._valid
        if valid is not None:  # saturated pixels are lower bounds of the light; these are not
            views[~valid] = 0.0
        if saturated is not None:
            # A hot pixel is as saturated as the neighbours that replace it.
            clipped = self._mended(np.any(saturated, axis=2)[..., None].astype(np.float32))
            share = self._resample(clipped, None, None)
            valid = self._known(np.abs(share, out=share).max(axis=4) <= TOUCHED, valid)
        coloured = len(self.shape) == 3 or self.bayer is not None
        weights = None if self.weights.all() else self.weights.astype(np.float32)
        return LightField.trusted(
            views if coloured else views[..., 0], weights=weights, valid=valid
        )

    def _upright(self, image: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(image.swapaxes(0, 1)) if self.grid.columns else image

    def _mended(self, image: np.ndarray) -> np.ndarray:
        return sensor.mended(image, self._hot, self._step)

    def _known(
        self, known: np.ndarray | None, other: np.ndarray | None = None
    ) -> np.ndarray | None:
        """Combine which pixels of the views that count are known, (v, u, t, s); None if all are."""
        if known is None:
            return None
        known = known | ~self.weights[..., None, None]
        if other is not None:
            known &= other
        return None if known.all() else known

    def _resample(
        self, image: np.ndarray, black: np.ndarray | None, gain: np.ndarray | None
    ) -> np.ndarray:
        """Resample an upright image, (rows, columns, channels): float32, (v, u, t, s, channel)."""
        lattices = self._lattices
        if self.bayer is None and image.shape[2] < lattices.top.size:  # grey, for all channels
            lattices = _lattices(self._grid, None, 1)
        channels = 1 + int(lattices.channel.max())
        size = self._rows, self._join.left.shape[1]
        out = np.empty((self.views, self.views, *size, channels), np.float32)
        black, gain = (NONE if one is None else one for one in (black, gain))
        resample(image, black, gain, lattices, self._arrays, self._join, out)
        if not self.grid.columns:
            return out
        return np.ascontiguousarray(out.transpose(1, 0, 3, 2, 4))

    def _use_white(self, white: np.ndarray, pattern: str | None) -> None:
        """Set the factors of the pixels, the lit views, and what is known of their pixels."""
        self._notes.append(sensor.note_on_white(white))
        self._bright = float(np.percentile(white[::3, ::3], 95))
        light = white if self._black is None else white - self._black
        light = np.ascontiguousarray(self._mended(light), np.float32)
        if self.bayer is None:
            sensor.refuse_mosaic(light, self._grid, "white")
        else:
            self._notes.append(sensor.note_on_colours(light, self._grid, self.bayer))
        self._micro_images = sensor.mean_micro_images(light, self._grid, self._step)
        parts = self._resample(light, None, None)
        middle = parts[self.views // 2, self.views // 2]
        brightest = middle.mean(axis=2)
        seen = brightest > LEAST_LEVEL * np.percentile(brightest, 95)  # not beyond the array
        level = np.median(middle[seen], axis=0) if seen.any() else np.zeros(1)
        if not np.all(level > 0):
            raise InputError(
                f"The white image must be bright in the middle of its micro-images, "
                f"got a median there of {level.min():g}."
            )
        least = np.maximum(np.float32(LEAST_LIT) * middle, np.float32(LEAST_LEVEL) * level)
        known = (parts >= least).all(axis=4)
        del parts
        gain = np.zeros_like(light)
        breadth = math.ceil(max(self._grid.pitch, self._grid.row_pitch) / self._step)
        for n, (top, left) in enumerate(np.ndindex(self._step, self._step)):
            at = np.s_[top :: self._step, left :: self._step]
            most = level if pattern is None else level["rgb".index(pattern[n])]
            pixels = light[at]
            highest = np.percentile(pixels, 99.9)  # without hot pixels
            around = np.minimum(pixels, highest)
            around = ndimage.maximum_filter(around, (breadth, breadth, 1), mode="nearest")
            is_lit = pixels >= LEAST_LIT * np.maximum(around, LEAST_LEVEL * most)
            is_lit &= pixels < 1.5 * highest
            np.divide(most, pixels, out=gain[at], where=is_lit)
        self._gain = gain
        # Decoded by itself a white image is even, but where pixels among lit ones are not lit.
        even = self._resample(light, None, gain)
        even -= level.astype(np.float32)
        self._valid = known & (np.abs(even, out=even) <= TOUCHED * level).all(axis=4)
        del even
        share = self._resample((gain > 0).astype(np.float32), None, None)
        # A view counts if 85 % of it are lit, in each colour: where one has no lit pixels, light
        # from farther inside is in its place, which makes slopes smaller.
        lit = np.array([[np.median(one[seen], axis=0).min() for one in row] for row in share])
        self._lit = lit >= 0.85
        if self._grid.pitch >= 5 and self._lit.sum() < 9:
            sensor.refuse_spots(self._lit)

    def _check(self, image: np.ndarray, saturated: np.ndarray | None) -> None:
        """Refuse what does not fit; note what is doubtful, hot and saturated pixels, once."""
        self._is_new = False
        light = image if self._black is None else image - self._black
        if self.bayer is None:
            sensor.refuse_mosaic(light, self._grid, "raw")
        means = sensor.mean_micro_images(light, self._grid, self._step)
        if self._black is None:
            self._notes.append(sensor.note_on_black(means))
        else:
            bright = self._bright or float(np.percentile(image[::3, ::3], 95))
            dark_means = sensor.mean_micro_images(self._black, self._grid, self._step)
            self._notes.append(sensor.check_dark(self._black, means, dark_means, bright))
        if self._micro_images is not None:
            sensor.refuse_other_white(self._micro_images, means, self._lit)
        if self._hot is not None:
            LOGGER.info(
                f"{len(self._hot[0])} hot pixels of the sensor are replaced by their neighbours of "
                f"the same colour."
            )
        if saturated is not None:
            clipped = np.count_nonzero(saturated)
            self._notes.append(
                f"{clipped} pixels ({clipped / image.size:.2g} of all) are saturated: what they "
                f"touch in the views is unknown, and left out; expose less."
            )
        for note in filter(None, self._notes):
            LOGGER.warning(note)


def _count_views(grid: LensletGrid, views: int | None) -> int:
    if views is None:
        pixels = round(grid.pitch)
        return pixels - 1 + pixels % 2
    if not 1 <= views <= 2 * grid.pitch or views != int(views):
        raise InputError(
            f"views must be a whole number from 1 to twice the {grid.pitch:.4g} pixels under a "
            f"lenslet, got {views}."
        )
    return int(views)


def _own_views(grid: LensletGrid, views: int) -> np.ndarray:
    """Find the views whose parts lie in the round micro-images of a hexagonal array: bool."""
    if grid.layout == "rectangular":
        return np.ones((views, views), bool)
    farthest = math.hypot((views - 1) / 2, 0.0 if views % 2 else 0.5)  # in the middle of a side
    return np.hypot(*np.meshgrid(centred(views), centred(views))) <= farthest + 1e-9


def _lattices(grid: LensletGrid, pattern: str | None, channels: int) -> Lattices:
    """Pixels of each colour of a mosaic, or of each channel."""
    if pattern is None:
        zeros, each = np.zeros(channels, np.int64), np.arange(channels)
        y, x = np.full(channels, grid.y0), np.full(channels, grid.x0)
        return Lattices(zeros + 1, zeros, zeros, each, each, zeros - 1, y, x)
    (red_y, red_x), (blue_y, blue_x) = (divmod(pattern.index(colour), 2) for colour in "rb")
    step, top, left = (
        np.array([2, 1, 2]),
        np.array([red_y, 0, blue_y]),
        np.array([red_x, 0, blue_x]),
    )
    green = np.array([-1, pattern.index("g") % 2, -1])
    y, x = (grid.y0 - top) / step, (grid.x0 - left) / step
    return Lattices(step, top, left, np.zeros(3, np.int64), np.arange(3), green, y, x)


def _array(
    grid: LensletGrid, views: int, step: int, rows: np.ndarray, columns: np.ndarray
) -> Array:
    """Lenslets in pixels of a lattice.

    Light is summed along the pixel rows first and down after: a part is as wide as its distance to
    the next along a pixel row, and as high as that along a pixel column.
    """
    cos, sin = math.cos(grid.rotation), math.sin(grid.rotation)
    tan, height, width = abs(sin / cos), *(side / step for side in grid.window)
    # Own pixels lie whole in the micro-image, to 0.02 pixel.
    half_down, half_along = (max(side / 2 - 0.48 / step, 0.5) for side in (height, width))
    is_round = grid.layout == "hexagonal"
    covered = (cos * height + abs(sin) * width) / 2
    high = half_along if is_round else cos * half_down + abs(sin) * half_along
    return Array(
        first_row=int(rows[0]),
        first_column=int(columns[0]),
        columns=len(columns),
        pitch=grid.pitch / step,
        row_pitch=grid.row_pitch / step,
        offset=0.5 if is_round else 0.0,
        cos=cos,
        sin=sin,
        part_down=height * cos / views,
        part_along=width / cos / views,
        half_down=half_down,
        half_along=half_along,
        radius=half_along if is_round else 0.0,
        high=high,
        wide=width / cos / 2 + tan * covered + 0.75,
        margin=math.ceil(covered - high) + 1,
        reach=2 if is_round else 3 + math.ceil(abs(sin) * width),
        shear=sin * cos,
        fewest=2 if half_along >= 1.5 else 1,
    )


def _join(grid: LensletGrid, columns: int) -> Join:
    """Interpolate a hexagonal array to a square grid that both kinds of rows share."""
    if grid.layout == "rectangular":  # as they are
        left = np.tile(np.arange(columns), (2, 1))
        return Join(left, np.zeros(left.shape, np.float32))
    spacing = grid.row_pitch / grid.pitch
    count = int((columns - 1.5) / spacing) + 1 if columns > 1 else 0
    if count < 1:
        raise InputError(
            f"A hexagonal array needs at least two whole lenslets along a row, got {columns}."
        )
    place = 0.5 + spacing * np.arange(count) - np.array([[0.0], [0.5]])  # in pitches along the row
    left = np.minimum(place.astype(int), columns - 2)
    return Join(left, (place - left).astype(np.float32))
