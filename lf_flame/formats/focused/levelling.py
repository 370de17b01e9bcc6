"""Brightness within micro-images: white image, or the mean fall-off in the picture itself."""

import numpy as np

from lf_flame.errors import InputError
from lf_flame.formats.focused._kernels import level
from lf_flame.formats.focused.lenslets import FocusedLenslets

LEAST_LIT = 0.2
"""Smallest brightness, relative to the micro-images' centres, by which a picture is divided."""

MOST_LENSLETS = 4000
"""Number of lenslets over which the fall-off is averaged: noise falls below a per cent."""


def levelled(image: np.ndarray, lenslets: FocusedLenslets) -> np.ndarray:
    """Divide a picture by the mean fall-off of its micro-images, which is taken to be round."""
    image = np.ascontiguousarray(image, np.float32)
    array = lenslets.array(image.shape)
    centres = array.centres[array.whole]
    centres = np.rint(centres[:: max(1, len(centres) // MOST_LENSLETS)]).astype(int)
    half = int(lenslets.radius)
    down, right = np.mgrid[-half : half + 1, -half : half + 1]
    distance = np.hypot(down, right)
    fall = np.zeros((half + 2, image.shape[2]))
    for ring in range(half + 1):
        spots = np.argwhere(np.rint(distance) == ring) - half
        light = [image[y + centres[:, 0], x + centres[:, 1]].mean(axis=0) for y, x in spots]
        fall[ring] = np.mean(light, axis=0)
    fall[half + 1] = fall[half]
    middle = fall[:2].mean(axis=0)
    # A picture without light, or below black, has no fall-off.
    share = np.where(middle > 0, fall / np.where(middle > 0, middle, 1), 1.0)
    out = np.empty_like(image)
    level(image, lenslets.lattice, 1 / np.maximum(share, LEAST_LIT), out)
    return out


def white_gain(white: np.ndarray, lenslets: FocusedLenslets) -> np.ndarray:
    """Factor of each pixel by which a white image becomes uniform, (rows, columns, channels)."""
    array = lenslets.array(white.shape)
    y, x = np.rint(array.centres[array.whole]).astype(int).T
    middle = np.median(white[y, x], axis=0)
    if not np.all(middle > 0):
        raise InputError(
            f"The white image must be bright in the middle of its micro-images, "
            f"got a median there of {middle.min():g}."
        )
    return (middle / np.maximum(white, LEAST_LIT * middle)).astype(np.float32)


def in_colour(mosaic: np.ndarray, bayer: str) -> np.ndarray:
    """Each colour of a mosaic, (rows, columns, 1), at all pixels by linear interpolation."""
    from scipy import ndimage  # takes a while to load

    kernel = np.outer([1, 2, 1], [1, 2, 1]) / 4
    light, pixels = (np.zeros((*mosaic.shape[:2], 3), np.float32) for _ in range(2))
    for place, colour in enumerate(bayer):
        at = np.s_[place // 2 :: 2, place % 2 :: 2, "rgb".index(colour)]
        light[at] = mosaic[at[0], at[1], 0]
        pixels[at] = 1
    sums = [
        [ndimage.convolve(a[..., k], kernel, mode="constant") for k in range(3)]
        for a in (light, pixels)
    ]
    return np.stack([one / many for one, many in zip(*sums, strict=True)], axis=2)
