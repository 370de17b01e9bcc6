"""Image files of 8 and 16 bits, grey and colour, and conversion of their levels."""

import struct
from pathlib import Path

import imagecodecs
import numpy as np
import tifffile
from PIL import Image, PngImagePlugin

from lf_flame._common.atomic_files import atomic_write
from lf_flame._common.images import TIFF_SUFFIXES, read_pixels, to_unit
from lf_flame.errors import InputError
from lf_flame.lightfield import LightField

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", *TIFF_SUFFIXES, ".bmp", ".webp", ".ppm", ".pgm")
"""File endings of images, in lower or upper case."""

CONTAINER_SUFFIXES = (".lfp", ".lfr", ".lfx")
"""File endings of containers of the Lytro cameras, in lower or upper case."""

LYTRO_SUFFIXES = (*CONTAINER_SUFFIXES, ".raw")
"""File endings of pictures of these cameras."""


def is_lytro(path: str | Path) -> bool:
    """Whether a file is a picture of a Lytro camera by its ending."""
    return Path(path).suffix.lower() in LYTRO_SUFFIXES and not Path(path).is_dir()


def read_image(path: str | Path) -> np.ndarray:
    """Read an image of one or three channels: float32, shape (h, w) or (h, w, 3).

    Levels of 8 and 16 bits are scaled to 0 to 1; floats stay as they are; transparency is dropped.
    """
    pixels = read_pixels(path)
    if pixels.ndim == 3 and pixels.shape[2] in (2, 4):
        pixels = pixels[..., :-1]
    if pixels.ndim == 3 and pixels.shape[2] == 1:
        pixels = pixels[..., 0]
    if pixels.ndim != 2 and (pixels.ndim != 3 or pixels.shape[2] != 3):
        raise InputError(
            f"The image {path} must have 1 or 3 channels, got an array of shape {pixels.shape}."
        )
    return to_unit(pixels, path)


def to_levels(values: np.ndarray, bits: int) -> np.ndarray:
    """Round values from 0 to 1 to unsigned levels of 8 or 16 bits; refuse what would be clipped."""
    if bits not in (8, 16):
        raise InputError(f"bits must be 8 or 16, got {bits}.")
    low, high = values.min(), values.max()
    levels = np.rint(values * np.float32(2**bits - 1))
    if levels.min() < 0 or levels.max() > 2**bits - 1:
        raise InputError(
            f"Images of {bits} bits hold values from 0 to 1, got {low:.4g} to {high:.4g}: "
            f"scale them first."
        )
    return levels.astype(f"uint{bits}")


def white_level(pixels: np.ndarray) -> float:
    """Radiance that is shown as white: 1, or the brightest pixel if it is above 1 or below 0.1."""
    brightest = max(float(pixels.max()), float(np.finfo(np.float32).tiny))
    return max(brightest, 1.0) if brightest > 0.1 else brightest


def white_of(light_field: LightField) -> float:
    """Radiance of a light field that is shown as white: `white_level` of its `counted` pixels."""
    return white_level(light_field.counted)


def to_preview(image: np.ndarray, white: float) -> np.ndarray:
    """Image as 8-bit levels for display; radiance above `white` is shown as white."""
    return to_levels(np.clip(image / np.float32(white), 0, 1), 8)


def write_picture(path: str | Path, image: np.ndarray, *, white: float | None = None) -> None:
    """Write radiance as a picture of 8 bits, as viewers show it.

    Parameters
    ----------
    path : str or Path
        File, ending in .png, .tif or .tiff.
    image : ndarray, shape (h, w) or (h, w, 3)
        Radiance, such as a refocused image; below 0 is black.
    white : float, optional
        Radiance shown as white, above 0. Default: 1, or the brightest pixel if it is above 1 or
        below 0.1.

    Raises
    ------
    InputError
        If the ending, the shape or a value cannot be used.

    Examples
    --------
    >>> import numpy as np, tempfile
    >>> from lf_flame.formats import write_picture
    >>> from lf_flame.formats.images import read_image
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_picture(f"{folder}/ramp.png", np.array([[0.0, 2.0, 4.0]]))
    ...     (255 * read_image(f"{folder}/ramp.png")).round().tolist()
    [[0.0, 128.0, 255.0]]
    """
    image = np.asarray(image, np.float32)
    if image.size == 0 or not np.isfinite(image).all():
        raise InputError("A picture must have pixels, and all of them finite.")
    white = white_level(image) if white is None else white
    if not 0 < white < np.inf:
        raise InputError(f"white must be a finite radiance above 0, got {white}.")
    write_image(path, to_preview(image, white))


def write_image(path: str | Path, levels: np.ndarray, *, linear: bool = False) -> None:
    """Write levels, shape (h, w) or (h, w, 3), as PNG or TIFF by the ending; floats as TIFF.

    A PNG of 8 bits states that its levels are linear in radiance (gAMA), if they are; without it,
    such files count as gamma-coded.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in (".png", *TIFF_SUFFIXES):
        raise InputError(f"Images are written as .png, .tif or .tiff, got {path}.")
    if levels.dtype.kind == "f" and suffix == ".png":
        raise InputError(f"Floats (32 bits) are written as .tif or .tiff, got {path}.")
    if levels.ndim == 3 and levels.shape[2] == 1:
        levels = levels[..., 0]
    if levels.ndim == 3 and levels.shape[2] != 3:
        raise InputError(f"An image must have 1 or 3 channels, got {levels.shape[2]}.")
    with atomic_write(path) as aside:
        if suffix in TIFF_SUFFIXES:
            photometric = "rgb" if levels.ndim == 3 else "minisblack"
            tifffile.imwrite(aside, levels, photometric=photometric, compression="zlib")
        elif levels.ndim == 3 and levels.dtype == np.uint16:  # Pillow cannot write these
            aside.write_bytes(imagecodecs.png_encode(np.ascontiguousarray(levels)))
        else:
            says = PngImagePlugin.PngInfo()
            if linear and levels.dtype == np.uint8:
                says.add(b"gAMA", struct.pack(">I", 100_000))
            Image.fromarray(levels).save(aside, pnginfo=says)
