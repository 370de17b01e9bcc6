"""Pixels of image files, by decoders that only decode."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import tifffile
from PIL import Image

from lf_flame.errors import InputError

TIFF_SUFFIXES = (".tif", ".tiff")

FORMATS = ("PNG", "JPEG", "BMP", "WEBP", "PPM", "TIFF")
"""What Pillow may take a file for, whatever its name. Of a PostScript file it would start
Ghostscript; other formats are not needed."""


def read_pixels(path: str | Path) -> np.ndarray:
    """Read an image file in its full depth, and with its transparency.

    Parameters
    ----------
    path : str or Path
        A TIFF file by its ending, else one of FORMATS by its content.

    Returns
    -------
    ndarray, shape (h, w) or (h, w, channels)
        Levels as they are stored.

    Raises
    ------
    InputError
        If the file is missing or damaged, or is no image of these formats.
    """
    with readable(path):
        if Path(path).suffix.lower() in TIFF_SUFFIXES:
            return _channels_last(tifffile.imread(path))
        return _read_pillow(path)


def _channels_last(pixels: np.ndarray) -> np.ndarray:
    """Bring the channels to the end, which a TIFF file may store one after the other."""
    planar = pixels.ndim == 3 and pixels.shape[0] in (3, 4) and pixels.shape[2] not in (3, 4)
    return np.moveaxis(pixels, 0, -1) if planar else pixels


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
    with Image.open(path, formats=FORMATS) as image:
        tiles = image.tile
        packed = tiles[0].args if image.format == "PNG" else ""
        if packed == "LA;16B":
            raise InputError(f"{path} has 16-bit grey with transparency: store it without.")
        high = np.asarray(image if image.mode in _PLAIN else image.convert(_colours(image)))
    if packed not in ("RGB;16B", "RGBA;16B"):
        return high
    with Image.open(path, formats=("PNG",)) as image:
        image.tile = [tiles[0]._replace(args=packed.replace("16B", "16L"))]
        low = np.asarray(image)
    return high * np.uint16(256) + low


_PLAIN = ("1", "L", "LA", "I;16", "I", "F", "RGB", "RGBA")


def _colours(image: Image.Image) -> str:
    return "RGBA" if "transparency" in image.info else "RGB"
