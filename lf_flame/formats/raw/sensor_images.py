"""Images of a sensor under lenslets: their checks, saturated pixels, and whether they fit.

Light comes to a pixel through its lenslet, so that a raw image is the white image times the
scene's light: dark between micro-images, whatever the scene. A mosaic and a wrong white image
show in the light at the centres of micro-images and in the gaps between them.
"""

import logging
import math

import numpy as np
from numpy.typing import ArrayLike

from lf_flame.errors import InputError
from lf_flame.formats.raw.lenslet_grid import LensletGrid

LOGGER = logging.getLogger(__name__)

PATTERNS = ("rggb", "bggr", "grbg", "gbrg")
"""Colours of the upper left 2 x 2 pixels of a Bayer mosaic, row by row."""


def check_bayer(pattern: str | None, shape: tuple[int, ...]) -> str | None:
    """Return the pattern in lower case; refuse another one, and an image that is not a mosaic."""
    if pattern is None:
        return None
    if str(pattern).lower() not in PATTERNS:
        raise InputError(f"bayer must be one of {', '.join(PATTERNS)}, got {pattern!r}.")
    if len(shape) > 2 or any(n % 2 for n in shape):
        raise InputError(
            f"A Bayer mosaic has even numbers of rows and columns and one channel, got {shape}."
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
        raise InputError(f"A {name} lenslet image must be finite, got {bad} pixels that are not.")
    # Two types, for each of which decoding is compiled.
    image = image.astype(
        np.uint16 if image.dtype in (np.uint8, np.uint16) else np.float32, copy=False
    )
    return np.ascontiguousarray(image if image.ndim == 3 else image[..., None])


def checked(image: ArrayLike, name: str, shape: tuple[int, ...]) -> np.ndarray:
    """Check an image of a camera; all but a raw one may be grey where the raw ones are coloured."""
    image = as_image(image, name)
    if image.shape != (*shape, 1)[:3] and (name == "raw" or image.shape != (*shape[:2], 1)):
        raise InputError(
            f"The {name} image must have the shape {tuple(shape)} of raw ones, got {image.shape}."
        )
    return image


def subtract_dark(image: ArrayLike, dark: ArrayLike | None, name: str, shape: tuple) -> np.ndarray:
    """Check an image of a camera and subtract the dark one: (rows, columns, channels)."""
    image = checked(image, name, shape)
    return image if dark is None else image - checked(dark, "dark", shape).astype(np.float32)


def find_saturated(image: np.ndarray) -> np.ndarray | None:
    """Find the pixels at the largest level of a sensor of 8, 10, 12, 14 or 16 bits.

    Levels of fewer bits are the low or the high ones of 16. Floats are levels, or numbers from 0 to
    1 if they were scaled. Fewer than ten pixels there may be the light's own maximum.
    """
    highest, bits = float(image.max()), np.array([8, 10, 12, 14, 16])
    full = np.concatenate([2.0**bits - 1, 2.0**16 - 2.0 ** (16 - bits)])
    if image.dtype.kind == "f":
        full = np.concatenate([full, full / full[4]])
    if not np.any(np.abs(highest / full - 1) < 1e-6):
        return None
    saturated = image == image.max()
    return saturated if np.count_nonzero(saturated) >= 10 else None


# Checks, which refuse or warn ---------------------------------------------------------------------


def check_colours(image: np.ndarray, grid: LensletGrid, name: str) -> None:
    """Refuse a grey image with the 2 x 2 pattern of a Bayer mosaic, which no grey one has.

    image: (rows, columns[, channels]), without its black level; one in colour is not a mosaic. The
    pattern is that of the light around the centres of eight groups of lenslets, whose mean must
    exceed 8 standard errors: texture is then not mistaken for colour.
    """
    image = np.atleast_3d(image)
    if image.shape[2] != 1 or min(image.shape[:2]) < 2 * grid.pitch:
        return
    centres = grid.centres(image.shape).reshape(-1, 2)
    y, x = np.rint(centres).astype(int).T
    inside = (y >= 2) & (y < image.shape[0] - 2) & (x >= 2) & (x < image.shape[1] - 2)
    y, x = y[inside], x[inside]
    sums, group = np.zeros((8, 2, 2)), np.arange(len(y)) % 8
    # These weights have equal totals on even and odd pixels, for light that is constant or cubic.
    weights = np.outer([1.0, 4.0, 6.0, 4.0, 1.0], [1.0, 4.0, 6.0, 4.0, 1.0])
    for (dy, dx), weight in np.ndenumerate(weights):
        light = weight * image[y + dy - 2, x + dx - 2, 0].astype(np.float64)
        np.add.at(sums, (group, (y + dy) % 2, (x + dx) % 2), light)
    if not np.all(sums > 0):  # too few lenslets, or no light
        return
    logs = np.log(sums)
    contrast = logs[:, 0, 0] + logs[:, 1, 1] - logs[:, 0, 1] - logs[:, 1, 0]
    # Log of red blue / green^2: 1.4 in daylight, 0.9 in lamp light. Where the centres lie evenly on
    # the four pixels, amplifiers alone reach 0.03; round grey micro-images reach 0.54 elsewhere.
    is_even = abs(np.exp(1j * math.pi * centres.sum(axis=1)).mean()) < 0.01
    least = max(0.03 if is_even else 0.6, 8 * contrast.std(ddof=1) / math.sqrt(8))
    if abs(contrast.mean()) < least:
        return
    brighter = [one for one in PATTERNS if (one[0] == "g") == (contrast.mean() > 0)]
    raise InputError(
        f"The {name} image is a colour mosaic (Bayer), not grey; decode it as a raw image and "
        f"state the colours of the upper left four pixels, row by row, as the camera's maker gives "
        f"them: --bayer {' or '.join(brighter)}, as the brighter diagonal is green in most light."
    )


def warn_of_saturated(saturated: np.ndarray | None, effect: str) -> None:
    """Warn of the pixels of an image that `find_saturated` found, and of what follows."""
    if saturated is not None:
        LOGGER.warning(
            f"{np.count_nonzero(saturated)} pixels ({saturated.mean():.2g} of all) are saturated: "
            f"{effect}; expose less."
        )


def refuse_other_white(flat: np.ndarray, light: np.ndarray) -> None:
    """Refuse a white image between whose micro-images the raw image is bright.

    flat, light: `mean_micro_images` of the white and the raw image; blocks of lenslets are left out
    where the raw image shows noise alone, or either no dark gaps.
    """
    one, other = (light - light.mean(axis=2, keepdims=True)).swapaxes(0, 1)
    power = np.sqrt((one**2).sum(axis=1) * (other**2).sum(axis=1))
    shown = (one * other).sum(axis=1) > 0.7 * power  # it is 0 for noise alone
    flat, light = flat.mean(axis=1), light.mean(axis=1)
    for means, darkest in ((flat, 0.3), (light, 0.5)):
        shown &= means.min(axis=1) < darkest * means.max(axis=1)
    if np.count_nonzero(shown) < 4:
        return
    flat, light = (x[shown] - x[shown].min(axis=1, keepdims=True) for x in (flat, light))
    level = flat / flat.max(axis=1, keepdims=True)
    between, within = (
        (np.sum(light * at, axis=1) / np.count_nonzero(at, axis=1)).sum()
        for at in (level <= 0.2, level >= 0.5)
    )
    # 0.01 to 0.37 where both fit, most with a flame beside the picture; 0.52 for a white image that
    # is moved by 0.22 of a pitch, 0.78 for 0.35.
    if between < 0.45 * within:
        return
    raise InputError(
        f"The white image does not fit the raw image: between its micro-images the raw image is "
        f"{between / max(within, 1e-30):.0%} as bright as in them, where it should be dark; it is "
        f"the wrong one, or was rotated, mirrored or shifted; give the white image of the raw "
        f"image's camera, lens and aperture, as the sensor recorded it."
    )


def mean_micro_images(image: np.ndarray, grid: LensletGrid, step: int) -> np.ndarray:
    """Mean micro-images of blocks of 4 x 4 lenslets, each in two halves: (block, 2, pixel).

    In larger blocks micro-images of another pitch would average out. In a mosaic each value is the
    mean of 2 x 2 pixels, so that a coloured scene has no pattern of its own.
    """
    centres = np.rint(grid.centres(image.shape)).astype(int)
    rows, columns = (min(4, n) for n in centres.shape[:2])
    down, along = centres.shape[0] // rows, centres.shape[1] // columns
    whole = centres[: down * rows, : along * columns].reshape(down, rows, along, columns, 2)
    centres = whole.swapaxes(1, 2).reshape(down * along, rows * columns, 2)
    dy, dx = (np.arange(-(int(n) // 2), int(n) // 2 + 1) for n in grid.window)
    most = max(4, 2_000_000 // (dy.size * dx.size * centres.shape[1]))  # an even choice
    centres = centres[np.linspace(0, len(centres) - 1, min(len(centres), most)).astype(int)]
    y = np.clip(centres[..., 0, None, None] + dy[:, None], 0, image.shape[0] - 1)
    x = np.clip(centres[..., 1, None, None] + dx, 0, image.shape[1] - 1)
    pixels = image[y, x].mean(axis=4, dtype=np.float32)
    if step == 2:
        pixels = pixels[..., 1:, :] + pixels[..., :-1, :]
        pixels = (pixels[..., 1:] + pixels[..., :-1]) / 4
    pixels = pixels.reshape(*pixels.shape[:2], -1)
    odd = np.add.outer(np.arange(rows), np.arange(columns)).ravel() % 2
    halves = [pixels[:, odd == half] for half in (0, min(1, odd.size - 1))]
    return np.stack([half.mean(axis=1) for half in halves], axis=1)
