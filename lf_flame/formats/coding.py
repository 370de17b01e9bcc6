"""Notes on images whose values are probably not linear in radiance."""

from pathlib import Path

import numpy as np

from lf_flame._common.images import (
    is_tiff,
    netpbm_top,
    open_image,
    open_tiff,
    pictures,
    read_pixels,
)
from lf_flame.errors import InputError
from lf_flame.formats.images import IMAGE_SUFFIXES
from lf_flame.formats.view_files.folder import first_image, is_view_folder

CODED = (
    "Such files usually hold gamma-coded (sRGB) numbers, which are not linear in light: all "
    "brightness ratios, and what is computed from them, are then wrong. Use linear data, as the "
    "camera's raw ones in TIFF or PNG of 16 bits, unless you know that these are linear."
)

PROFILE = 34675
"""Tag of the colour profile (ICC) in a TIFF file."""


def note_on_coding(source: str | Path) -> str:
    """Note that an image, or the first image of a view folder, is probably gamma-coded, if it is.

    It is, if it has 8 bits or fewer, a colour profile (ICC), or states a gamma; unless a PNG states
    that its levels are linear (gAMA). The note says how many pixels are saturated. There is none
    on what cannot be read or is no image.
    """
    path: Path | None = Path(source)
    try:
        path = first_image(Path(source)) if is_view_folder(source) else Path(source)
        if path is None or path.suffix.lower() not in IMAGE_SUFFIXES:
            return ""
        kind, is_coded = _kind(path)
        return f"{path} is a {kind}{_saturated(path)}. {CODED}" if is_coded else ""
    except InputError:
        return ""  # the reader reports the error


def _saturated(path: Path) -> str:
    """Say how many pixels have the highest level in a channel, if a noticeable part has."""
    pixels = np.atleast_3d(read_pixels(path))
    if pixels.dtype.kind != "u":
        return ""
    share = np.mean(np.any(pixels[..., :3] == np.iinfo(pixels.dtype).max, axis=2))
    return f", {share:.2g} of whose pixels are saturated" if share >= 0.001 else ""


def _kind(path: Path) -> tuple[str, bool]:
    """Kind of an image file, and whether it is probably gamma-coded."""
    if is_tiff(path):
        with open_tiff(path) as file:
            page = pictures(file, path)[0].keyframe
            bits, has_profile = int(np.max(page.bitspersample)), PROFILE in page.tags
        return _named("TIFF", bits, has_profile), has_profile or 1 < bits <= 8
    with open_image(path) as image:
        kind, said = image.format or "", image.info
        bits = netpbm_top(image).bit_length() if kind == "PPM" else 8
    has_profile = "icc_profile" in said
    if kind == "PNG":  # ISO/IEC 15948, 11.2.2 and 11.3.3
        with path.open("rb") as file:
            bits = file.read(25)[24]
        is_linear = said.get("gamma", 0.45 if bits <= 8 else 1.0) > 0.99 and "srgb" not in said
        return _named(kind, bits, has_profile), has_profile or not is_linear
    return _named(kind, bits, has_profile), kind != "PPM" or bits <= 8


def _named(kind: str, bits: int, has_profile: bool) -> str:
    return f"{kind} file of {bits} bits{' with a colour profile' if has_profile else ''}"
