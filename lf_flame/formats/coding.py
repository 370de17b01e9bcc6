"""Notes on values that are probably not linear in radiance, or fill only some of their bits."""

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

PROFILE, CURVE = 34675, 301
"""Tags of a TIFF file: colour profile (ICC), and the light of each level (TransferFunction)."""


def note_on_coding(source: str | Path) -> str:
    """Note that an image, or the first image of a view folder, is probably gamma-coded, if it is.

    It is, if it has 8 bits or fewer, a colour profile (ICC), or states a gamma; unless it states
    that its levels are linear (gAMA of a PNG, TransferFunction of a TIFF file). The note says how
    many pixels are saturated. There is none on what cannot be read or is no image.
    """
    path: Path | None = Path(source)
    try:
        path = first_image(Path(source)) if is_view_folder(source) else Path(source)
        if path is None or path.suffix.lower() not in IMAGE_SUFFIXES:
            return ""
        kind = _coded_tiff(path) if is_tiff(path) else _coded_image(path)
        return f"{path} is {kind}{_saturated(path)}. {CODED}" if kind else ""
    except InputError:
        return ""  # the reader reports the error


def _saturated(path: Path) -> str:
    """Say how many pixels have the highest level in a channel, if a noticeable part has."""
    pixels = np.atleast_3d(read_pixels(path))
    if pixels.dtype.kind != "u":
        return ""
    share = np.mean(np.any(pixels[..., :3] == np.iinfo(pixels.dtype).max, axis=2))
    return f", {share:.2g} of whose pixels are saturated" if share >= 0.001 else ""


def _coded_tiff(path: Path) -> str:
    """Name the kind of a TIFF file that is probably gamma-coded.

    TIFF 6.0, TransferFunction: without it, levels have a gamma of 2.2; 16 bits of cameras have not.
    """
    with open_tiff(path) as file:
        page = pictures(file, path)[0].keyframe
        profile, bits = PROFILE in page.tags, int(np.max(page.bitspersample))
        curve = np.ravel(page.tags[CURVE].value if CURVE in page.tags else 0).astype(float)
    linear = curve.size > 1 and np.allclose(curve, np.linspace(0, 65535, len(curve)), atol=1)
    return _named("TIFF", bits, profile, 1 < bits <= 8 and not linear)


def _coded_image(path: Path) -> str:
    """Name the kind of another image that is probably gamma-coded (PNG: ISO/IEC 15948, 11.3.3)."""
    with open_image(path) as image:
        kind, said = image.format or "", image.info
        top = netpbm_top(image) if kind == "PPM" else 0
    if kind == "PPM":
        return _named("Netpbm", 8, False, top < 256)
    if kind != "PNG":
        return f"a {kind} file"
    with path.open("rb") as file:
        bits, gamma = file.read(25)[24], said.get("gamma")
    coded = "srgb" in said or (bits <= 8 if gamma is None else gamma < 0.99)
    return _named("PNG", bits, "icc_profile" in said, coded)


def _named(kind: str, bits: int, profile: bool, coded: bool) -> str:
    if profile:
        return f"a {kind} file of {bits} bits with a colour profile"
    return f"a {kind} file of {bits} bits" if coded else ""


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
