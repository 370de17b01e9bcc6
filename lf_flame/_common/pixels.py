"""Pixels of image files, read by decoders that open no other file."""

import re
import struct
import zlib
from math import prod
from pathlib import PurePath

import numpy as np
from PIL import Image, ImageFile

from lf_flame._common.input_files import Source, open_bytes, readable
from lf_flame._common.memory import check_memory
from lf_flame._common.tiff_files import (
    FLOAT,
    TIFF_SUFFIXES,
    open_image,
    open_tiff,
    oriented,
    read_series,
)
from lf_flame.errors import InputError

FORMATS = ("PNG", "JPEG", "BMP", "WEBP", "PPM")
"""Formats that Pillow may detect, whatever the file's name. For a PostScript file Pillow would
start Ghostscript; other formats are not needed."""

ANIMATED = ("PNG", "WEBP")
"""Formats that may hold a film. Of a JPEG file the other pictures are previews."""

TIFF_STARTS = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
"""First bytes of TIFF files, which Pillow alone does not read completely."""

PILLOW_ERRORS = (
    OSError, SyntaxError, ValueError, TypeError, LookupError, ArithmeticError, EOFError,
    NotImplementedError, struct.error, zlib.error, Image.DecompressionBombError,
    Image.DecompressionBombWarning,
)  # fmt: skip
"""Exceptions of Pillow's decoders for damaged files; the last two are for decompression bombs, the
warning where warnings are errors."""

PLAIN = ("1", "L", "LA", "I;16", "I", "F", "RGB", "RGBA")
"""Pillow's modes that need no conversion: grey or RGB, with transparency or without."""

ORIENTATION = 0x0112
"""EXIF tag of the orientation in which a picture is shown."""


def read_pixels(path: Source) -> np.ndarray:
    """Read an image file at full bit depth, with its transparency, in its shown orientation.

    Parameters
    ----------
    path : str or Path or PackedFile
        TIFF file by its ending, else one of FORMATS by its content.

    Returns
    -------
    ndarray, shape (h, w) or (h, w, channels)
        Levels as stored, 0 is black. Levels of depths other than 1, 8 and 16 bits are divided by
        the highest, float32.

    Raises
    ------
    InputError
        If the file is missing or damaged, is not an image of these formats, is neither grey
        nor RGB, or needs too much memory.
    """
    if _is_tiff(path):
        with open_tiff(path) as file:
            return _rows_first(read_series(file.series[:1], path)[0], file.series[0].axes)
    with readable(path, PILLOW_ERRORS), open_image(path, FORMATS) as image:
        _check_colours(image, path)
        check_memory(prod(image.size) * len(image.getbands()) * 2 * FLOAT, path)
        if image.format == "PPM" and _is_deep(image):
            return _read_netpbm(image, path)
        if image.format == "PNG":
            return _read_png(image, path)
        return _decode(image)


def read_shape(path: Source) -> tuple[int, int, int]:
    """Rows, columns and channels of an image, from its header alone.

    Raises
    ------
    InputError
        If the file is missing, or is not an image of these formats.
    """
    if _is_tiff(path):
        with open_tiff(path) as file:
            page, values = file.series[0].keyframe, prod(file.series[0].shape)
        rows, columns = page.imagelength, page.imagewidth
        return rows, columns, values // max(rows * columns, 1)
    with readable(path, PILLOW_ERRORS), open_image(path, FORMATS) as image:
        colours = 3 if image.mode == "P" else len(image.getbands())
        return image.height, image.width, colours


def check_levels(pixels: np.ndarray, source: Source) -> None:
    """Refuse values other than unsigned integers of 8 or 16 bits and floats.

    Raises
    ------
    InputError
        If the type is another one; the message names the source.
    """
    kind = pixels.dtype.kind
    if kind not in "bf" and not (kind == "u" and pixels.dtype.itemsize <= 2):
        raise InputError(
            f"{source} must hold unsigned integers of 8 or 16 bits, or floats, got {pixels.dtype}."
        )


def to_unit(pixels: np.ndarray, source: Source) -> np.ndarray:
    """Scale unsigned levels of 8 or 16 bits to 0 to 1; floats stay as they are; float32."""
    check_levels(pixels, source)
    if pixels.dtype.kind == "u":
        return pixels / np.float32(np.iinfo(pixels.dtype).max)
    with np.errstate(over="ignore"):  # the light field refuses infinite values
        return pixels.astype(np.float32, copy=False)


def _is_tiff(path: Source) -> bool:
    """Whether a file is TIFF by its ending or its first bytes."""
    if PurePath(str(path)).suffix.lower() in TIFF_SUFFIXES:
        return True
    with readable(path, (OSError,)), open_bytes(path) as file:
        return file.read(4) in TIFF_STARTS


def _rows_first(pixels: np.ndarray, axes: str) -> np.ndarray:
    """Bring the axes of a picture into the order of rows, columns and channels.

    A TIFF file may store one image for each channel, or say that its rows are columns. Axes of
    other meaning stay in front: pages are no colours, and of two or four channels none is said to
    be the transparency.
    """
    if len(axes) != pixels.ndim or "X" not in axes:
        return pixels
    places = {"Y": 1, "X": 2, "S": 3}
    if "C" in axes and pixels.shape[axes.index("C")] in (1, 3):
        places["C"] = 3
    return pixels.transpose(sorted(range(len(axes)), key=lambda k: places.get(axes[k], 0)))


def _check_colours(image: Image.Image, path: Source) -> None:
    if image.mode not in (*PLAIN, "P", "PA", "YCbCr"):
        raise InputError(
            f"{path} holds no light but {image.mode}: convert it to grey or RGB (inks need the "
            f"printer's profile)."
        )
    frames = getattr(image, "n_frames", 1)
    if frames > 1 and image.format in ANIMATED:
        raise InputError(f"{path} holds {frames} pictures that follow each other: store one.")


def _decode(image: Image.Image) -> np.ndarray:
    """Decode an open image in its shown orientation."""
    colours = "RGBA" if "transparency" in image.info else "RGB"
    pixels = np.asarray(image if image.mode in PLAIN else image.convert(colours))
    return oriented(pixels, image.getexif().get(ORIENTATION, 1))


def _read_png(image: ImageFile.ImageFile, path: Source) -> np.ndarray:
    """Read a PNG at full bit depth, after a check of its checksums.

    For 16-bit colour Pillow's decoder keeps only the high byte of each level. With the opposite
    byte order stated it keeps the low byte, so two decodings give both.
    """
    with open_image(path, ("PNG",)) as again:
        again.verify()  # Pillow's decoder does not check
    packed = image.tile[0].args
    if packed == "LA;16B":
        raise InputError(f"{path} has 16-bit grey with transparency: store it without.")
    high = _decode(image)
    if packed not in ("RGB;16B", "RGBA;16B"):
        return high
    with open_image(path, ("PNG",)) as again:
        again.tile = [again.tile[0]._replace(args=str(packed).replace("16B", "16L"))]
        low = _decode(again)
    return high * np.uint16(256) + low


def _is_deep(image: ImageFile.ImageFile) -> bool:
    """Whether a Netpbm file is text, or holds levels that Pillow would round."""
    codec, _, _, args = image.tile[0]
    return image.mode in ("L", "I", "RGB") and (codec != "raw" or args == "I;16B")


def _read_netpbm(image: ImageFile.ImageFile, path: Source) -> np.ndarray:
    """Read PGM and PPM of any maximum, text or binary, after Pillow has read the header."""
    codec, _, offset, args = image.tile[0]
    highest = args[-1] if isinstance(args, tuple) else 65535
    shape = (image.height, image.width, *([3] if image.mode == "RGB" else []))
    with open_bytes(path) as file:
        file.seek(offset)
        if codec == "ppm_plain":
            words = re.sub(rb"#[^\r\n]*", b" ", file.read()).split(None, prod(shape))
            levels = np.array(words[: prod(shape)], np.bytes_).astype(np.float32)
        else:
            kind = np.dtype(np.uint8 if highest < 256 else ">u2")
            levels = np.frombuffer(file.read(prod(shape) * kind.itemsize), kind)
    if levels.size < prod(shape) or not 0 <= levels.min() <= levels.max() <= highest:
        raise InputError(
            f"{path} cannot be read: it is damaged, and must hold {prod(shape)} levels from 0 to "
            f"{highest}."
        )
    return levels.reshape(shape) / np.float32(highest)
