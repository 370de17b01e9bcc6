"""Pixels of image files, by decoders that only decode."""

import struct
import zlib
from math import prod
from pathlib import Path

import numpy as np
import tifffile
from PIL import Image

from lf_flame._common.input_files import readable
from lf_flame._common.memory import check_memory
from lf_flame.errors import InputError

TIFF_SUFFIXES = (".tif", ".tiff")

FORMATS = ("PNG", "JPEG", "BMP", "WEBP", "PPM", "TIFF")
"""What Pillow may take a file for, whatever its name. Of a PostScript file it would start
Ghostscript; other formats are not needed."""


PILLOW_ERRORS = (
    OSError, SyntaxError, ValueError, TypeError, LookupError, ArithmeticError, EOFError,
    NotImplementedError, struct.error, zlib.error, Image.DecompressionBombError,
    Image.DecompressionBombWarning,
)  # fmt: skip
"""What Pillow's decoders raise at damaged files; of bombs the last two, a warning where warnings
are errors."""

TIFF_ERRORS = (
    tifffile.TiffFileError, OSError, ValueError, TypeError, LookupError, ArithmeticError, EOFError,
    AttributeError, AssertionError, NotImplementedError, RuntimeError, struct.error, zlib.error,
)  # fmt: skip
"""What tifffile and its decoders raise at damaged files."""

FLOAT = np.dtype(np.float32).itemsize
"""Bytes of a pixel's value in a light field."""


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
        If the file is missing or damaged, is no image of these formats, or needs too much memory.
    """
    if Path(path).suffix.lower() in TIFF_SUFFIXES:
        with readable(path, TIFF_ERRORS), tifffile.TiffFile(path) as file:
            return _channels_last(read_series(file.series[:1], path)[0])
    return _read_pillow(path)


def read_series(
    series: list[tifffile.TiffPageSeries], path: str | Path, **options: bool
) -> list[np.ndarray]:
    """Read series of an open TIFF file, if there is memory for all of them as floats.

    Parameters
    ----------
    series : list of tifffile.TiffPageSeries
    path : str or Path
        For the message.
    **options
        Of `tifffile.TiffPageSeries.asarray`.
    """
    need = sum(prod(one.shape) * (np.dtype(one.dtype).itemsize + FLOAT) for one in series)
    check_memory(need, path)
    return [one.asarray(**options) for one in series]


def _channels_last(pixels: np.ndarray) -> np.ndarray:
    """Bring the channels to the end, which a TIFF file may store one after the other."""
    planar = pixels.ndim == 3 and pixels.shape[0] in (3, 4) and pixels.shape[2] not in (3, 4)
    return np.moveaxis(pixels, 0, -1) if planar else pixels


def _read_pillow(path: str | Path) -> np.ndarray:
    """Read an image in full depth.

    Of 16-bit colour in PNG, Pillow's decoder keeps the high byte of each level. Told that the bytes
    stand the other way round, it keeps the low one.
    """
    with readable(path, PILLOW_ERRORS), Image.open(path, formats=FORMATS) as image:
        tiles = image.tile
        packed = tiles[0].args if image.format == "PNG" else ""
        if packed == "LA;16B":
            raise InputError(f"{path} has 16-bit grey with transparency: store it without.")
        check_memory(prod(image.size) * len(image.getbands()) * 2 * FLOAT, path)
        high = np.asarray(image if image.mode in _PLAIN else image.convert(_colours(image)))
    if packed not in ("RGB;16B", "RGBA;16B"):
        return high
    with readable(path, PILLOW_ERRORS), Image.open(path, formats=("PNG",)) as image:
        image.tile = [tiles[0]._replace(args=packed.replace("16B", "16L"))]
        low = np.asarray(image)
    return high * np.uint16(256) + low


_PLAIN = ("1", "L", "LA", "I;16", "I", "F", "RGB", "RGBA")


def _colours(image: Image.Image) -> str:
    return "RGBA" if "transparency" in image.info else "RGB"
