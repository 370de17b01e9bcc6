"""Images of a sensor under lenslets: checks, Bayer patterns, and hot, dead and saturated pixels."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage

from lf_flame.errors import InputError
from lf_flame.formats.raw.lenslet_grid import LensletGrid

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
    # Two types, for each of which decoding is compiled.
    image = image.astype(
        np.uint16 if image.dtype in (np.uint8, np.uint16) else np.float32, copy=False
    )
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


# Hot, dead and saturated pixels ------------------------------------------------------------------

FACTOR = 2.0
"""Ratio to the pixels at the same place of neighbouring micro-images from which a pixel of a white
image is bad."""

FEWEST = 6
"""Smallest number of pixels of a colour across a micro-image with which they can be compared."""

NOISE = 10.0
"""Number of standard deviations by which a hot pixel exceeds its neighbours in a dark image."""

LEAST_LIGHT = 0.05
"""Smallest light of neighbours, relative to the median of the white image, beside which a pixel can
be bad; and the smallest excess of a hot pixel in the dark."""

FEWEST_SATURATED = 10
"""Smallest number of pixels at the largest level that counts as saturation."""

FEWEST_GOOD = 2
"""Smallest number of good neighbours from which a bad pixel is mended: two beside a bad line."""

SAMPLE = 100_003
"""Number of pixels from which the noise of a dark image is estimated."""


class BadPixels(NamedTuple):
    """Bad pixels and the good ones of the same colour beside them."""

    at: tuple[np.ndarray, np.ndarray]
    """Rows and columns, shape (n,)."""
    beside: tuple[np.ndarray, np.ndarray]
    """Rows and columns of the neighbours above, below, left and right, shape (4, n)."""
    good: np.ndarray
    """Whether each neighbour is good, shape (4, n)."""

    @property
    def lost(self) -> np.ndarray:
        """Whether each pixel has too few good neighbours, as inside a dark lenslet, shape (n,)."""
        return np.count_nonzero(self.good, axis=0) < FEWEST_GOOD

    def lost_in(self, shape: tuple[int, ...]) -> np.ndarray:
        """Image of an image's rows and columns, 1 where a pixel is lost: float32, (..., 1)."""
        out = np.zeros((*shape[:2], 1), np.float32)
        out[self.at[0][self.lost], self.at[1][self.lost]] = 1
        return out

    def mended(self, image: np.ndarray) -> np.ndarray:
        """Copy an image, (rows, columns, channels), with means of good neighbours in place."""
        out = image.copy()
        count = np.maximum(self.good.sum(axis=0), 1)[:, None]
        mean = (image[self.beside] * self.good[..., None]).sum(axis=0) / count
        some = ~self.lost
        out[self.at[0][some], self.at[1][some]] = mean[some]
        least = out[self.beside].min(axis=0)  # a lower bound, as hot pixels are none
        out[self.at[0][self.lost], self.at[1][self.lost]] = least[self.lost]
        return out


def find_bad_pixels(
    white: np.ndarray | None, dark: np.ndarray | None, grid: LensletGrid, step: int
) -> BadPixels | None:
    """Find hot pixels in a dark image, and hot and dead ones in a white image.

    A pixel is hot in the dark if it is far brighter than all eight neighbours of its colour. In a
    white image it is bad if it differs by more than a factor of two from the pixels at the same
    place of neighbouring micro-images, to two pixels; so none is found at a rim.
    """
    images = [image for image in (white, dark) if image is not None]
    if not images:
        return None
    bad = np.zeros(images[0].shape[:2], bool)
    light = 0.0 if white is None else float(np.median(white))
    for top, left in np.ndindex(step, step):
        part = np.s_[top::step, left::step]
        if dark is not None:
            bad[part] |= _hot(dark[part].max(axis=2), light)
        if white is not None and grid.pitch >= FEWEST * step:
            bad[part] |= _odd(white[part].mean(axis=2), grid, step, light)
    return _bad_pixels(bad, step) if bad.any() else None


def _hot(dark: np.ndarray, light: float) -> np.ndarray:
    """Pixels that are far brighter than their eight neighbours."""
    dark = dark.astype(np.float32)
    some = dark.ravel()[:: max(1, dark.size // SAMPLE)]
    noise = 1.4826 * float(np.median(np.abs(some - np.median(some)))) or float(some.std())
    around = np.full((3, 3), True)
    around[1, 1] = False
    brightest = ndimage.maximum_filter(dark, footprint=around, mode="mirror")
    return dark > brightest + max(NOISE * noise, LEAST_LIGHT * light, np.finfo(np.float32).tiny)


def _odd(white: np.ndarray, grid: LensletGrid, step: int, light: float) -> np.ndarray:
    """Pixels unlike those at the same place of the four nearest micro-images."""
    white = white.astype(np.float32)
    vectors = (
        np.rint(np.array(grid.turned(down, along)) / step).astype(int)
        for down, along in ((0, grid.pitch), (2 * grid.row_pitch, 0))  # two rows: for a hexagonal
    )
    size = 5 if step == 1 else 3  # two pixels to each side: a gap is at times one pixel wide
    steps = [sign * vector for vector in vectors for sign in (1, -1)]
    darkest, brightest = (
        [_moved(one, down, right) for down, right in steps]
        for one in (ndimage.minimum_filter(white, size), ndimage.maximum_filter(white, size))
    )
    low, high = _second(darkest), -_second([-one for one in brightest])
    return (low > LEAST_LIGHT * light) & ((white < low / FACTOR) | (white > high * FACTOR))


def _moved(image: np.ndarray, down: int, right: int) -> np.ndarray:
    """Image shifted by whole pixels; its edge is repeated."""
    rows = np.clip(np.arange(image.shape[0]) + down, 0, image.shape[0] - 1)
    columns = np.clip(np.arange(image.shape[1]) + right, 0, image.shape[1] - 1)
    return image[rows[:, None], columns]


def _second(four: list[np.ndarray]) -> np.ndarray:
    """Second smallest of four values."""
    a, b, c, d = four
    low, high = np.minimum(a, b), np.maximum(a, b)
    other_low, other_high = np.minimum(c, d), np.maximum(c, d)
    return np.minimum(np.maximum(low, other_low), np.minimum(high, other_high))


def _bad_pixels(bad: np.ndarray, step: int) -> BadPixels:
    rows, columns = np.nonzero(bad)
    moves = step * np.array([(-1, 0), (1, 0), (0, -1), (0, 1)])
    beside = rows + moves[:, :1], columns + moves[:, 1:]
    inside = np.ones(beside[0].shape, bool)
    for places, count in zip(beside, bad.shape, strict=True):
        inside &= (places >= 0) & (places < count)
    beside = tuple(np.clip(p, 0, n - 1) for p, n in zip(beside, bad.shape, strict=True))
    return BadPixels((rows, columns), beside, inside & ~bad[beside])


def find_saturated(image: np.ndarray, level: float | None = None) -> np.ndarray | None:
    """Find the pixels at a level or above, or at the largest level of a sensor of 8 to 16 bits.

    Levels of 16-bit files, and of 8-bit ones, are numbers from 0 to 1 if they were scaled; sensors
    of 10, 12 and 14 bits reach a part of 16. A few pixels there may be the light's own maximum,
    which a stated level excludes.
    """
    highest = float(image.max())
    if level is not None:
        least = level * (1 - np.finfo(np.float32).eps)  # as images are rounded to float32
        return image >= least if highest >= least else None
    bits = (8, 10, 12, 14, 16)
    full = [2**n - 1 for n in bits] if image.dtype.kind != "f" else []
    scaled = [1.0, *((2**n - 1) / (2**16 - 1) for n in bits[1:])] if not full else []
    if not any(abs(highest / level - 1) < 1e-6 for level in (*full, *scaled)):
        return None
    saturated = image == image.max()
    return saturated if np.count_nonzero(saturated) >= FEWEST_SATURATED else None
