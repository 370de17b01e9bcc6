"""White images of a Lytro camera: the one that fits a picture, from a folder or an archive.

A camera comes with white images for many positions of its zoom and focus: ``MOD_0000.RAW``,
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

from lf_flame._common.input_files import check_regular, printable, readable
from lf_flame.errors import InputError
from lf_flame.formats.lytro.container import check_table_size, parse_table, read_bytes
from lf_flame.formats.lytro.metadata import LytroMetadata, parse_metadata
from lf_flame.formats.lytro.picture import LytroPicture

LOGGER = logging.getLogger(__name__)

PAIRED = re.compile(r"(MOD_\d{1,8})\.(TXT|RAW)", re.IGNORECASE)
"""Name of a white image's pixels or metadata."""


class PackedFile(NamedTuple):
    """File of a folder or an archive, and what reads it."""

    name: str
    size: int
    read: Callable[[], bytes]


class WhiteFile(NamedTuple):
    """White image in a folder or an archive, of which only the metadata are read."""

    name: str
    metadata: LytroMetadata
    pixels: PackedFile


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
        one.metadata.check_size(one.pixels.size, one.name)  # before that many bytes are read
        white = LytroPicture(one.metadata, one.pixels.read(), one.name)
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
        place = PurePosixPath(file.name)
        if named := PAIRED.fullmatch(place.name):
            pairs.setdefault(str(place.parent / named[1].upper()), {})[named[2].upper()] = file
    found = []
    for _, pair in sorted(pairs.items()):
        if len(pair) == 2:
            text, pixels = pair["TXT"], pair["RAW"]
            name = str(where / PurePosixPath(pixels.name).name)
            check_table_size(text.size, name)  # before that many bytes are read
            metadata = parse_metadata(parse_table(text.read(), name), name)
            found.append(WhiteFile(name, metadata, pixels))
    return found


def _in_folder(where: Path) -> list[PackedFile]:
    paths = [path for path in where.iterdir() if PAIRED.fullmatch(path.name)]
    return [PackedFile(path.name, check_regular(path), partial(read_bytes, path)) for path in paths]


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

    return [PackedFile(one.name, one.size, partial(read, one)) for one in members]
