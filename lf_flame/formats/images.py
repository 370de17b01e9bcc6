"""Image files: pictures of 8 and 16 bits, grey and colour, their coding, and focal stacks."""

import json
import struct
from pathlib import Path

import imagecodecs
import numpy as np
import tifffile
from numpy.typing import ArrayLike
from PIL import Image, PngImagePlugin

from lf_flame._common.atomic_files import atomic_write
from lf_flame._common.config import build
from lf_flame._common.images import (
    TIFF_SUFFIXES,
    find_axes,
    is_tiff,
    open_image,
    open_tiff,
    pictures,
    read_pixels,
    read_tiff,
    to_unit,
    top_level,
)
from lf_flame._common.input_files import parse_json
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
    """Round values from 0 to 1 to unsigned levels of 8 or 16 bits; refuse values out of range."""
    if bits not in (8, 16):
        raise InputError(f"bits must be 8 or 16, got {bits}.")
    low, high = values.min(), values.max()
    levels = np.rint(values * np.float32(2**bits - 1))
    if levels.min() < 0 or levels.max() > 2**bits - 1:
        raise InputError(
            f"Images of {bits} bits store values from 0 to 1, got {low:.4g} to {high:.4g}: "
            f"scale them first."
        )
    return levels.astype(f"uint{bits}")


def white_of(light_field: LightField) -> float:
    """Radiance shown as white: 1, or the brightest used pixel if it is above 1 or below 0.1."""
    brightest = max(float(light_field.used_values.max()), float(np.finfo(np.float32).tiny))
    return max(brightest, 1.0) if brightest > 0.1 else brightest


def to_preview(image: np.ndarray, white: float) -> np.ndarray:
    """Image as 8-bit levels for display; radiance above `white` is shown as white."""
    return to_levels(np.clip(image / np.float32(white), 0, 1), 8)


def write_image(path: str | Path, levels: np.ndarray, *, linear: bool = False) -> None:
    """Write levels, shape (h, w) or (h, w, 3), as PNG or TIFF by the ending; floats as TIFF.

    A PNG of 8 bits states that its levels are linear in radiance (gAMA), if they are; without it,
    such files are assumed to be gamma-coded.
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


# Coding -------------------------------------------------------------------------------------------

CODED = (
    "Such files usually contain gamma-coded (sRGB) numbers, which are not linear in light: all "
    "brightness ratios, and what is computed from them, are then wrong. Use linear data, as the "
    "camera's raw ones in TIFF or PNG of 16 bits, unless you know that these are linear."
)


def note_on_coding(path: Path) -> str:
    """Note that an image is probably gamma-coded; empty if it is not, or the file is not an image.

    It is, if it has 8 bits or fewer, unless a PNG states that its levels are linear (gAMA; ISO/IEC
    15948, 11.2.2 and 11.3.3), or if it has a colour profile (ICC) or states sRGB or a gamma.
    """
    if path.suffix.lower() not in IMAGE_SUFFIXES:
        return ""
    if is_tiff(path):
        with open_tiff(path) as file:
            page = pictures(file, path)[0].keyframe
            kind, bits = "TIFF", int(np.max(page.bitspersample))
            has_profile, stated = "InterColorProfile" in page.tags, {}
    else:
        with open_image(path) as image:
            kind, stated = image.format or "", image.info
            bits = top_level(image).bit_length() if kind in ("PNG", "PPM") else 8
        has_profile = "icc_profile" in stated
    is_linear = stated.get("gamma", 0.45 if bits <= 8 else 1.0) > 0.99 and "srgb" not in stated
    if is_linear and not has_profile:
        return ""
    profile = " with a colour profile" if has_profile else ""
    return f"{path} is a {kind} file of {bits} bits{profile}. {CODED}"


# Focal stacks -------------------------------------------------------------------------------------


def is_stack(path: str | Path) -> bool:
    """Whether a TIFF file contains more than one image; one in three channels is a colour image."""
    with open_tiff(path) as file:
        _, pages, _ = find_axes(pictures(file, path))
    return bool(pages)


def write_focal_stack(stack: ArrayLike, slopes: ArrayLike, path: str | Path) -> None:
    """Write refocused images as a TIFF file of float32 pages that ImageJ can open.

    Parameters
    ----------
    stack : array_like, shape (n, t, s) or (n, t, s, channels)
        Refocused images, up to 4 channels; a single channel loses its axis.
    slopes : sequence of float
        Slope of each image, stored in the file's description and in the labels of its pages.
    path : str or Path

    Raises
    ------
    InputError
        If stack and slopes do not match, or are larger than ImageJ can open.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame.formats import read_focal_stack, write_focal_stack
    >>> write_focal_stack(np.ones((2, 20, 30), np.float32), [0.0, 1.0], "stack.tif")
    >>> stack, slopes = read_focal_stack("stack.tif")
    >>> stack.shape, [float(slope) for slope in slopes]
    ((2, 20, 30), [0.0, 1.0])
    """
    stack = np.asarray(stack, np.float32)
    numbers = [float(slope) for slope in np.atleast_1d(slopes)]
    if stack.ndim == 4 and stack.shape[3] == 1:
        stack = stack[..., 0]
    fits = stack.ndim in (3, 4) and stack.size and stack.shape[3:] <= (4,)
    if not fits or len(stack) != len(numbers):
        raise InputError(
            f"A focal stack needs one image for each slope, in up to 4 channels, got "
            f"shape {stack.shape} and {len(numbers)} slopes."
        )
    if stack.nbytes > 2**32 - 2**20:  # ImageJ opens classic TIFF, with offsets of 32 bits
        raise InputError(f"A focal stack must stay below 4 GiB, got {stack.nbytes / 2**30:.1f}.")
    axes = "ZYX"
    if stack.ndim == 4:  # ImageJ has no float colour: each channel is a separate page
        stack, axes = np.moveaxis(stack, 3, 1), "ZCYX"
    channels = stack.shape[1] if stack.ndim == 4 else 1
    metadata = {
        "axes": axes,
        "slopes": json.dumps(numbers),
        "Labels": [f"slope {slope:g}" for slope in numbers for _ in range(channels)],
    }
    with atomic_write(path) as aside:
        tifffile.imwrite(aside, stack, imagej=True, photometric="minisblack", metadata=metadata)


def read_focal_stack(path: str | Path) -> tuple[np.ndarray, np.ndarray | None]:
    """Read a focal stack, with the slopes that `write_focal_stack` stored, if any.

    Returns
    -------
    stack : ndarray of float32, shape (n, t, s) or (n, t, s, channels)
        Unsigned levels of 8 or 16 bits are scaled to 0 to 1, floats stay as they are.
    slopes : ndarray of float64, shape (n,), or None

    Raises
    ------
    InputError
        If the file cannot be read, or its pages have more than one axis.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame.formats import read_focal_stack, write_focal_stack
    >>> write_focal_stack(np.ones((2, 20, 30), np.float32), [0.0, 1.0], "stack.tif")
    >>> read_focal_stack("stack.tif")[0].shape
    (2, 20, 30)
    """
    pixels, letters, metadata = read_tiff(path, opaque=True)
    pages = to_unit(pixels if letters else pixels[None], path)
    if len(letters) > 1:
        raise InputError(
            f"A focal stack needs images along one axis, got shape {pages.shape} in {path}."
        )
    if "slopes" not in metadata:
        return pages, None
    described = parse_json(str(metadata["slopes"]), path)
    slopes = np.array(build(list[float], described, f"{path}: slopes"))
    if slopes.shape != (len(pages),):
        raise InputError(f"{path} has {len(pages)} images, but slopes of shape {slopes.shape}.")
    return pages, slopes
