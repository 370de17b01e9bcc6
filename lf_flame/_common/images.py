"""Image files as pixels: TIFF by tifffile and imagecodecs, other formats by Pillow.

A file names no other file that would be opened, and its declared size is compared with the memory
limit before it is decoded.
"""

import io
import re
import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from math import prod
from pathlib import PurePath
from typing import IO

import numpy as np
import tifffile
from PIL import Image, ImageFile

from lf_flame._common.input_files import PackedFile, Source, open_bytes, readable
from lf_flame._common.memory import check_memory
from lf_flame.errors import InputError

TIFF_SUFFIXES = (".tif", ".tiff")

TIFF_STARTS = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
"""First bytes of TIFF files, which Pillow alone does not read completely."""

FORMATS = ("PNG", "JPEG", "BMP", "WEBP", "PPM")
"""Formats that Pillow may detect, whatever the file's name. For a PostScript file Pillow would
start Ghostscript; other formats are not needed."""

ANIMATED = ("PNG", "WEBP")
"""Formats that may hold a film; other pictures in a JPEG file are previews."""

PILLOW_ERRORS = (
    OSError, SyntaxError, ValueError, TypeError, LookupError, ArithmeticError, EOFError,
    NotImplementedError, struct.error, zlib.error, Image.DecompressionBombError,
    Image.DecompressionBombWarning,
)  # fmt: skip
"""Exceptions of Pillow's decoders for damaged files; the last two are for decompression bombs, the
warning where warnings are errors."""

TIFF_ERRORS = (
    *PILLOW_ERRORS, tifffile.TiffFileError, AttributeError, AssertionError, RuntimeError,
    ImportError,
)  # fmt: skip
"""Exceptions of tifffile and imagecodecs for damaged files."""

FLOAT = np.dtype(np.float32).itemsize
"""Number of bytes of a float32 value, the type of a light field's pixels."""

PER_VALUE = 2 * FLOAT + 1
"""Number of bytes per value while an image becomes a light field: the floats, their copy in the
order of views, and whether each is finite; decoding takes less."""

PLAIN = ("1", "L", "LA", "I;16", "I", "F", "RGB", "RGBA")
"""Pillow's modes that need no conversion: grey or RGB, with transparency or without."""

DEEP_PNG = ("RGB;16B", "RGBA;16B", "LA;16B")
"""Kinds of PNG whose low bytes Pillow would drop."""

ORIENTATION = 0x0112
"""Tag of the orientation in which a picture is shown, in TIFF and EXIF."""

GREY, INVERTED_GREY, RGB, YCBCR, LINEAR_RAW = 1, 0, 2, 6, 34892
"""Accepted meanings of samples (PhotometricInterpretation), from TIFF 6.0 and DNG 1.4."""

JPEG = 7
"""Number of the compression by JPEG, which alone stores YCbCr colours that are turned into RGB."""

COMPRESSIONS = (1, 2, 3, 4, 5, JPEG, 8, 32773, 32946, 34925, 50000)
"""Numbers of the accepted compressions: none, three fax codes, LZW, JPEG, DEFLATE, PackBits,
DEFLATE again, LZMA and Zstandard. None of them unpacks more than the declared size."""

TRANSPARENCY = 2
"""Value of ExtraSamples for transparency by which the colours are not multiplied."""

REDUCED, MASK = 1, 4
"""Bits of NewSubfileType: smaller version of another picture, and mask of transparency."""


def read_pixels(path: Source) -> np.ndarray:
    """Read an image file at full bit depth: (h, w) or (h, w, channels), in its shown orientation.

    Levels are as stored, 0 is black; those of depths other than 1, 8 and 16 bits are divided by the
    highest, float32. Transparency is a last channel, the pages of a stack are a first axis.
    """
    if is_tiff(path):
        return _rows_first(*_read_tiff(path))
    with readable(path, PILLOW_ERRORS), open_image(path, FORMATS) as image:
        _check_colours(image, path)
        check_memory(prod(image.size) * len(image.getbands()) * PER_VALUE, path)
        if image.format == "PPM" and _is_deep(image):
            return _read_netpbm(image, path)
        if image.format == "PNG":
            with open_image(path, ("PNG",)) as again:
                again.verify()  # Pillow's decoder does not compare the checksums
        if image.format == "PNG" and image.tile[0].args in DEEP_PNG:
            return _read_deep_png(image, path)
        colours = "RGBA" if "transparency" in image.info else "RGB"
        pixels = np.asarray(image if image.mode in PLAIN else image.convert(colours))
        return oriented(pixels, image.getexif().get(ORIENTATION, 1))


def read_shape(path: Source) -> tuple[int, int, int]:
    """Rows, columns and channels of an image, from its header alone."""
    if is_tiff(path):
        with open_tiff(path) as file:
            page, values = (one := pictures(file, path)[0]).keyframe, prod(one.shape)
        rows, columns = page.imagelength, page.imagewidth
        return rows, columns, values // max(rows * columns, 1)
    with readable(path, PILLOW_ERRORS), open_image(path, FORMATS) as image:
        colours = 3 if image.mode == "P" else len(image.getbands())
        return image.height, image.width, colours


def check_levels(pixels: np.ndarray, source: Source) -> None:
    """Refuse values other than unsigned integers of 8 or 16 bits and floats."""
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


def oriented(pixels: np.ndarray, orientation: int, rows: int = 0) -> np.ndarray:
    """Turn a picture, with its axis of rows, to its orientation, 1 to 8 (EXIF 2.32, TIFF 6.0)."""
    axes = (rows, rows + 1)
    if orientation in (5, 6, 7, 8):
        pixels = np.swapaxes(pixels, *axes)
    turned = {2: (1,), 3: (0, 1), 4: (0,), 6: (1,), 7: (0, 1), 8: (0,)}.get(orientation, ())
    return np.flip(pixels, tuple(axes[k] for k in turned))


# TIFF ---------------------------------------------------------------------------------------------


class _Apart(io.FileIO):
    """A file without a descriptor: tifffile opens other files only if there is one."""

    def fileno(self) -> int:
        raise io.UnsupportedOperation("other files are not opened")


@contextmanager
def open_tiff(path: Source) -> Iterator[tifffile.TiffFile]:
    """Open a TIFF file; other files that it names are not opened."""
    with readable(path, TIFF_ERRORS):
        stream: IO[bytes] = (
            open_bytes(path) if isinstance(path, PackedFile) else io.BufferedReader(_Apart(path))
        )
        with stream, tifffile.TiffFile(stream) as file:
            yield file


def read_tiff(path: Source) -> np.ndarray:
    """Read the pictures of a TIFF file with the axes of the file; see `read_pages` for errors."""
    return _read_tiff(path)[0]


def _read_tiff(path: Source) -> tuple[np.ndarray, str]:
    """Read the pictures of a TIFF file, and the letters of their axes; axes of length 1 go."""
    with open_tiff(path) as file:
        pixels, axes = read_pages(pictures(file, path), path)
    keep = [k for k, axis in enumerate(axes) if axis in "YX" or pixels.shape[k] > 1]
    return pixels.reshape([pixels.shape[k] for k in keep]), "".join(axes[k] for k in keep)


def pictures(file: tifffile.TiffFile, path: Source) -> list[tifffile.TiffPageSeries]:
    """Series of an open TIFF file that are the picture in full resolution, or its like pages.

    A file may begin with a thumbnail, and hold the picture behind it or in a SubIFD of it (DNG);
    NewSubfileType says so. Smaller pictures behind the first are left out. A file that does not
    say which of its pictures is meant is refused.
    """
    if not file.series:
        raise InputError(f"{path} cannot be read: it is damaged, or holds no picture.")
    whole = [one for one in file.series if not one.keyframe.subfiletype & (REDUCED | MASK)]
    if not whole:
        inside = [page for one in file.series for page in one.keyframe.pages or ()]
        whole = [
            tifffile.TiffPageSeries([page], parent=file)
            for page in inside
            if isinstance(page, tifffile.TiffPage) and not page.subfiletype & (REDUCED | MASK)
        ]
    if not whole and len(file.series) == 1:
        whole = file.series[:1]  # nothing else could be meant
    if not whole:
        raise InputError(
            f"{path} holds {len(file.series)} pictures, all declared as smaller versions or masks "
            f"of another one: store the picture itself."
        )
    first, *others = whole
    alike = [one for one in others if (one.shape, one.dtype) == (first.shape, first.dtype)]
    size = first.keyframe.imagelength * first.keyframe.imagewidth
    for one in others:
        if one not in alike and one.keyframe.imagelength * one.keyframe.imagewidth >= size:
            raise InputError(
                f"{path} holds pictures of different forms, {first.shape} of {first.dtype} and "
                f"{one.shape} of {one.dtype}, and does not say which of them is a thumbnail: "
                f"store one."
            )
    return [first, *alike]


def read_pages(series: list[tifffile.TiffPageSeries], path: Source) -> tuple[np.ndarray, str]:
    """Read series of like pages, if all of them fit into memory as floats.

    Grey levels that count from white are inverted, levels that do not fill whole bytes become
    fractions of the highest, and pictures are turned to their shown orientation. The letters of
    the axes are I for the series, then tifffile's, with axes of length 1.
    """
    itemsize = series[0].dtype.itemsize
    check_memory(
        sum(prod(one.shape) for one in series) * max(PER_VALUE, 2 * itemsize + FLOAT), path
    )
    arrays = [_decode(one, path) for one in series]
    pixels = arrays[0][None] if len(arrays) == 1 else np.stack(arrays)
    axes = "I" + series[0].get_axes(squeeze=False)
    if len(axes) != pixels.ndim or axes.count("Y") != 1 or axes.count("X") != 1:
        raise InputError(
            f"{path} must hold pictures of rows and columns, got axes {axes[1:]!r} of shape "
            f"{pixels.shape[1:]}."
        )
    return pixels, axes


def transparency(page: tifffile.TiffPage) -> bool:
    """Whether the last sample of a page is its transparency."""
    return tuple(page.extrasamples) == (TRANSPARENCY,)


def _decode(series: tifffile.TiffPageSeries, path: Source) -> np.ndarray:
    """Decode a series, [page axes, rows, columns, samples] or as its axes say."""
    if any(page is None for page in series.pages):
        raise InputError(
            f"{path} names other files as the place of some of its pages, and these are not "
            f"opened: store all pages in one file."
        )
    page = series.keyframe
    _check_light(page, path)
    _check_packing(page, path)
    pixels = series.asarray(squeeze=False)
    inverted = "PhotometricInterpretation" in page.tags and page.photometric == INVERTED_GREY
    bits = page.bitspersample
    bits = max(bits) if isinstance(bits, tuple) else int(bits)
    if inverted:
        if pixels.dtype.kind not in "bu":
            raise InputError(
                f"{path} counts from white, but holds {pixels.dtype}: store it from black."
            )
        pixels = ~pixels if pixels.dtype.kind == "b" else pixels.dtype.type(2**bits - 1) - pixels
    if pixels.dtype.kind == "u" and bits < 8 * pixels.dtype.itemsize:
        pixels = pixels / np.float32(2**bits - 1)
    orientation = page.tags.get(ORIENTATION)
    rows = series.get_axes(squeeze=False).find("Y")
    return oriented(pixels, orientation.value if orientation and rows >= 0 else 1, rows)


def _check_light(page: tifffile.TiffPage, path: Source) -> None:
    """Refuse samples that are not light, and of which the last has no stated meaning."""
    meaning = int(page.photometric) if "PhotometricInterpretation" in page.tags else GREY
    known = (GREY, INVERTED_GREY, RGB, LINEAR_RAW) + (YCBCR,) * (page.compression == JPEG)
    if meaning not in known:
        name = getattr(page.photometric, "name", str(meaning))
        raise InputError(
            f"{path} holds no grey or RGB light but {name} (photometric interpretation {meaning}): "
            f"convert it."
        )
    if page.samplesperpixel in (2, 4) and not transparency(page):
        raise InputError(
            f"{path} has {page.samplesperpixel} samples to a pixel, and does not say that the last "
            f"is a plain transparency (extra samples {[int(n) for n in page.extrasamples]}): "
            f"store it in grey or RGB."
        )


def _check_packing(page: tifffile.TiffPage, path: Source) -> None:
    """Refuse compressions that could unpack more than the page declares."""
    if int(page.compression) not in COMPRESSIONS:
        name = getattr(page.compression, "name", "unknown")
        raise InputError(
            f"{path} is packed by compression {int(page.compression)} ({name}), which is not read: "
            f"store it with DEFLATE, LZW or without compression."
        )
    if page.compression == JPEG:  # each part states a size of its own
        handle = page.parent.filehandle
        for start, count in zip(page.dataoffsets, page.databytecounts, strict=True):
            handle.seek(start)
            with Image.open(io.BytesIO(handle.read(count)), formats=("JPEG",)) as part:
                check_memory(prod(part.size) * page.samplesperpixel * PER_VALUE, path)


def is_tiff(path: Source) -> bool:
    """Whether a file is TIFF, by its ending or its first bytes."""
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
    places = {"Y": 1, "X": 2, "S": 3}
    if "C" in axes and pixels.shape[axes.index("C")] in (1, 3):
        places["C"] = 3
    return pixels.transpose(sorted(range(len(axes)), key=lambda k: places.get(axes[k], 0)))


# Other formats ------------------------------------------------------------------------------------


def open_image(path: Source, formats: tuple[str, ...]) -> ImageFile.ImageFile:
    """Open an image with Pillow; the caller closes it."""
    return Image.open(open_bytes(path) if isinstance(path, PackedFile) else path, formats=formats)


def _check_colours(image: ImageFile.ImageFile, path: Source) -> None:
    if image.mode not in (*PLAIN, "P", "PA", "YCbCr"):
        raise InputError(
            f"{path} holds no light but {image.mode}: convert it to grey or RGB (inks need the "
            f"printer's profile)."
        )
    frames = getattr(image, "n_frames", 1)
    if frames > 1 and image.format in ANIMATED:
        raise InputError(f"{path} holds {frames} pictures that follow each other: store one.")


def _read_deep_png(image: ImageFile.ImageFile, path: Source) -> np.ndarray:
    """Decode 16-bit colour by imagecodecs (libpng)."""
    from imagecodecs import PngError, png_decode

    with readable(path, (PngError,)), open_bytes(path) as file:
        return oriented(png_decode(file.read()), image.getexif().get(ORIENTATION, 1))


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
