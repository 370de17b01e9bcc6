"""Exposure time of an image file, by its tags."""

from pathlib import Path

from PIL import Image

from lf_flame._common.pixels import FORMATS, PILLOW_ERRORS

EXIF, EXPOSURE = 0x8769, 0x829A
"""Tags of the directory that holds a camera's settings, and of the exposure time in s."""


def read_exposure(path: str | Path) -> float | None:
    """Read an image's exposure time in s; None where the file states none, or is no image.

    Examples
    --------
    >>> from PIL import Image
    >>> from lf_flame.formats import read_exposure
    >>> tags = Image.Exif()
    >>> tags[0x829A] = 0.004
    >>> Image.new("L", (8, 8)).save("frame.png", exif=tags)
    >>> read_exposure("frame.png")
    0.004
    """
    if not Path(path).is_file():
        return None
    try:
        with Image.open(path, formats=(*FORMATS, "TIFF")) as image:
            tags = image.getexif()
            found = tags.get(EXPOSURE, tags.get_ifd(EXIF).get(EXPOSURE))
        seconds = float(found) if found is not None else 0.0
    except (*PILLOW_ERRORS, ZeroDivisionError):
        return None
    return seconds if seconds > 0 else None
