"""Exposure of a picture, as its file states it (EXIF 2.32, or the metadata of a Lytro camera)."""

from pathlib import Path
from typing import Any

from lf_flame._common.images import FORMATS, PILLOW_ERRORS, TIFF_SUFFIXES, open_image, open_tiff
from lf_flame.errors import InputError
from lf_flame.formats.images import is_lytro
from lf_flame.formats.lytro.picture import read_lytro

EXIF, TIME, SPEED = 0x8769, 0x829A, 0x8827
"""Tags of the EXIF table, the exposure time in s and the ISO speed."""


def read_exposure(path: str | Path) -> float | None:
    """Read the exposure that a file states: its time in s, times its ISO speed over 100, if given.

    Signals are proportional to it as long as the aperture is the same.

    Parameters
    ----------
    path : str or Path
        Picture (TIFF, PNG, JPEG), or a picture of a Lytro camera.

    Returns
    -------
    float or None
        Exposure above 0; None where the file states none, or is no picture.

    Examples
    --------
    >>> from PIL import Image
    >>> from lf_flame.formats import read_exposure
    >>> picture = Image.new("L", (4, 3))
    >>> exif = picture.getexif()
    >>> exif[0x8769] = {0x829A: 0.004, 0x8827: 200}
    >>> picture.save("picture.png", exif=exif)
    >>> read_exposure("picture.png")
    0.008
    """
    path = Path(path)
    if not path.is_file():
        return None
    try:
        time, speed = _lytro(path) if is_lytro(path) else _exif(path)
    except InputError:
        return None
    exposure = time * (speed or 100.0) / 100
    return exposure if 0 < exposure < float("inf") else None


def _lytro(path: Path) -> tuple[float, float]:
    metadata = read_lytro(path).metadata
    return metadata.exposure_s or 0.0, metadata.iso or 0.0


def _exif(path: Path) -> tuple[float, float]:
    """Exposure time and speed, 0 where there are none."""
    try:
        if path.suffix.lower() in TIFF_SUFFIXES:
            with open_tiff(path) as file:
                tags = {tag.code: tag.value for tag in file.pages.first.tags}
            table = tags.get(EXIF, {})
            table = {TIME: table.get("ExposureTime"), SPEED: table.get("ISOSpeedRatings")}
        else:
            with open_image(path, FORMATS) as image:
                tags = dict(image.getexif())
                table = image.getexif().get_ifd(EXIF)
    except PILLOW_ERRORS:
        return 0.0, 0.0
    time, speed = (_number(table.get(tag) or tags.get(tag, 0)) for tag in (TIME, SPEED))
    return time, speed


def _number(value: Any) -> float:
    """Turn a number, a fraction as two of them, or the first of several into a float, else 0."""
    try:
        if isinstance(value, tuple) and len(value) == 2:
            return float(value[0]) / float(value[1])
        return float(value[0] if isinstance(value, tuple) else value)
    except (TypeError, ValueError, ArithmeticError, LookupError):
        return 0.0
