"""Views that count, and the factors of their parts, from a white image."""

import math
from dataclasses import replace
from itertools import product

import numpy as np
from scipy import ndimage

from lf_flame.errors import InputError
from lf_flame.formats.raw.lenslet_grid import LensletGrid
from lf_flame.formats.raw.resampling import Resampling

LEAST_LIT = 0.5
"""Smallest brightness, relative to its micro-image's centre, of a pixel that counts as lit.

A darker pixel is partly outside the image of the aperture; its light comes from its inner part.
Scaled to full brightness, it would pull the slope of sharpest focus towards 0.
"""

SHARED, SHARED_IN_MOSAIC = 0.5, 1.5
"""Mean overlap, in pixels, of a part with a pixel that it shares with a neighbouring part. In a
mosaic the next pixel of a colour is up to two pixels away."""

LEAST_LEVEL = 0.05
"""Smallest centre brightness, relative to the median, of a micro-image that is trusted."""

EVEN = 0.005
"""Largest variance of the white image, after `pixel_gain`, over the pixels that a view's part is
read from, relative to its squared mean and beyond that of the central view. Where some of them are
dark, the light comes from the inner ones.
"""

MIDDLE = 1024
"""Largest side, in pixels, of the part of a white image that is looked at for that, if it holds
`WHOLE` micro-images."""

WHOLE = 4
"""Smallest number of micro-images along a side of that part."""


def counted_views(grid: LensletGrid, lit: np.ndarray, even: np.ndarray, step: int) -> np.ndarray:
    """Find the views that are lit, evenly, and belong to their own lenslet: bool, shape (v, u).

    With few views, those at the rim are needed, even if they share some light.
    """
    views = len(lit)
    own = lit & grid.own_views(views)
    if grid.on_pixels and step == 1:
        return own
    alone = lit & grid.own_views(views, SHARED if step == 1 else SHARED_IN_MOSAIC)
    fewest = own.sum() / 2 if step == 1 else 9
    return next((one for one in (alone & even, alone) if one.sum() >= fewest), own)


def pixel_gain(white: np.ndarray, grid: LensletGrid) -> np.ndarray:
    """Factor of each pixel of a mosaic that makes micro-images even, as far as they are lit.

    A part's light is a mean over pixels; weighted by their fall-off, it would be the light of a
    place nearer to the micro-image's centre.

    Parameters
    ----------
    white : ndarray of float32, shape (rows, columns, 1)
        White image less its black level.

    Returns
    -------
    ndarray of float32, same shape
        Brightest pixel of the colour within a micro-image's breadth over the pixel, at most
        1 / `LEAST_LIT`.
    """
    gain = np.ones_like(white)
    breadth = math.ceil(max(grid.pitch, grid.row_pitch) / 2)
    for top, left in product(range(2), repeat=2):
        pixels = white[top::2, left::2, 0]
        around = ndimage.maximum_filter(pixels, breadth, mode="nearest")
        bounded = np.maximum(pixels, np.float32(LEAST_LIT) * around)
        np.divide(around, bounded, out=gain[top::2, left::2, 0], where=bounded > 0)
    return gain


def evenly_lit(grid: LensletGrid, white: np.ndarray, views: int, bayer: str | None) -> np.ndarray:
    """Find the views of a mosaic that are read from evenly lit pixels: bool, shape (v, u).

    Parameters
    ----------
    white : ndarray of float32, shape (rows, columns, 1)
        White image less its black level, times `pixel_gain`.
    """
    side = max(MIDDLE, 2 * math.ceil(WHOLE * max(grid.pitch, grid.row_pitch) / 2))
    # Even corners keep the pattern of the mosaic.
    top, left = (max(n - side, 0) // 4 * 2 for n in white.shape[:2])
    white = np.ascontiguousarray(white[top : top + side, left : left + side])
    moved = replace(grid, x0=grid.x0 - left, y0=grid.y0 - top)
    resampling = Resampling(moved, white.shape[:2], views, bayer)
    means, squares = (resampling(one, None, square=False) for one in (white, white**2))
    uneven = np.median(squares / np.maximum(means**2, np.finfo(np.float32).tiny), axis=(2, 3))
    return (uneven <= uneven[views // 2, views // 2] + EVEN).all(axis=2)


def lit_views(white: np.ndarray) -> np.ndarray:
    """Find the views that are mostly lit in a white image's parts: bool, shape (v, u)."""
    level = np.array([[np.median(view.mean(axis=2)) for view in row] for row in white])
    return level >= LEAST_LIT * level[len(level) // 2, len(level) // 2]


def bright_parts(white: np.ndarray) -> np.ndarray:
    """Find the parts that are bright enough to divide by: bool, shape (v, u, row, column)."""
    _, least = _levels(white)
    return np.array([[(view >= least).all(axis=2) for view in row] for row in white])


def _levels(white: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Median of the white image's central view, and the least by which its parts are divided."""
    middle = white[white.shape[0] // 2, white.shape[1] // 2].copy()
    level = np.median(middle, axis=(0, 1))
    if not np.all(level > 0):
        raise InputError(
            f"The white image must be bright in the middle of its micro-images, "
            f"got a median there of {level.min():g}."
        )
    return level, np.maximum(np.float32(LEAST_LIT) * middle, np.float32(LEAST_LEVEL) * level)


def white_gain(white: np.ndarray) -> np.ndarray:
    """Median of the white image's central view over its parts, bounded for dark pixels.

    It replaces the parts, to save memory.
    """
    level, least = _levels(white)
    for row in white:
        for view in row:
            np.divide(level, np.maximum(view, least, out=view), out=view)
    return white
