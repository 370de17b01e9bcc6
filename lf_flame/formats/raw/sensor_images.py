"""Images of a sensor under lenslets: checked, and less their black level; Bayer patterns."""

import numpy as np
from numpy.typing import ArrayLike

from lf_flame.errors import InputError

PATTERNS = ("rggb", "bggr", "grbg", "gbrg")
"""Colours of the upper left 2 x 2 pixels of a Bayer mosaic, row by row."""


def check_bayer(pattern: str, shape: tuple[int, ...]) -> str:
    """Return the pattern in small letters; refuse another one, and an image that is no mosaic."""
    if str(pattern).lower() not in PATTERNS:
        raise InputError(f"bayer must be one of {', '.join(PATTERNS)}, got {pattern!r}.")
    if len(shape) > 2 or any(n % 2 for n in shape):
        raise InputError(
            f"A Bayer mosaic has an even number of rows and of columns and one channel, "
            f"got an image of shape {shape}."
        )
    return str(pattern).lower()


def as_image(image: ArrayLike, name: str) -> np.ndarray:
    """Check an image and give it as contiguous (rows, columns, channels)."""
    image = np.asarray(image)
    if image.ndim not in (2, 3) or image.size == 0 or image.dtype.kind not in "uif":
        raise InputError(
            f"A {name} lenslet image must be grey or coloured, (rows, columns[, channels]), "
            f"got an array of shape {image.shape} and type {image.dtype}."
        )
    bad = 0 if image.dtype.kind != "f" else np.count_nonzero(~np.isfinite(image))
    if bad:
        raise InputError(
            f"A {name} lenslet image must be finite, got {bad} NaN or infinite pixels."
        )
    if image.dtype not in (np.uint8, np.uint16):
        image = image.astype(np.float32, copy=False)
    return np.ascontiguousarray(image if image.ndim == 3 else image[..., None])


def fitting(image: ArrayLike, name: str, shape: tuple[int, ...]) -> np.ndarray:
    """Check a white or dark image, which may be grey where the raw images are coloured."""
    image = as_image(image, name)
    if image.shape not in ((*shape, 1)[:3], (*shape[:2], 1)):
        raise InputError(
            f"The {name} image must have the raw image's shape {shape}, got {image.shape}."
        )
    return image


def less_dark(image: ArrayLike, dark: ArrayLike | None, name: str) -> np.ndarray:
    """Subtract a dark image, which may be grey; gives (rows, columns, channels)."""
    image = as_image(image, name)
    if dark is None:
        return image
    return image - fitting(dark, "dark", image.shape).astype(np.float32)
