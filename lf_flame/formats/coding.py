"""Notes on values that are probably not linear in radiance, or fill only some of their bits."""

from pathlib import Path

import numpy as np
from PIL import Image

from lf_flame._common.images import open_image
from lf_flame._common.input_files import File, check_regular, open_bytes
from lf_flame.errors import InputError
from lf_flame.formats.arrays import MATLAB_SUFFIX
from lf_flame.formats.view_files.sources import first_image, is_view_folder
from lf_flame.lightfield import LightField

CODED = (
    "Such files usually hold gamma-coded (sRGB) numbers, which are not linear in light: all "
    "brightness ratios, and what is computed from them, are then wrong. Use linear data, as the "
    "camera's raw ones in TIFF or PNG of 16 bits, unless you know that these are linear."
)

ALWAYS_CODED = {
    ".jpg": "a JPEG file",
    ".jpeg": "a JPEG file",
    ".webp": "a WebP file",
    ".bmp": "a BMP file",
}

DEPTHS = (10, 12, 14)
"""Numbers of bits of cameras that write 16."""

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"

LINEAR_GAMMA = 0.99
"""Smallest gamma in a PNG's gAMA chunk that counts as linear in radiance."""


def notes_on_coding(source: str | Path) -> list[str]:
    """Note whether an image, or the first image of a view folder, is probably gamma-coded.

    JPEG, WebP and BMP files are; so are 8-bit PNG files that do not state that they are linear,
    and deeper ones that state that they are not.

    Parameters
    ----------
    source : str or Path
        File or folder that was read as a light field; if it cannot be read, there is no note.

    Returns
    -------
    list of str
        One note, or none.
    """
    path = _first_image(Path(source))
    if path is None:
        return []
    kind = ALWAYS_CODED.get(path.suffix.lower())
    if kind is None and path.suffix.lower() == ".png":
        kind = _coded_png(path)
    return [] if kind is None else [f"{path} is {kind}. {CODED}"]


def notes_on_values(light_field: LightField, source: str | Path) -> list[str]:
    """Note whether levels of 16 bits fill only 10, 12 or 14, and whether weights were stored.

    Parameters
    ----------
    light_field : LightField
        Light field as read; values from 0 to 1, where the highest level of 16 bits is 1.
    source : str or Path
        File or folder that was read.

    Returns
    -------
    list of str
        Up to two notes.
    """
    note = note_on_depth(light_field.views.reshape(-1, *light_field.views.shape[2:]))
    notes = [note] if note else []
    if Path(source).suffix.lower() == MATLAB_SUFFIX and light_field.weights is not None:
        notes.append(
            "the fourth channel of LF is a weight (LFToolbox): each view has the mean of its own; "
            "pixels of weight 0 are unknown, other weights of single pixels are not used"
        )
    return notes


def note_on_depth(values: np.ndarray) -> str:
    """Note whether an array's brightest part has levels of 16 bits that fill only 10, 12 or 14.

    Parameters
    ----------
    values : ndarray
        Views, one after the other, or a raw image; values from 0 to 1.

    Returns
    -------
    str
        One note, or nothing.
    """
    white = np.iinfo(np.uint16).max
    brightest = values[values.argmax() // values[0].size].astype(np.float64) * white
    top, levels = brightest.max(), np.rint(brightest)
    deep = np.abs(brightest - levels).max() < 0.01 and np.any(levels % 257)  # 257: of 8 bits
    bits = next((bits for bits in DEPTHS if top < 2**bits), None)
    if not deep or bits is None or top < 2**8:
        return ""
    return (
        f"the values use only {bits} of 16 bits (the highest level is {top:.0f}): if the "
        f"camera has {bits} bits, its white is {(2**bits - 1) / white:.4f} here and not 1; "
        f"ratios of brightness are right"
    )


def _first_image(source: Path) -> File | None:
    try:
        return first_image(source) if is_view_folder(source) else source
    except (OSError, InputError):  # the reader reports the error
        return None


def _coded_png(path: File) -> str | None:
    """Name the kind of a PNG file that is probably gamma-coded (ISO/IEC 15948, 11.3.3)."""
    try:
        check_regular(path)
        with open_bytes(path) as file:
            header = file.read(25)
        with open_image(path, ("PNG",)) as image:
            gamma, is_srgb = image.info.get("gamma"), "srgb" in image.info
    except (InputError, OSError, ValueError, SyntaxError, Image.DecompressionBombError):
        return None  # the reader reports the error
    if not header.startswith(PNG_SIGNATURE):
        return None
    bits = header[24]
    is_coded = is_srgb or (bits <= 8 if gamma is None else gamma < LINEAR_GAMMA)
    return f"a PNG file of {bits} bits" if is_coded else None
