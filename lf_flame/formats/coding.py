"""Notes on image files with values that are probably gamma-coded, not linear in radiance."""

from pathlib import Path

from PIL import Image

from lf_flame._common.input_files import check_regular
from lf_flame.errors import InputError
from lf_flame.formats.images import IMAGE_SUFFIXES

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


def _first_image(source: Path) -> Path | None:
    try:
        if source.is_dir():
            images = (one for one in source.iterdir() if one.suffix.lower() in IMAGE_SUFFIXES)
            return min((one for one in images if not one.name.startswith(".")), default=None)
    except OSError:
        return None
    return source


def _coded_png(path: Path) -> str | None:
    """Name the kind of a PNG file that is probably gamma-coded (ISO/IEC 15948, 11.3.3)."""
    try:
        check_regular(path)
        with path.open("rb") as file:
            header = file.read(25)
        with Image.open(path) as image:
            gamma, is_srgb = image.info.get("gamma"), "srgb" in image.info
    except (InputError, OSError, ValueError, SyntaxError, Image.DecompressionBombError):
        return None  # the reader reports the error
    if not header.startswith(PNG_SIGNATURE):
        return None
    bits = header[24]
    is_coded = is_srgb or (bits <= 8 if gamma is None else gamma < LINEAR_GAMMA)
    return f"a PNG file of {bits} bits" if is_coded else None
