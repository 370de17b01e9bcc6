"""Notes on values that are probably not linear in radiance, or fill only some of their bits."""

from pathlib import Path

import numpy as np

from lf_flame._common.images import (
    FORMATS,
    PILLOW_ERRORS,
    TIFF_ERRORS,
    is_tiff,
    open_image,
    open_tiff,
    pictures,
    read_pixels,
)
from lf_flame._common.input_files import File, check_regular, open_bytes
from lf_flame.errors import InputError
from lf_flame.formats.arrays import MATLAB_SUFFIX
from lf_flame.formats.images import IMAGE_SUFFIXES
from lf_flame.formats.view_files.folder import first_image, is_view_folder
from lf_flame.lightfield import LightField

CODED = (
    "Such files usually hold gamma-coded (sRGB) numbers, which are not linear in light: all "
    "brightness ratios, and what is computed from them, are then wrong. Use linear data, as the "
    "camera's raw ones in TIFF or PNG of 16 bits, unless you know that these are linear."
)

ALWAYS_CODED = {"JPEG": "a JPEG file", "WEBP": "a WebP file", "BMP": "a BMP file"}
"""Formats whose levels are gamma-coded in practice."""

PROFILE, CURVE = 34675, 301
"""Tags of a TIFF file: colour profile (ICC), and the light of each level (TransferFunction)."""


def notes_on_coding(source: str | Path) -> list[str]:
    """Note whether an image, or the first image of a view folder, is probably gamma-coded.

    An image is, if it has 8 bits or fewer, a colour profile (ICC), or states a gamma; unless it
    states that its levels are linear (gAMA of a PNG, TransferFunction of a TIFF file). The note
    says how many pixels are saturated. There is none on what cannot be read or is no image.
    """
    path: File | None = Path(source)
    try:
        path = first_image(Path(source)) if is_view_folder(source) else path
        if path is None or Path(path.name).suffix.lower() not in IMAGE_SUFFIXES:
            return []
        check_regular(path)
        kind = _coded_tiff(path) if is_tiff(path) else _coded_image(path)
    except (InputError, *PILLOW_ERRORS, *TIFF_ERRORS):
        return []  # the reader reports the error
    return [] if kind is None else [f"{path} is {kind}{_saturated(path)}. {CODED}"]


def _saturated(path: File) -> str:
    """Say how many pixels have the highest level in a channel, if a noticeable part has."""
    try:
        pixels = np.atleast_3d(read_pixels(path))
    except InputError:  # as of a file of several pictures
        return ""
    if pixels.dtype.kind != "u":
        return ""
    share = np.mean(np.any(pixels[..., :3] == np.iinfo(pixels.dtype).max, axis=2))
    return f", {share:.2g} of whose pixels are saturated" if share >= 0.001 else ""


def _coded_tiff(path: File) -> str | None:
    """Name the kind of a TIFF file that is probably gamma-coded.

    TIFF 6.0, TransferFunction: without it, levels have a gamma of 2.2; 16 bits of cameras have not.
    """
    with open_tiff(path) as file:
        page = pictures(file, path)[0].keyframe
        bits = max(np.ravel(page.bitspersample).tolist())
        if PROFILE in page.tags:
            return f"a TIFF file of {bits} bits with a colour profile"
        curve = np.ravel(page.tags[CURVE].value if CURVE in page.tags else 0).astype(float)
    linear = curve.size > 1 and np.allclose(curve, np.linspace(0, 65535, len(curve)), atol=1)
    return f"a TIFF file of {bits} bits" if 1 < bits <= 8 and not linear else None


def _coded_image(path: File) -> str | None:
    """Name the kind of another image that is probably gamma-coded (PNG: ISO/IEC 15948, 11.3.3)."""
    with open_image(path, FORMATS) as image:
        kind, said = image.format or "", image.info
        args = image.tile[0].args if image.tile else ""
    if kind in ALWAYS_CODED:
        return ALWAYS_CODED[kind]
    if kind == "PPM":
        highest = args[-1] if isinstance(args, tuple) and isinstance(args[-1], int) else 0
        return "a Netpbm file of 8 bits" if highest < 256 and args != "I;16B" else None
    with open_bytes(path) as file:
        bits = file.read(25)[24]
    if "icc_profile" in said:
        return f"a PNG file of {bits} bits with a colour profile"
    gamma = said.get("gamma")
    coded = "srgb" in said or (bits <= 8 if gamma is None else gamma < 0.99)
    return f"a PNG file of {bits} bits" if coded else None


def notes_on_values(light_field: LightField, source: str | Path) -> list[str]:
    """Note whether levels of 16 bits fill only 10, 12 or 14, and whether weights were stored."""
    note = note_on_depth(light_field.views.reshape(-1, *light_field.views.shape[2:]))
    notes = [note] if note else []
    if Path(source).suffix.lower() == MATLAB_SUFFIX and light_field.weights is not None:
        notes.append(
            "the fourth channel of LF is a weight (LFToolbox): each view has the mean of its own; "
            "pixels of weight 0 are unknown, other weights of single pixels are not used"
        )
    return notes


def note_on_depth(values: np.ndarray) -> str:
    """Note whether levels of 16 bits fill only 10, 12 or 14, by the brightest view or line.

    Values are from 0 to 1; an array that is not of levels of 16 bits gives no note.
    """
    white = np.iinfo(np.uint16).max
    brightest = values[values.argmax() // values[0].size].astype(np.float64) * white
    top, levels = brightest.max(), np.rint(brightest)
    deep = np.abs(brightest - levels).max() < 0.01 and np.any(levels % 257)  # 257: of 8 bits
    bits = next((bits for bits in (10, 12, 14) if top < 2**bits), None)
    if not deep or bits is None or top < 2**8:
        return ""
    return (
        f"the values use only {bits} of 16 bits (the highest level is {top:.0f}): if the "
        f"camera has {bits} bits, its white is {(2**bits - 1) / white:.4f} here and not 1; "
        f"ratios of brightness are right"
    )
