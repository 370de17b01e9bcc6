"""Images that fit a picture of a Lytro camera: a white, a dark one, one that shows the lenslets.

The camera comes with white images for many positions of its zoom and focus: ``MOD_0000.RAW``,
packed pixels, and ``MOD_0000.TXT``, their metadata, and so on, in a folder or in an archive
``caldata-SERIAL.tar``.
"""

import logging
import re
import tarfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from math import inf
from pathlib import Path, PurePosixPath
from typing import NamedTuple

import numpy as np

from lf_flame._common.input_files import check_regular, printable, readable
from lf_flame.errors import InputError
from lf_flame.formats.images import is_lytro, read_image
from lf_flame.formats.lytro.metadata import LytroMetadata, parse_metadata
from lf_flame.formats.lytro.picture import (
    LytroPicture,
    check_table_size,
    parse_table,
    read_bytes,
    read_lytro,
)
from lf_flame.formats.raw.lenslet_grid import LensletGrid
from lf_flame.formats.raw.lenslet_search import estimate_grid

LOGGER = logging.getLogger(__name__)

PAIRED = re.compile(r"(MOD_\d{1,8})\.(TXT|RAW)", re.IGNORECASE)
"""Name of a white image's pixels or metadata."""

PackedFile = tuple[str, int, Callable[[], bytes]]
"""Name and size of a file of a folder or an archive, and what reads it."""


class WhiteFile(NamedTuple):
    """White image in a folder or an archive; its pixels, of `size` bytes, are not yet read."""

    name: str
    metadata: LytroMetadata
    size: int
    read: Callable[[], bytes]


def mosaic_like(picture: LytroPicture, path: str | Path | None, name: str) -> np.ndarray | None:
    """White, dark or lenslet image for a picture, linear in radiance; None if there is none.

    From a raw file of the camera; but for a dark one, also from an image in any unit, or from the
    camera's folder or archive of white images. Default for a white one: that in the picture's file.
    """
    metadata = picture.metadata
    if path is None:
        own = picture.white_image if name == "white" else None
        return None if own is None else own.radiance
    if name != "dark" and (Path(path).is_dir() or Path(path).suffix.lower() == ".tar"):
        return find_white(picture, path).radiance
    if is_lytro(path):
        other = read_lytro(path)
        image, bayer, serial = other.radiance, other.metadata.bayer, other.metadata.serial
        if serial and metadata.serial and serial.upper() != metadata.serial.upper():
            LOGGER.warning(
                f"The {name} image {printable(path)} is of camera {printable(serial, 40)}, the "
                f"picture of {printable(metadata.serial, 40)}: lenslets and vignetting may not fit."
            )
    elif name != "dark":
        image, bayer = read_image(path), metadata.bayer
    else:
        raise InputError(
            f"The dark image of {picture.source} must be a raw file of the camera, got {path}."
        )
    if (*image.shape, bayer) != (*metadata.shape, metadata.bayer):
        raise InputError(
            f"The {name} image {path} must be a mosaic like {picture.source}, {metadata.bayer} of "
            f"shape {metadata.shape}, got {bayer} of shape {image.shape}."
        )
    return image


def find_lenslets(picture: LytroPicture) -> LensletGrid:
    """Find the lenslets in a picture itself, with a warning that this is no white image."""
    name = printable(picture.source)
    try:
        grid = estimate_grid(picture.radiance)
    except InputError:
        raise InputError(
            f"The lenslets of {name} are not seen in it: give a white image of the camera."
        ) from None
    LOGGER.warning(
        f"{name}: vignetting is not corrected, and outer views are too dark, as no white image is "
        f"given (--white with a MOD_*.RAW, its folder or caldata-"
        f"{printable(picture.metadata.serial or 'SERIAL', 40)}.tar); the lenslets are where the "
        f"picture shows them."
    )
    return grid


def find_white(picture: LytroPicture, where: str | Path) -> LytroPicture:
    """Find the white image of a picture's camera, at the nearest zoom step, and focus step.

    Dark frames, and images with a mean below 12 % of the highest level, are left out.
    """
    where, facts = Path(where), picture.metadata
    if not facts.serial or facts.zoom_step is None or facts.focus_step is None:
        raise InputError(
            f"{picture.source} does not say which white image fits it (serial number, zoom and "
            f"focus step): name one white image instead of {where}."
        )
    files = white_files(where)
    fitting = [one for one in files if _is_alike(one.metadata, facts)]
    for one in sorted(fitting, key=lambda one: _distance(one.metadata, facts)):
        one.metadata.check_size(one.size, one.name)  # before that many bytes are read
        white = LytroPicture(one.metadata, one.read(), one.name)
        # The F01 comes with dark ones too, which LFToolbox leaves out by this limit.
        if white.mosaic.mean() >= 500 / 4095 * (2**facts.bits - 1):
            LOGGER.info(
                f"White image {printable(one.name)}, at zoom step {one.metadata.zoom_step} for "
                f"{facts.zoom_step} and focus step {one.metadata.focus_step} for {facts.focus_step}"
            )
            return white
    serials = sorted({one.metadata.serial or "unknown" for one in files})
    held = f"{len(files)} of camera {', '.join(serials[:5])}" if files else "none"
    dark = sum(one.metadata.is_dark for one in files) + len(fitting)
    raise InputError(
        f"{where} holds no white image for {picture.source}, of camera {facts.serial} and "
        f"{facts.shape[0]} x {facts.shape[1]} pixels, got {held}"
        + (f", of which {dark} are too dark or taken without light." if dark else ".")
    )


def _is_alike(white: LytroMetadata, facts: LytroMetadata) -> bool:
    """Whether a white image is of the same camera and the same form as a picture."""
    form = (white.shape, white.bits, white.bayer) == (facts.shape, facts.bits, facts.bayer)
    return form and white.serial.upper() == facts.serial.upper() and not white.is_dark


def _distance(white: LytroMetadata, facts: LytroMetadata) -> tuple[float, ...]:
    """Distance in zoom steps, then in focus steps; infinite if one is not stated."""
    pairs = ((white.zoom_step, facts.zoom_step), (white.focus_step, facts.focus_step))
    return tuple(abs((inf if one is None else one) - (other or 0)) for one, other in pairs)


def holds_white_files(folder: Path) -> bool:
    """Whether a folder holds white images of a Lytro camera."""
    return any(PAIRED.fullmatch(path.name) for path in folder.iterdir())


def white_files(where: Path) -> list[WhiteFile]:
    """Find the white images in a folder or an archive, by the names of their files."""
    pairs: dict[str, dict[str, PackedFile]] = {}
    for file in _in_folder(where) if where.is_dir() else _in_archive(where):
        place = PurePosixPath(file[0])
        if named := PAIRED.fullmatch(place.name):
            pairs.setdefault(str(place.parent / named[1].upper()), {})[named[2].upper()] = file
    found = []
    for _, pair in sorted(pairs.items()):
        if len(pair) == 2:
            (_, length, read_text), (pixels, size, read) = pair["TXT"], pair["RAW"]
            name = str(where / PurePosixPath(pixels).name)
            check_table_size(length, name)  # before that many bytes are read
            metadata = parse_metadata(parse_table(read_text(), name), name)
            found.append(WhiteFile(name, metadata, size, read))
    return found


def _in_folder(where: Path) -> list[PackedFile]:
    paths = [path for path in where.iterdir() if PAIRED.fullmatch(path.name)]
    return [(path.name, check_regular(path), partial(read_bytes, path)) for path in paths]


class _Member(tarfile.TarInfo):
    """Member of an archive; a negative size would let tarfile read the same header for ever."""

    def _block(self, count):
        if count < 0:
            raise tarfile.InvalidHeaderError("a size is negative")
        return super()._block(count)


@contextmanager
def _opened(path: Path) -> Iterator[tarfile.TarFile]:
    with (
        readable(path, "is no archive of white images"),
        tarfile.open(path, "r:", tarinfo=_Member, errorlevel=2) as archive,
    ):
        yield archive


def _in_archive(path: Path) -> list[PackedFile]:
    """Plain files of an archive, no links; nothing is written to the disk."""
    with _opened(path) as archive:
        members = [member for member in archive if member.isreg()]

    def read(member: tarfile.TarInfo) -> bytes:
        with _opened(path) as archive:
            file = archive.extractfile(member)
            return b"" if file is None else file.read()

    return [(one.name, one.size, partial(read, one)) for one in members]
