"""Image files of 8 and 16 bits, grey and colour, and what their numbers mean."""

import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import tifffile
from PIL import Image
from skimage.io import imread

from lf_flame._common.atomic_files import atomic_write
from lf_flame.errors import InputError

TIFF_SUFFIXES = (".tif", ".tiff")

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", *TIFF_SUFFIXES, ".bmp", ".webp", ".ppm", ".pgm")
"""Endings that are taken for images, in small or capital letters."""


def read_image(path: str | Path) -> np.ndarray:
    """Read an image of one or three channels.

    Parameters
    ----------
    path : str or Path

    Returns
    -------
    ndarray of float32, shape (h, w) or (h, w, 3)
        8- and 16-bit levels as 0 to 1, floats as they are; transparency is left out.

    Raises
    ------
    InputError
        If the file is missing or damaged, is no image, or has other channels or levels.
    """
    with readable(path):
        is_tiff = Path(path).suffix.lower() in TIFF_SUFFIXES
        pixels = imread(path) if is_tiff else _read_pillow(path)
    if pixels.ndim == 3 and pixels.shape[2] in (2, 4):
        pixels = pixels[..., :-1]
    if pixels.ndim == 3 and pixels.shape[2] == 1:
        pixels = pixels[..., 0]
    if pixels.ndim != 2 and (pixels.ndim != 3 or pixels.shape[2] != 3):
        raise InputError(
            f"The image {path} must have 1 or 3 channels, got an array of shape {pixels.shape}."
        )
    return to_unit(pixels, path)


@contextmanager
def readable(path: str | Path) -> Iterator[None]:
    """Turn whatever a decoder raises at a damaged or strange file into an InputError."""
    if not Path(path).is_file():
        raise InputError(f"{path} cannot be read: there is no such file.")
    try:
        yield
    except (InputError, MemoryError):
        raise
    except Exception as error:  # damage can make a decoder raise anything
        reason = str(error).strip().partition("\n")[0].partition(". ")[0] or type(error).__name__
        raise InputError(
            f"{path} cannot be read: it is damaged, or of a kind that is not known ({reason})."
        ) from error


def _read_pillow(path: str | Path) -> np.ndarray:
    """Read an image in full depth.

    Of 16-bit colour in PNG, Pillow's decoder keeps the high byte of each level. Told that the bytes
    stand the other way round, it keeps the low one.
    """
    with Image.open(path) as image:
        tiles = image.tile
        packed = tiles[0].args if image.format == "PNG" else ""
        if packed == "LA;16B":
            raise InputError(f"{path} has 16-bit grey with transparency: store it without.")
        plain = image.mode in ("1", "L", "LA", "I;16", "I", "F", "RGB", "RGBA")
        high = np.asarray(image if plain else image.convert("RGB"))
    if packed not in ("RGB;16B", "RGBA;16B"):
        return high
    with Image.open(path) as image:
        image.tile = [tiles[0]._replace(args=packed.replace("16B", "16L"))]
        low = np.asarray(image)
    return high * np.uint16(256) + low


def to_unit(pixels: np.ndarray, source: str | Path) -> np.ndarray:
    """Bring unsigned levels of 8 or 16 bits to 0 to 1, leave floats as they are; float32."""
    kind, size = pixels.dtype.kind, pixels.dtype.itemsize
    if kind == "u" and size <= 2:
        return pixels / np.float32(2 ** (8 * size) - 1)
    if kind not in "bf":
        raise InputError(
            f"{source} must hold unsigned integers of 8 or 16 bits, or floats, got {pixels.dtype}."
        )
    with np.errstate(over="ignore"):  # infinite values are refused by the light field
        return pixels.astype(np.float32, copy=False)


def to_levels(values: np.ndarray, bits: int) -> np.ndarray:
    """Round values from 0 to 1 to unsigned levels of 8 or 16 bits, the inverse of `to_unit`.

    Raises
    ------
    InputError
        If `bits` is neither, or a value would have to be clipped.
    """
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
    """Radiance to show as white: 1, or the brightest pixel where it is above 1 or below 0.1."""
    brightest = max(float(pixels.max()), float(np.finfo(np.float32).tiny))
    return max(brightest, 1.0) if brightest > 0.1 else brightest


def to_preview(image: np.ndarray, white: float) -> np.ndarray:
    """Levels of 8 bits to look at: what is brighter than white is white."""
    return to_levels(np.clip(image / np.float32(white), 0, 1), 8)


def write_image(path: str | Path, levels: np.ndarray) -> None:
    """Write an image, shape (h, w) or (h, w, 3), as PNG or TIFF by the ending.

    Parameters
    ----------
    path : str or Path
    levels : ndarray of uint8 or uint16 (`to_levels`); for TIFF of float32 as well

    Raises
    ------
    InputError
        If the ending is another, or the number of channels.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in (".png", *TIFF_SUFFIXES):
        raise InputError(f"Images are written as .png, .tif or .tiff, got {path}.")
    if levels.ndim == 3 and levels.shape[2] == 1:
        levels = levels[..., 0]
    if levels.ndim == 3 and levels.shape[2] != 3:
        raise InputError(f"An image must have 1 or 3 channels, got {levels.shape[2]}.")
    with atomic_write(path) as aside:
        if suffix in TIFF_SUFFIXES:
            photometric = "rgb" if levels.ndim == 3 else "minisblack"
            tifffile.imwrite(aside, levels, photometric=photometric, compression="zlib")
        elif levels.ndim == 3 and levels.dtype == np.uint16:
            _write_deep_png(aside, levels)
        else:
            Image.fromarray(levels).save(aside)


def _write_deep_png(path: Path, levels: np.ndarray) -> None:
    """Write 16-bit colour, which Pillow cannot; PNG specification (ISO/IEC 15948), 5 and 9."""
    height, width = levels.shape[:2]
    lines = levels.astype(">u2").reshape(height, -1).view(np.uint8)
    filtered = np.empty((height, 1 + lines.shape[1]), np.uint8)
    filtered[:, 0] = 2  # filter "up": each byte less the one above it
    filtered[:, 1:] = np.diff(lines, axis=0, prepend=np.zeros_like(lines[:1]))
    header = struct.pack(">IIBBBBB", width, height, 16, 2, 0, 0, 0)
    with path.open("wb") as file:
        file.write(b"\x89PNG\r\n\x1a\n")
        for name, data in (
            (b"IHDR", header),
            (b"IDAT", zlib.compress(filtered.data, level=6)),
            (b"IEND", b""),
        ):
            check = zlib.crc32(name + data)
            file.write(struct.pack(">I", len(data)) + name + data + struct.pack(">I", check))
