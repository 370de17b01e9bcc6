"""Decoding of a plenoptic camera's raw lenslet image into a light field.

Micro-image pixels stay in sensor order, not flipped (`lf_flame.lightfield`). The rows and columns
of views follow the array, so that a rotation of the array against the sensor is removed.
"""

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage

from lf_flame._common import progress
from lf_flame._common.arrays import centred
from lf_flame.errors import InputError
from lf_flame.formats.lenslet_grid import LensletGrid
from lf_flame.formats.mosaic import refuse_mosaic
from lf_flame.lightfield import LightField

LEAST_LIT = 0.5
"""Smallest brightness, relative to its micro-image's centre, of a pixel that counts as lit.

A darker pixel is partly outside the image of the aperture; its light comes from its inner part.
Scaled to full brightness, it would pull the slope of sharpest focus towards 0.
"""

SHARED = 0.5
"""Mean overlap, in pixels, of a part with a pixel that it shares with a neighbouring part."""

LEAST_LEVEL = 0.05
"""Smallest centre brightness, relative to the median, of a micro-image that is trusted."""

MARGIN = 16
"""Number of repeated edge pixels around an image; a spline's end effect falls by 0.27 for each."""


def decode_raw(
    raw: ArrayLike,
    grid: LensletGrid,
    views: int | None = None,
    white: ArrayLike | None = None,
    *,
    dark: ArrayLike | None = None,
) -> LightField:
    """Resample the micro-images of a raw lenslet image into views.

    A micro-image is divided into views x views equal parts, so that a slope does not depend on its
    number of pixels. A view's pixel is the mean radiance of its part: the cumulative sums of the
    sensor's pixels, known at every border between pixels, are interpolated with a cubic spline and
    differenced (the parabolic spline method of Zerroukat, Wood and Staniforth 2006). This
    conserves light and reproduces the pixels where parts coincide with them. It does not widen the
    views, unlike linear interpolation, which lowers the slope of sharpest focus by some per cent.
    Like any sharp interpolation it may overshoot at a micro-image's rim. Parts of a rotated array
    have their true centres, but are taken as upright.

    A hexagonal array is resampled to a square grid with the distance of its rows: the rows stay,
    and along each row linear interpolation removes the offset of every other row and changes the
    column distance from the pitch to the row distance. Slopes of the result are in row distances
    per view: 2 / sqrt(3) times those in pitches per view.

    Views with light that is not their own lenslet's get weight 0: their parts are nearer to a
    neighbour (`LensletGrid.own_views`), share pixels with it, or are mostly dark in the white
    image. Their light would change a slope by some per cent.

    Parameters
    ----------
    raw : array_like, shape (rows, columns) or (rows, columns, channels)
        Image, linear in radiance, of any real type. A Bayer mosaic must be demosaiced before.
    grid : LensletGrid
        Positions of the micro-images, from `estimate_grid` or `grid_from_pitch`.
    views : int, optional
        Number of views along each axis. Default: the largest odd number not above the rounded
        pitch.
    white : array_like, shape as raw, or without channels; optional
        White image (flat field), by which the views are divided, relative to the median of its
        central view (in each channel). Pixels darker than half the centre of their micro-image are
        divided by that half, so that the dark rim stays dark. Default: no division.
    dark : array_like, shape as raw, or without channels; optional
        Image without light, in the same units. It is subtracted from both raw and white image,
        because each contains the sensor's black level. Default: black is 0.

    Returns
    -------
    LightField
        Views of the largest block of whole micro-images, with the weights of views.

    Raises
    ------
    InputError
        If an argument cannot be used, no micro-image lies whole in the image, or a grey image
        shows the 2 x 2 pattern of a mosaic.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame.formats import decode_raw, grid_from_pitch
    >>> raw = np.random.default_rng(1).uniform(size=(60, 80))
    >>> decode_raw(raw, grid_from_pitch(raw.shape, 10.0))
    LightField(9 x 9 views of 6 x 8 pixels, grey)
    """
    views = _count_views(grid, views)
    image, white = less_dark(raw, white, dark)
    for each, name in ((white, "white"), (image, "raw")):
        if each is not None and each.shape[2] == 1:
            refuse_mosaic(each[..., 0], grid, name)
    light_field = _cut(image, grid, views, "decoding")
    lit = np.ones((views, views), bool)
    if white is not None:
        white_views = _cut(white, grid, views, "decoding the white image")
        lit = _lit(white_views)
        light_field /= _level(white_views)
    if grid.layout == "hexagonal":
        light_field = _squared(light_field, grid, grid.block(image.shape)[0])
    counted = _counted(grid, lit)
    return LightField(
        light_field if np.ndim(raw) == 3 else light_field[..., 0],
        weights=None if counted.all() else counted,
    )


def _counted(grid: LensletGrid, lit: np.ndarray) -> np.ndarray:
    """Find the views that are lit and belong to their own lenslet: bool, shape (v, u)."""
    views = len(lit)
    own = lit & grid.own_views(views)
    if grid.on_pixels:
        return own
    alone = lit & grid.own_views(views, SHARED)
    # With few views, those at the rim are needed.
    return alone if 2 * alone.sum() >= own.sum() else own


def _lit(white: np.ndarray) -> np.ndarray:
    """Find the views that are mostly lit in a cut white image: bool, shape (v, u)."""
    level = np.median(white.mean(axis=4, dtype=np.float64), axis=(2, 3))
    return level >= LEAST_LIT * level[len(level) // 2, len(level) // 2]


def less_dark(
    raw: ArrayLike, white: ArrayLike | None, dark: ArrayLike | None
) -> tuple[np.ndarray, np.ndarray | None]:
    """Subtract a dark image from a raw and a white image, each as (rows, columns, channels).

    Raises
    ------
    InputError
        If one is not an image, or their shapes differ.
    """
    image = _as_image(raw, "raw")
    others = {
        name: None if other is None else _as_image(other, name)
        for name, other in (("white", white), ("dark", dark))
    }
    for name, other in others.items():
        if other is not None and other.shape not in (image.shape, (*image.shape[:2], 1)):
            raise InputError(
                f"The {name} image must have the raw image's shape {image.shape}, "
                f"got {other.shape}."
            )
    if others["dark"] is None:
        return image, others["white"]
    black = others["dark"].astype(np.float64)  # unsigned levels would wrap around below 0
    return image - black, None if others["white"] is None else others["white"] - black


def _as_image(image: ArrayLike, name: str) -> np.ndarray:
    """Check an image and add an axis of channels if it has none."""
    image = np.asarray(image)
    if image.ndim not in (2, 3) or image.size == 0 or image.dtype.kind not in "uif":
        raise InputError(
            f"A {name} lenslet image must be grey or coloured, (rows, columns[, channels]), "
            f"got an array of shape {image.shape} and type {image.dtype}."
        )
    bad = np.count_nonzero(~np.isfinite(image))
    if bad:
        raise InputError(
            f"A {name} lenslet image must be finite, got {bad} NaN or infinite pixels."
        )
    return image if image.ndim == 3 else image[..., None]


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


def _cut(image: np.ndarray, grid: LensletGrid, views: int, what: str) -> np.ndarray:
    """Mean of the image over each part of each micro-image: [v, u, row, column, channel]."""
    centres = grid.centres(image.shape)
    height, width = (side / views for side in grid.window)
    down, along = grid.turned(height * centred(views)[:, None], width * centred(views))
    out = np.empty((views, views, *centres.shape[:2], image.shape[2]), np.float32)
    with progress.bar(what, image.shape[2] * len(centres), "row") as shown:
        for channel in range(image.shape[2]):
            table = _summed_area(image[..., channel])
            for row, centre in enumerate(centres):  # one row of lenslets is contiguous in memory
                y, x = np.add.outer(down, centre[:, 0]), np.add.outer(along, centre[:, 1])
                out[:, :, row, :, channel] = _mean(table, y, x, height, width)
                shown.update()
    return out


def _summed_area(image: np.ndarray) -> np.ndarray:
    """Spline through the sum of all pixels above and to the left of each pixel corner."""
    padded = np.pad(image.astype(np.float64), MARGIN, mode="edge")
    sums = np.pad(padded.cumsum(axis=0).cumsum(axis=1), [(1, 0), (1, 0)])
    return ndimage.spline_filter(sums)


def _mean(
    table: np.ndarray, y: np.ndarray, x: np.ndarray, height: float, width: float
) -> np.ndarray:
    """Mean over upright rectangles centred at y, x, from the sums at their corners."""
    first = MARGIN + 0.5  # the centre of pixel 0
    total = np.zeros(y.shape)
    for down, right in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        corner = [y + first + down * height / 2, x + first + right * width / 2]
        sums = ndimage.map_coordinates(table, corner, order=3, mode="mirror", prefilter=False)
        total = total + down * right * sums
    return total / (height * width)


def _level(white: np.ndarray) -> np.ndarray:
    """White views relative to the median of the central one, bounded below for dark pixels."""
    middle = white[white.shape[0] // 2, white.shape[1] // 2]
    level = np.median(middle, axis=(0, 1))
    if not np.all(level > 0):
        raise InputError(
            f"The white image must be bright in the middle of its micro-images, "
            f"got a median there of {level.min():g}."
        )
    return np.maximum(white, np.maximum(LEAST_LIT * middle, LEAST_LEVEL * level)) / level


def _squared(views: np.ndarray, grid: LensletGrid, rows: np.ndarray) -> np.ndarray:
    """Resample a hexagonal array to a square grid that both kinds of rows share."""
    columns = views.shape[3]
    spacing = grid.row_pitch / grid.pitch
    count = int((columns - 1.5) / spacing) + 1 if columns > 1 else 0
    if count < 1:
        raise InputError(
            f"A hexagonal array needs at least two whole lenslets along a row, got {columns}."
        )
    out = np.empty((*views.shape[:3], count, *views.shape[4:]), views.dtype)
    for parity in (0, 1):
        place = 0.5 + spacing * np.arange(count) - parity / 2  # in pitches along the row
        left = np.minimum(place.astype(int), columns - 2)
        share = (place - left).astype(views.dtype)[:, None]
        some = views[:, :, rows % 2 == parity]
        near, far = some[..., left, :], some[..., left + 1, :]
        out[:, :, rows % 2 == parity] = (1 - share) * near + share * far
    return out
