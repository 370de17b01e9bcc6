"""The plan by which raw lenslet images of one camera are resampled into views.

It is made once for a grid, a white and a dark image, and then decodes any number of frames.
Micro-image pixels stay in sensor order, not flipped (`lf_flame.lightfield`). The rows and columns
of views follow the array, so that a rotation of the array against the sensor is removed.
"""

from __future__ import annotations

import logging

import numpy as np
from numpy.typing import ArrayLike

from lf_flame.errors import InputError
from lf_flame.formats.raw.bad_pixels import find_bad_pixels, find_saturated
from lf_flame.formats.raw.bayer import check_bayer
from lf_flame.formats.raw.black_level import note_on_black
from lf_flame.formats.raw.colour_pattern import check_pattern, refuse_mosaic
from lf_flame.formats.raw.lenslet_grid import LensletGrid
from lf_flame.formats.raw.resampling import Resampling
from lf_flame.formats.raw.sensor_images import as_image, fitting, less_dark
from lf_flame.formats.raw.white_match import check_match, mean_micro_images
from lf_flame.formats.raw.white_views import (
    bright_parts,
    counted_views,
    evenly_lit,
    lit_views,
    pixel_gain,
    white_gain,
)
from lf_flame.lightfield import LightField

LOGGER = logging.getLogger(__name__)

TOUCHED = 0.02
"""Share of unknown pixels of the sensor in a pixel of a view from which it is unknown too."""


class DecodePlan:
    """Plan for decoding the raw images of one camera.

    A micro-image is divided into views x views equal parts, so that a slope does not depend on how
    many pixels it has. A view's pixel is the mean radiance of its part: the integral of the
    parabolic spline that has the pixels' means (Zerroukat, Wood and Staniforth 2006). This
    conserves light and reproduces the pixels where parts coincide with them. It does not widen the
    views, unlike linear interpolation, which lowers the slope of sharpest focus by a few per cent.
    Like any sharp interpolation it may overshoot at a micro-image's rim. Parts of a rotated array
    have their true centres; their edges stay parallel to the sensor's, right to first order in the
    rotation.

    The pixels of each colour of a Bayer mosaic are interpolated linearly by themselves, without a
    demosaic: no light moves between colours, and none farther than two pixels. This blurs detail
    of a micro-image that is finer than a few pixels. The pixels are first divided by those of the
    white image, and views that are read also from dark pixels beyond the image of the aperture do
    not count: without the one or the other, slopes would be 2 % too low.

    A hexagonal array is resampled to a square grid with the distance of its rows: the rows stay,
    and along each row linear interpolation removes the offset of every other row and changes the
    column distance from the pitch to the row distance. Slopes of the result are in row distances
    per view: 2 / sqrt(3) times those in pitches per view.

    Hot and dead pixels, which the dark and the white image show, are replaced by their neighbours
    of the same colour. A pixel of a view is unknown (`LightField.valid`) if more than 2 % of it
    comes from saturated pixels, or from bad ones without a good neighbour; or if its lenslet is too
    dark there in the white image, in a view that otherwise counts.

    Views that receive light from a neighbouring lenslet get weight 0: their parts are nearer to a
    neighbour (`LensletGrid.own_views`), share pixels with it, or are mostly dark in the white
    image. Their light would change a slope by a few per cent.

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
        White image (flat field), by which the views are divided, relative to the median of its
        central view (in each channel): views keep the unit and the colour of the raw image. For
        reflectance, divide them by the views of the white image, decoded alike. Pixels darker
        than half the centre of their micro-image are divided by that half, so that the dark rim
        stays dark. Default: no division.
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
        If an argument cannot be used, or no micro-image lies whole in the image.

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
        self.bayer = None if bayer is None else check_bayer(bayer, self.shape)
        self.views = views = _count_views(grid, views)
        self._resampling = Resampling(grid, self.shape, views, self.bayer)
        step = self._resampling.step
        self._black = None if dark is None else fitting(dark, "dark", self.shape).astype(np.float32)
        light = None if white is None else less_dark(white, self._black, "white")
        self._refuse_mosaic(light, "white")
        self._note_on_colours = ""
        if self.bayer is not None and light is not None:
            self._note_on_colours = check_pattern(light, grid, self.bayer)
        self._bad = find_bad_pixels(light, self._black, grid, step)
        self._black = None if self._black is None else self._mended(self._black)
        self._micro_images = None if light is None else mean_micro_images(light, grid, step)
        self._gain, self._flat, bright = None, None, None
        lit = even = np.ones((views, views), bool)
        if white is not None and light is not None:
            flat = self._mended(fitting(white, "white", self.shape))
            parts = self._resampling(flat, self._black, square=False)
            lit, bright = lit_views(parts), self._resampling.joined(bright_parts(parts))
            if self.bayer is not None:
                del parts
                light = self._mended(light).astype(np.float32, copy=False)
                self._flat = pixel_gain(light, grid)
                light = light * self._flat
                even = evenly_lit(grid, light, views, self.bayer)
                parts = self._resampling(light, None, square=False)
            self._gain = white_gain(parts)
        self.weights, self._saturation = counted_views(grid, lit, even, step), saturation
        lost = None if self._bad is None else self._untouched(self._bad.lost_in(self.shape))
        self._valid = self._known(bright, lost)
        self._is_new = True

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
        image = as_image(raw, "raw")
        if image.shape != (*self.shape, 1)[:3]:
            raise InputError(
                f"A raw image must have the plan's shape {self.shape}, got {np.shape(raw)}."
            )
        saturated = find_saturated(image, self._saturation)
        if self._is_new:
            self._look_at(image, saturated)
        views = self._resample(self._mended(image))
        coloured = len(self.shape) == 3 or self.bayer is not None
        weights = None if self.weights.all() else self.weights.astype(np.float32)
        valid = self._valid
        if saturated is not None:
            # A bad pixel is as saturated as the neighbours that replace it.
            clipped = self._mended(np.any(saturated, axis=2)[..., None].astype(np.float32))
            valid = self._known(valid, self._untouched(clipped))
        return LightField.trusted(
            views if coloured else views[..., 0], weights=weights, valid=valid
        )

    def _resample(self, image: np.ndarray) -> np.ndarray:
        if self._flat is None:
            return self._resampling(image, self._black, self._gain)
        light = image if self._black is None else image - self._black
        return self._resampling(light * self._flat, None, self._gain)

    def _untouched(self, lost: np.ndarray) -> np.ndarray | None:
        """Find the pixels of views without noticeable light of lost pixels of the sensor.

        Parameters
        ----------
        lost : ndarray of float32, shape (rows, columns, 1)
            1 where a pixel of the sensor is lost, else 0.

        Returns
        -------
        ndarray of bool, shape (v, u, row, column), or None
            None if no pixel is lost.
        """
        if not lost.any():
            return None
        share = self._resampling(lost, None)
        return np.abs(share, out=share).max(axis=4) <= TOUCHED

    def _known(self, *found: np.ndarray | None) -> np.ndarray | None:
        """Combine what is known of the pixels of the views that count; None if all are known."""
        known = np.ones((1, 1, 1, 1), bool)
        for one in found:
            known = known if one is None else known & one
        known = known | ~self.weights[..., None, None]
        return None if known.all() else known

    def _look_at(self, image: np.ndarray, saturated: np.ndarray | None) -> None:
        """Refuse what does not fit; note bad and saturated pixels, and black, once."""
        self._is_new = False
        light = less_dark(image, self._black, "raw")
        self._refuse_mosaic(light, "raw")
        notes = [self._note_on_colours]
        if self._black is None:
            notes.append(note_on_black(image, self.grid))
        if self._micro_images is not None:
            means = mean_micro_images(light, self.grid, self._resampling.step)
            notes.append(check_match(self._micro_images, means))
        if self._bad is not None:
            LOGGER.info(
                f"{self._bad.good.shape[1]} hot or dead pixels of the sensor are replaced by their "
                f"neighbours of the same colour."
            )
        for note in filter(None, notes):
            LOGGER.warning(note)
        if saturated is not None:
            clipped = np.count_nonzero(saturated)
            LOGGER.warning(
                f"{clipped} pixels ({clipped / image.size:.2g} of all) are saturated: what they "
                f"touch in the views is unknown, and left out; expose less."
            )

    def _mended(self, image: np.ndarray) -> np.ndarray:
        return image if self._bad is None else self._bad.mended(image)

    def _refuse_mosaic(self, image: np.ndarray | None, name: str) -> None:
        if self.bayer is None and image is not None:
            refuse_mosaic(image, self.grid, name)


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
