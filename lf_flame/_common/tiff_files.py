"""TIFF files: no other file is opened, and levels are converted so that 0 is black."""

import io
import struct
import sys
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from math import prod
from typing import IO, Any

import numpy as np
import tifffile
from PIL import Image, ImageFile

from lf_flame._common.input_files import PackedFile, Source, open_bytes, readable
from lf_flame._common.memory import check_memory
from lf_flame.errors import InputError

TIFF_SUFFIXES = (".tif", ".tiff")

TIFF_ERRORS = (
    tifffile.TiffFileError, OSError, ValueError, TypeError, LookupError, ArithmeticError, EOFError,
    AttributeError, AssertionError, NotImplementedError, RuntimeError, SyntaxError, struct.error,
    zlib.error,
)  # fmt: skip
"""Exceptions of tifffile, Pillow and their decoders for damaged files."""

FLOAT = np.dtype(np.float32).itemsize
"""Number of bytes of a float32 value, the type of a light field's pixels."""

GREY, INVERTED_GREY, RGB, YCBCR, LINEAR_RAW = 1, 0, 2, 6, 34892
"""Accepted meanings of samples (PhotometricInterpretation), from TIFF 6.0 and DNG 1.4."""

PLANAR_CONFIGURATION, PLANES_APART = 284, 2
"""Tag that says where the samples of a pixel lie, and its value for planes of their own."""

SUBSAMPLING = 530
"""Tag that says how many pixels share their colour (YCbCrSubSampling)."""

TRANSPARENCY = 2
"""Value of ExtraSamples for transparency by which the colours are not multiplied."""


class _Apart(io.FileIO):
    """A file without a descriptor: tifffile opens other files only if there is one."""

    def fileno(self) -> int:
        raise io.UnsupportedOperation("other files are not opened")


def _apart(path: Source) -> IO[bytes]:
    """Open a file so that tifffile opens no other one beside it."""
    if isinstance(path, PackedFile):
        return open_bytes(path)
    return io.BufferedReader(_Apart(path))


def open_image(path: Source, formats: tuple[str, ...]) -> ImageFile.ImageFile:
    """Open an image with Pillow; the caller closes it."""
    return Image.open(open_bytes(path) if isinstance(path, PackedFile) else path, formats=formats)


@contextmanager
def open_tiff(path: Source) -> Iterator[tifffile.TiffFile]:
    """Open a TIFF file; other files that it names are not opened.

    Yields
    ------
    tifffile.TiffFile

    Raises
    ------
    InputError
        If it is not a regular file, or not a readable TIFF file.
    """
    with (
        readable(path, TIFF_ERRORS),
        _apart(path) as stream,
        tifffile.TiffFile(stream) as file,
    ):
        yield file


def read_tiff(path: Source) -> np.ndarray:
    """Read the first image series of a TIFF file, with the axes of the file.

    Raises
    ------
    InputError
        If it cannot be read (`read_series`).
    """
    with open_tiff(path) as file:
        return read_series(file.series[:1], path)[0]


def read_series(
    series: list[tifffile.TiffPageSeries], path: Source, **options: bool
) -> list[np.ndarray]:
    """Read image series of an open TIFF file, if all of them fit into memory as floats.

    Grey levels that count from white are inverted, levels that do not fill whole bytes become
    fractions of the highest, and pictures are turned to their shown orientation.

    Parameters
    ----------
    series : list of tifffile.TiffPageSeries
    path : str or Path or PackedFile
        The file, for messages and for a second decoder.
    **options
        Options of `tifffile.TiffPageSeries.asarray`.

    Raises
    ------
    InputError
        If a page is in another file, its samples are not light, or memory does not suffice.
    """
    need = sum(prod(one.shape) * (np.dtype(one.dtype).itemsize + FLOAT) for one in series)
    check_memory(need, path)
    return [_decode(one, path, options) for one in series]


def transparency(page: tifffile.TiffPage) -> bool:
    """Whether the last sample of a page is its transparency."""
    return tuple(page.extrasamples) == (TRANSPARENCY,)


def oriented(pixels: np.ndarray, orientation: int, rows: int = 0) -> np.ndarray:
    """Turn a picture to its shown orientation; EXIF 2.32 and TIFF 6.0, Orientation.

    Parameters
    ----------
    pixels : ndarray
    orientation : int
        Orientation from 1 to 8; any other number counts as 1, not turned.
    rows : int, optional
        Index of the axis of rows; the axis of columns follows it.
    """
    axes = (rows, rows + 1)
    if orientation in (5, 6, 7, 8):
        pixels = np.swapaxes(pixels, *axes)
    turned = {2: (1,), 3: (0, 1), 4: (0,), 6: (1,), 7: (0, 1), 8: (0,)}.get(orientation, ())
    return np.flip(pixels, tuple(axes[k] for k in turned))


def _decode(series: tifffile.TiffPageSeries, path: Source, options: dict) -> np.ndarray:
    """Decode a series with tifffile, or with Pillow if tifffile cannot."""
    if any(page is None for page in series.pages):
        raise InputError(
            f"{path} names other files as the place of some of its pages, and these are not "
            f"opened: store all pages in one file."
        )
    page = series.keyframe
    meaning = _meaning(page, path)
    bits, axes = _bits(page), _axes(series, options)
    if "Y" not in axes:
        raise InputError(
            f"{path} must hold pictures of rows and columns, got shape {tuple(series.shape)}."
        )
    rows = axes.index("Y")
    try:
        if meaning == YCBCR:
            return _by_pillow(series, path, options)
        pixels = series.asarray(**options)
    except (*TIFF_ERRORS, ImportError) as error:
        wanting = isinstance(error, ImportError)  # of a decoder that newer Pythons have
        if not wanting and not any(w in str(error) for w in ("imagecodecs", "not supported")):
            raise
        try:
            pixels = _by_pillow(series, path, options)
        except (*TIFF_ERRORS, Image.DecompressionBombError):
            raise InputError(
                f"{path} is damaged, or packed in a way (compression {int(page.compression)}, "
                f"{bits} bits) that needs another package: pip install imagecodecs, or store it "
                f"without compression."
            ) from None
        turned = pixels.dtype != np.uint16  # Pillow itself inverts other levels
        return _fractions(pixels, max(bits, 8), meaning == INVERTED_GREY and not turned, path)
    orientation = page.tags.get("Orientation")
    pixels = _fractions(pixels, bits, meaning == INVERTED_GREY, path)
    return oriented(pixels, orientation.value if orientation else 1, rows)


def _meaning(page: tifffile.TiffPage, path: Source) -> int:
    """Meaning of a page's samples (PhotometricInterpretation); refused if it is not light."""
    meaning = int(page.photometric) if "PhotometricInterpretation" in page.tags else GREY
    if meaning not in (GREY, INVERTED_GREY, RGB, YCBCR, LINEAR_RAW):
        name = getattr(page.photometric, "name", str(meaning))
        raise InputError(
            f"{path} holds no light but {name} (photometric interpretation {meaning}): convert it "
            f"to grey or RGB."
        )
    if page.samplesperpixel in (2, 4) and not transparency(page):
        raise InputError(
            f"{path} has {page.samplesperpixel} samples to a pixel, and does not say that the last "
            f"is a plain transparency (extra samples {[int(n) for n in page.extrasamples]}): "
            f"store it in grey or RGB."
        )
    return meaning


def _bits(page: tifffile.TiffPage) -> int:
    bits = page.bitspersample
    return max(bits) if isinstance(bits, tuple) else int(bits)


def _fractions(pixels: np.ndarray, bits: int, inverted: bool, path: Source) -> np.ndarray:
    """Invert levels that count from white, and divide those of other depths by the highest."""
    if inverted and pixels.dtype.kind not in "bu":
        raise InputError(
            f"{path} counts from white, but holds {pixels.dtype}: store it from black."
        )
    if pixels.dtype.kind == "b":
        return ~pixels if inverted else pixels
    if inverted:
        pixels = pixels.dtype.type(2**bits - 1) - pixels
    if pixels.dtype.kind == "u" and bits < 8 * pixels.dtype.itemsize:
        return pixels / np.float32(2**bits - 1)
    return pixels


def _axes(series: tifffile.TiffPageSeries, options: dict) -> str:
    return series.get_axes(**options) if options else series.axes


def _by_pillow(series: tifffile.TiffPageSeries, path: Source, options: dict) -> np.ndarray:
    """Decode the pages of a series with Pillow's libtiff, which applies the orientation."""
    shape = list(series.get_shape(**options) if options else series.shape)
    axes = _axes(series, options)
    pages = np.stack([_pillow_page(path, page.index) for page in series.pages if page])
    if "S" in axes and axes.index("S") < axes.index("Y"):
        pages = np.moveaxis(pages, -1, 1)
        height, width = pages.shape[2:4]
    else:
        height, width = pages.shape[1:3]
    shape[axes.index("Y")], shape[axes.index("X")] = height, width
    return pages.reshape(shape)


def _pillow_page(path: Source, index: int) -> np.ndarray:
    """Decode a page at full bit depth.

    Pillow keeps the high byte of 16-bit colours. A second decoding, with the opposite byte order
    stated, keeps the low byte; of colours in planes of their own it does not.
    """
    with open_image(path, ("TIFF",)) as image:
        image.seek(index)
        tile: Any = image.tile[0]
        rawmode, tags = str(tile.args[0]), getattr(image, "tag_v2", {})
        # libtiff gives RGB for what it unpacks.
        if image.mode == "YCbCr" and tags.get(SUBSAMPLING) != (1, 1):
            raise NotImplementedError("colours that several pixels share are not supported")
        high = np.asarray(image.convert("RGB") if image.mode == "YCbCr" else image)
    colours, _, depth = rawmode.partition(";16")
    if colours not in ("RGB", "RGBA") or not depth:
        return high
    if tags.get(PLANAR_CONFIGURATION) == PLANES_APART:
        raise NotImplementedError("16-bit colours in planes of their own")
    with open_image(path, ("TIFF",)) as image:
        image.seek(index)
        tile = image.tile[0]
        other = colours + {"little": ";16B", "big": ";16L"}[sys.byteorder]
        image.tile = [tile._replace(args=(other, *tile.args[1:]))]
        low = np.asarray(image)
    return high * np.uint16(256) + low
