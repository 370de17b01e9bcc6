"""The plan by which raw lenslet images of one camera are resampled into views.

It is made once for a grid, a white and a dark image, and then decodes any number of frames.
Micro-image pixels stay in sensor order, not flipped (`lf_flame.lightfield`). The rows and columns
of views follow the array, so that a rotation of the array against the sensor is removed.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage

from lf_flame._common.arrays import centred
from lf_flame.errors import InputError
from lf_flame.formats.raw import sensor_images as sensor
from lf_flame.formats.raw._decode_kernels import Lattices, Lenslets, resample
from lf_flame.formats.raw.lenslet_grid import LensletGrid
from lf_flame.lightfield import LightField

TOUCHED = 0.02
"""Share of saturated or dead pixels of the sensor in a pixel of a view from which it is unknown."""

LEAST_LIT = 0.5
"""Smallest brightness, relative to its micro-image's centre, of a lit pixel. A darker pixel
is partly outside the image of the aperture, so that its light comes from its inner part."""

LEAST_LEVEL = 0.05
"""Smallest brightness of a micro-image, relative to the median, that is trusted."""


class DecodePlan:
    """Plan for decoding the raw images of one camera.

    A micro-image is divided into views x views equal parts, so that a slope does not depend on how
    many pixels it has. A view's pixel is the mean radiance of its part, found from the lenslet's
    own pixels alone: those that lie entirely in its micro-image, round in a hexagonal array, and
    are lit in the white image. Beyond them light is extrapolated linearly, so that no light comes
    from a neighbour, and a part at the rim has the light of its own centre. Between pixels a cubic
    conserves the light (Colella and Woodward 1984). Parts of a rotated array have their true
    centres; their edges stay parallel to the sensor's, right to first order in the rotation. Each
    colour of a Bayer mosaic is decoded from its own pixels, without a demosaic.

    A hexagonal array is resampled to a square grid with the distance of its rows, by linear
    interpolation along each row: slopes are in row distances per view, 2 / sqrt(3) times those in
    pitches per view. An array in straight columns is decoded as its transpose.

    A pixel of a view is unknown (`LightField.valid`) if more than 2 % of it come from saturated
    pixels; or, in the views that are used, if it is too dark in the white image, or bad pixels
    change its light there by 2 % (it then holds 0). Views less than 85 % lit in the white image
    get weight 0, and in a hexagonal array those whose parts reach beyond the circle that touches
    the neighbours.

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
        image. For reflectance, divide them by the views of the white image, decoded by this plan.
        Pixels darker than half the centre of their micro-image are not used. Default: no division.
    dark : array_like, shape as raw, or without channels; optional
        Image without light, in the same units. It is subtracted from both raw and white image,
        because each contains the sensor's black level. Default: black is 0.
    bayer : {"rggb", "bggr", "grbg", "gbrg"}, optional
        Colours of the upper left 2 x 2 pixels of a mosaic, row by row. Default: no mosaic. The
        white image shows which two are green, but not which one is red.

    Attributes
    ----------
    weights : ndarray of bool, shape (views, views)
        Whether each view is used; those left out have weight 0.

    Raises
    ------
    InputError
        If an argument cannot be used, no micro-image lies entirely in the image, or the white image
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
    ):
        self.grid, self.shape, self.views = grid, tuple(shape), count_views(grid, views)
        self.bayer = sensor.check_bayer(bayer, self.shape)
        # Everything else is for rows: images of an array in columns are transposed, and its views.
        self._grid, pattern, size = grid.upright, self.bayer, self.shape[:2]
        if grid.columns:
            size = size[::-1]
            pattern = pattern and pattern[0] + pattern[2] + pattern[1] + pattern[3]
        self._step = 1 if pattern is None else 2
        self._lattices = _lattices(pattern, (*self.shape, 1)[2])
        self._lenslets = tuple(_lenslets(self._grid, self.views, step) for step in (1, 2))
        self._rows, self._columns = self._grid.block(size)
        self._left, self._share = _join(self._grid, len(self._columns))
        self._is_new = True
        # From the dark image; and from the white one, whose mean micro-images are `_flat`.
        self._black: np.ndarray | None = None
        self._gain: np.ndarray | None = None
        self._valid: np.ndarray | None = None
        self._flat: np.ndarray | None = None
        self._unknown = np.empty(0, int)  # numbers of the pixels that are not valid
        if dark is not None:
            black = self._upright(sensor.checked(dark, "dark", self.shape))
            self._black = black.astype(np.float32, copy=False)
        self.weights = _own_views(grid, self.views)
        if white is not None:
            self._use_white(self._upright(sensor.checked(white, "white", self.shape)), pattern)

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
            pattern of a mosaic that is not stated, or does not fit the white image.
        """
        image = self._upright(sensor.checked(raw, "raw", self.shape))
        saturated = sensor.find_saturated(image)
        light = image if self._black is None else image - self._black
        if self._is_new:
            self._check(light, saturated)
            self._is_new = False
        valid, views = self._valid, self._resample(light, self._gain)
        # Saturated pixels keep their value, a lower bound of the light.
        views.reshape(-1, views.shape[4])[self._unknown] = 0.0
        if saturated is not None:
            share = self._resample(np.any(saturated, axis=2)[..., None].astype(np.float32))
            known = np.abs(share, out=share).max(axis=4) <= TOUCHED
            known[~self.weights] = True
            valid = known if valid is None else known & valid
        return LightField.trusted(
            views if len(self.shape) == 3 or self.bayer is not None else views[..., 0],
            weights=None if self.weights.all() else self.weights.astype(np.float32),
            valid=None if valid is None or valid.all() else valid,
        )

    def _upright(self, image: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(image.swapaxes(0, 1)) if self.grid.columns else image

    def _resample(self, image: np.ndarray, gain=None) -> np.ndarray:
        """Resample an upright image, (rows, columns, channels): float32, (v, u, t, s, channel)."""
        channels = image.shape[2] if self.bayer is None else 3
        size = self.views, self.views, len(self._rows), self._left.shape[1]
        gain = np.empty((0, 0, 1), np.float32) if gain is None else gain
        out = np.empty((*size, channels), np.float32)
        resample(
            image, gain, self._lattices, self._lenslets, self._rows, self._columns, self._left,
            self._share, out,
        )  # fmt: skip
        if self.grid.columns:  # which are decoded as rows
            out = np.ascontiguousarray(out.swapaxes(0, 1).swapaxes(2, 3))
        return out

    def _use_white(self, white: np.ndarray, pattern: str | None) -> None:
        """Set the factors of the pixels, the lit views, and what is known of their pixels."""
        saturated = sensor.find_saturated(white)
        if saturated is not None and saturated.mean() >= 0.01:  # fewer may be hot pixels
            sensor.warn_of_saturated(saturated, "the white image is wrong by several per cent")
        light = white if self._black is None else white - self._black
        light = np.ascontiguousarray(light, np.float32)
        if self.bayer is None:
            sensor.check_colours(light, self._grid, "white")
        self._flat = sensor.mean_micro_images(light, self._grid, self._step)
        parts = self._resample(light)
        middle = parts[self.views // 2, self.views // 2]
        brightest = middle.mean(axis=2)
        seen = brightest > LEAST_LEVEL * np.percentile(brightest, 95)  # not beyond the array
        level = np.median(middle[seen], axis=0) if seen.any() else np.zeros(1)
        if not np.all(level > 0):
            raise InputError(
                f"The white image must be bright in the centre of lenslets, got {level.min():g}."
            )
        least = np.maximum(np.float32(LEAST_LIT) * middle, np.float32(LEAST_LEVEL) * level)
        valid = (parts >= least).all(axis=4)
        del parts
        self._gain = gain = np.zeros_like(light)
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
        # Decoded by itself a white image is even, except where single pixels are not lit.
        even = self._resample(light, gain)
        even -= level.astype(np.float32)
        valid &= (np.abs(even, out=even) <= TOUCHED * level).all(axis=4)
        del even
        share = self._resample((gain > 0).astype(np.float32))
        # A view is used if 85 % of it are lit, in each colour: where one has no lit pixels, light
        # from farther inside is in its place, which makes slopes smaller.
        lit = np.array([[np.median(one[seen], axis=0).min() for one in row] for row in share])
        self.weights &= lit >= 0.85
        used = np.count_nonzero(self.weights)  # spots light one view, or a few
        if not used or (used < 9 and self.weights.size >= 25):
            raise InputError(
                f"The white image lights {used} of {self.weights.size} views: state more views, or "
                f"leave it out; a calibration with a closed aperture is given as --lenslets, and "
                f"an image with the aperture of the raw one as --white."
            )
        valid[~self.weights] = True
        self._valid, self._unknown = None if valid.all() else valid, np.flatnonzero(~valid)

    def _check(self, light: np.ndarray, saturated: np.ndarray | None) -> None:
        """Refuse an image that does not fit, and warn of doubtful ones."""
        if light.max() < 0:
            raise InputError("The dark image is brighter than all of the raw one: in other units?")
        if self.bayer is None:
            sensor.check_colours(light, self._grid, "raw")
        if self._flat is not None:
            means = sensor.mean_micro_images(light, self._grid, self._step)
            sensor.refuse_other_white(self._flat, means)
        sensor.warn_of_saturated(saturated, "view pixels with them are unknown, and left out")


def count_views(grid: LensletGrid, views: int | None) -> int:
    """Check a number of views along each axis; default: the largest odd one up to the pitch."""
    if views is None:
        pixels = round(grid.pitch)
        return pixels - 1 + pixels % 2
    if not 1 <= views <= 2 * grid.pitch or views != int(views):
        raise InputError(
            f"views must be a whole number, 1 to twice the pitch of {grid.pitch:.4g}, got {views}."
        )
    return int(views)


def _own_views(grid: LensletGrid, views: int) -> np.ndarray:
    """Find the views whose parts lie in the round micro-images of a hexagonal array: bool."""
    if grid.layout == "rectangular":
        return np.ones((views, views), bool)
    from_middle = np.hypot(*np.meshgrid(centred(views), centred(views)))
    return from_middle <= from_middle[0, views // 2] + 1e-9  # at the centre of a side


def _lattices(pattern: str | None, channels: int) -> Lattices:
    """Pixels of each colour of a mosaic, or of each channel."""
    if pattern is None:
        zeros = np.zeros(channels, np.int64)
        return Lattices(step=zeros + 1, top=zeros, left=zeros, green=zeros - 1)
    red, blue = pattern.index("r"), pattern.index("b")
    return Lattices(
        step=np.array([2, 1, 2]),
        top=np.array([red // 2, 0, blue // 2]),
        left=np.array([red % 2, 0, blue % 2]),
        green=np.array([-1, pattern.index("g") % 2, -1]),
    )


def _lenslets(grid: LensletGrid, views: int, step: int) -> Lenslets:
    """Lenslets in pixels of a lattice.

    Light is summed along the pixel rows first and down after: a part is as wide as its distance to
    the next along a pixel row, and as high as that along a pixel column.
    """
    cos, sin = math.cos(grid.rotation), math.sin(grid.rotation)
    height, width = (side / step for side in grid.window)
    # Own pixels lie entirely in the micro-image, to 0.02 pixel.
    half_down, half_along = (max(side / 2 - 0.48 / step, 0.5) for side in (height, width))
    is_round = grid.layout == "hexagonal"
    covered = (cos * height + abs(sin) * width) / 2
    high = half_along if is_round else cos * half_down + abs(sin) * half_along
    return Lenslets(
        y=grid.y0 / step,
        x=grid.x0 / step,
        pitch=grid.pitch / step,
        row_pitch=grid.row_pitch / step,
        cos=cos,
        sin=sin,
        is_round=is_round,
        part_down=height * cos / views,
        part_along=width / cos / views,
        half_down=half_down,
        half_along=half_along,
        high=high,
        wide=width / cos / 2 + abs(sin / cos) * covered + 0.75,
        margin=math.ceil(covered - high) + 1,
        reach=2 if is_round else 3 + math.ceil(abs(sin) * width),
        fewest=2 if half_along >= 1.5 else 1,
    )


def _join(grid: LensletGrid, columns: int) -> tuple[np.ndarray, np.ndarray]:
    """Interpolation of a hexagonal array to a square grid that both kinds of rows share.

    Returns left columns and shares of the right ones, (parity of the row, column).
    """
    is_square = grid.layout == "rectangular"  # its columns stay as they are
    spacing, offset = (1.0, 0.0) if is_square else (grid.row_pitch / grid.pitch, 0.5)
    count = math.floor((columns - 1 - offset) / spacing) + 1
    if count < 1:
        raise InputError(
            f"A hexagonal array needs at least two whole lenslets along a row, got {columns}."
        )
    place = spacing * np.arange(count) + np.array([[offset], [0.0]])  # in pitches along the row
    left = place.astype(int)
    return left, (place - left).astype(np.float32)
