"""Image files as pixels: TIFF by tifffile and imagecodecs, PNG by imagecodecs, others by Pillow.

A file names no other file that would be opened, and its declared size is compared with the memory
limit before it is decoded.
"""

import io
from collections.abc import Iterator
from contextlib import contextmanager
from math import prod
from pathlib import Path
from typing import Any

import imagecodecs
import numpy as np
import tifffile
from PIL import Image, ImageFile
from tifffile import COMPRESSION, EXTRASAMPLE, PHOTOMETRIC

from lf_flame._common.input_files import check_memory, readable
from lf_flame.errors import InputError

TIFF_SUFFIXES = (".tif", ".tiff")

FLOAT = np.dtype(np.float32).itemsize
"""Number of bytes of a float32 value, the type of a light field's pixels."""

PER_VALUE = 2 * FLOAT + 1
"""Number of bytes per value while an image becomes a light field: the floats, their copy in the
order of views, and whether each is finite; decoding takes less."""

ORIENTATION = 0x0112
"""Tag of the orientation in which a picture is shown, in TIFF and EXIF."""

LIGHT = (PHOTOMETRIC.MINISBLACK, PHOTOMETRIC.RGB)
"""Accepted meanings of samples in TIFF 6.0; DNG's linear raw has a black level of its own."""

COMPRESSIONS = (
    COMPRESSION.NONE, COMPRESSION.LZW, COMPRESSION.DEFLATE, COMPRESSION.ADOBE_DEFLATE,
    COMPRESSION.PACKBITS, COMPRESSION.ZSTD,
)  # fmt: skip
"""Accepted compressions: none expands beyond the declared size, or ends early in silence."""

TRANSPARENCY = (EXTRASAMPLE.UNASSALPHA,)
"""Accepted meaning of a second or fourth sample: colours are not multiplied by it."""


def read_pixels(path: str | Path) -> np.ndarray:
    """Read an image file at full bit depth: (h, w) or (h, w, channels), as displayed.

    Levels are as stored, 0 is black; those of TIFF files of 12 bits and the like are divided by the
    highest, float32. Transparency is a last channel, the pages of a stack are first axes.
    """
    if is_tiff(path):
        return read_tiff(path)[0]
    with open_image(path) as image:
        if image.mode == "CMYK":
            raise InputError(
                f"{path} stores ink (CMYK), not light: convert it with the printer's profile."
            )
        if image.format == "PPM" and image.mode == "RGB" and top_level(image) > 255:
            # Pillow would keep 8 of the bits.
            raise InputError(f"{path} has colours of 16 bits, which are read from PNG and TIFF.")
        check_memory(prod(image.size) * _channels(image) * PER_VALUE, path)
        turn = image.getexif().get(ORIENTATION, 1)
        if image.format == "PNG":  # Pillow drops the low bytes of deep colours
            return oriented(imagecodecs.png_decode(Path(path).read_bytes()), turn)
        pixels = np.asarray(image.convert("RGB") if image.mode == "P" else image)
    return oriented(pixels.astype(np.uint16) if pixels.dtype == np.int32 else pixels, turn)


def read_shape(path: str | Path) -> tuple[int, int, int]:
    """Rows, columns and channels of an image, from its header alone."""
    if is_tiff(path):
        with open_tiff(path) as file:
            page, values = (one := pictures(file, path)[0]).keyframe, prod(one.shape)
        rows, columns = page.imagelength, page.imagewidth
        return rows, columns, values // max(rows * columns, 1)
    with open_image(path) as image:
        return image.height, image.width, _channels(image)


def _channels(image: ImageFile.ImageFile) -> int:
    return 3 if image.mode == "P" else len(image.getbands())


def to_unit(pixels: np.ndarray, source: str | Path) -> np.ndarray:
    """Scale unsigned levels of 8 or 16 bits to 0 to 1; floats stay as they are; float32."""
    kind = pixels.dtype.kind
    if kind not in "bf" and not (kind == "u" and pixels.dtype.itemsize <= 2):
        raise InputError(
            f"{source} must have unsigned integers of 8 or 16 bits, or floats, got {pixels.dtype}."
        )
    if kind == "u":
        return pixels / np.float32(np.iinfo(pixels.dtype).max)
    with np.errstate(over="ignore"):  # the light field refuses infinite values
        return pixels.astype(np.float32, copy=False)


def oriented(pixels: np.ndarray, orientation: int, rows: int = 0) -> np.ndarray:
    """Rotate or mirror a picture by its orientation, 1 to 8 (EXIF 2.32, TIFF 6.0)."""
    axes = (rows, rows + 1)
    if orientation in (5, 6, 7, 8):
        pixels = np.swapaxes(pixels, *axes)
    turned = {2: (1,), 3: (0, 1), 4: (0,), 6: (1,), 7: (0, 1), 8: (0,)}.get(orientation, ())
    return np.flip(pixels, tuple(axes[k] for k in turned))


@contextmanager
def open_image(path: str | Path) -> Iterator[ImageFile.ImageFile]:
    """Open an image by Pillow, in formats that start no other program, as PostScript would."""
    with readable(path), Image.open(path, formats=("PNG", "JPEG", "BMP", "WEBP", "PPM")) as image:
        yield image


def top_level(image: ImageFile.ImageFile) -> int:
    """Highest level of an open PNG or Netpbm file."""
    how = image.tile[0][3]
    return int(how[-1]) if isinstance(how, tuple) else 65535 if "16B" in str(how) else 255


# TIFF ---------------------------------------------------------------------------------------------


class _NoDescriptor(io.FileIO):
    """A file without a descriptor: tifffile opens other files only if there is one."""

    def fileno(self) -> int:
        raise io.UnsupportedOperation("other files are not opened")


def is_tiff(path: str | Path) -> bool:
    """Whether a file is TIFF, which Pillow alone does not read completely, by its first bytes."""
    with readable(path), Path(path).open("rb") as file:
        return file.read(4) in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")


@contextmanager
def open_tiff(path: str | Path) -> Iterator[tifffile.TiffFile]:
    """Open a TIFF file; other files that it names are not opened."""
    with (
        readable(path),
        io.BufferedReader(_NoDescriptor(path)) as stream,
        tifffile.TiffFile(stream) as file,
    ):
        yield file


def pictures(file: tifffile.TiffFile, path: str | Path) -> list[tifffile.TiffPageSeries]:
    """Series of an open TIFF file that are its picture in full resolution, or pictures of one form.

    Thumbnails and masks, which NewSubfileType declares, are left out.
    """
    if not file.series:
        raise InputError(f"{path} cannot be read: it is damaged, or contains no picture.")
    whole = [one for one in file.series if not (one.keyframe.is_reduced or one.keyframe.is_mask)]
    forms = {(one.keyframe.hash, one.shape): f"{one.shape} of {one.dtype}" for one in whole}
    if len(forms) != 1:
        raise InputError(
            f"{path} must contain one picture in full resolution, or several of one form, stored "
            f"alike, got {', '.join(sorted(forms.values())) or 'none'}: store one."
        )
    return whole


def find_axes(
    series: list[tifffile.TiffPageSeries], *, is_focal: bool = False
) -> tuple[str, list[int], list[int]]:
    """Letters of the axes of equal series, N first, and the places of page axes and image axes.

    Samples are channels. So are images for each colour (axis C): three, or two and four next to
    other pages or in a focal stack; other pages are not colours. Axes of length 1 are left out.
    """
    axes = "N" + series[0].get_axes(squeeze=False)
    lengths = (len(series), *series[0].get_shape(squeeze=False))
    pages = [k for k, n in enumerate(lengths) if n > 1 and axes[k] not in "YX"]
    counts = (2, 3, 4) if is_focal or len(pages) > 1 else (3,)
    fits = [k for k in pages if axes[k] == "C" and lengths[k] in counts]
    colours = ([k for k in pages if axes[k] == "S"] or fits)[:1]
    image = [axes.find("Y"), axes.find("X"), *colours]
    return axes, [k for k in pages if k not in colours], image


def read_tiff(path: str | Path, *, opaque: bool = False) -> tuple[np.ndarray, str, dict[str, Any]]:
    """Read the pictures of a TIFF file, if all of them fit into memory as floats.

    Returns pixels with the page axes, rows, columns and, if there are several, channels, without
    transparency if `opaque`; tifffile's letters of the page axes, with N for equal pictures that
    follow each other; ImageJ's metadata.
    """
    with open_tiff(path) as file:
        metadata, series = file.imagej_metadata or {}, pictures(file, path)
        page, itemsize = series[0].keyframe, series[0].dtype.itemsize
        values = sum(prod(one.shape) for one in series)
        check_memory(values * max(PER_VALUE, 2 * itemsize + FLOAT), path)
        _check_page(page, path)
        if any(page is None for one in series for page in one.pages):
            raise InputError(
                f"{path} refers to other files for some of its pages, and these are not "
                f"opened: store all pages in one file."
            )
        axes, pages, image = find_axes(series, is_focal="slopes" in metadata)
        if min(image) < 0:
            raise InputError(f"{path} must have pictures of rows and columns, got axes {axes!r}.")
        arrays = [x.asarray(squeeze=False).reshape(x.get_shape(squeeze=False)) for x in series]
    pixels = arrays[0][None] if len(arrays) == 1 else np.stack(arrays)
    bits = int(np.max(page.bitspersample))
    if pixels.dtype.kind == "u" and bits < 8 * itemsize:
        pixels = pixels / np.float32(2**bits - 1)
    kept = pages + image
    order = [k for k in range(len(axes)) if k not in kept] + kept
    pixels = pixels.transpose(order)
    pixels = pixels.reshape(pixels.shape[len(order) - len(kept) :])
    if orientation := page.tags.get(ORIENTATION):
        pixels = oriented(pixels, orientation.value, len(pages))
    if opaque and page.extrasamples == TRANSPARENCY:
        pixels = pixels[..., :-1]
    return pixels, "".join(axes[k] for k in pages), metadata


def _check_page(page: tifffile.TiffPage, path: str | Path) -> None:
    """Refuse samples that are not light, have no stated meaning, or use another compression."""
    known = page.photometric if "PhotometricInterpretation" in page.tags else LIGHT[0]
    if known not in LIGHT:
        raise InputError(
            f"{path} does not store grey or RGB light with black at 0, but "
            f"{getattr(known, 'name', '')} (photometric interpretation {int(known)}): convert it."
        )
    if page.samplesperpixel in (2, 4) and page.extrasamples != TRANSPARENCY:
        raise InputError(
            f"{path} has {page.samplesperpixel} samples per pixel, and does not say that the last "
            f"is a plain transparency: store it in grey or RGB."
        )
    if page.compression not in COMPRESSIONS:
        raise InputError(
            f"{path} uses compression {int(page.compression)} "
            f"({getattr(page.compression, 'name', 'unknown')}), which is not read: store it with "
            f"DEFLATE, LZW or without compression."
        )
