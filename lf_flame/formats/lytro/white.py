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
from itertools import takewhile
from math import inf
from pathlib import Path, PurePosixPath

import numpy as np

from lf_flame._common.input_files import check_memory, printable, readable
from lf_flame.errors import InputError
from lf_flame.formats.images import is_lytro, read_image
from lf_flame.formats.lytro.picture import (
    LytroMetadata,
    LytroPicture,
    parse_metadata,
    parse_table,
    read_bytes,
    read_lytro,
)

LOGGER = logging.getLogger(__name__)

PAIRED = re.compile(r"(.*/)?MOD_\d{1,8}\.(TXT|RAW)", re.IGNORECASE)
"""Name of a white image's pixels or metadata."""

WhiteFile = tuple[LytroMetadata, str, Callable[[], bytes]]
"""Metadata and name of a white image in a folder or an archive, and what reads its pixels."""


def mosaic_like(picture: LytroPicture, path: str | Path | None, name: str) -> np.ndarray | None:
    """White, dark or lenslet image for a picture, linear in radiance; None if there is none.

    From a raw file of the camera; but for a dark one, also from an image in any unit, or from the
    camera's folder or archive of white images. Default for a white one: that in the picture's file.
    """
    if path is None:
        own = picture.white_image if name == "white" else None
        return None if own is None else own.radiance
    if name != "dark" and (Path(path).is_dir() or Path(path).suffix.lower() == ".tar"):
        return find_white(picture, path).radiance
    if is_lytro(path):
        other = read_lytro(path)
        serial, its = (one.metadata.serial.upper() for one in (picture, other))
        if serial and its and serial != its:
            LOGGER.warning(
                f"The {name} image {printable(path)} is of camera {printable(its, 40)}, but "
                f"the picture of {printable(serial, 40)}: lenslets and vignetting may not fit."
            )
        return other.radiance
    if name == "dark":
        raise InputError(
            f"The dark image of {picture.source} must be a raw file of the camera, got {path}."
        )
    return read_image(path)


def find_white(picture: LytroPicture, where: str | Path) -> LytroPicture:
    """Find the white image of a picture's camera, at the nearest zoom step, and focus step.

    Images with a mean below 12 % of the highest level are left out, as frames without light are.
    """
    where, facts = Path(where), picture.metadata
    zoom, focus = facts.zoom_step, facts.focus_step
    if not facts.serial or zoom is None or focus is None:
        raise InputError(
            f"{picture.source} does not say which white image fits it (serial number, zoom and "
            f"focus step): name one white image instead of {where}."
        )

    def distance(one: WhiteFile) -> list[float]:
        steps = (one[0].zoom_step, zoom), (one[0].focus_step, focus)
        return [inf if x is None else abs(x - y) for x, y in steps]

    files, serial = white_files(where), facts.serial.upper()
    alike = [one for one in files if one[0].serial.upper() == serial]
    for known, name, read in sorted(alike, key=distance):
        white = LytroPicture(known, read(), name)
        # The F01 comes with dark ones too, which LFToolbox leaves out by this limit.
        if white.mosaic.mean() >= 500 / 4095 * (2**known.bits - 1):
            LOGGER.info(
                f"White image {printable(name)}, at zoom step {known.zoom_step} for {zoom} and "
                f"focus step {known.focus_step} for {focus}"
            )
            return white
    cameras = sorted({f" of camera {known.serial or 'unknown'}" for known, _, _ in files})
    raise InputError(
        f"{where} contains no white image for {picture.source}, of camera {facts.serial}; images "
        f"found: {len(files)}{' and'.join(cameras[:5])}; too dark: {len(alike)}."
    )


def white_files(where: Path) -> list[WhiteFile]:
    """Find the white images in a folder or an archive, by the names of their files."""
    files, found = _in_folder(where) if where.is_dir() else _in_archive(where), []
    for name in sorted(files):
        if name.endswith(".TXT") and (pixels := name[:-3] + "RAW") in files:
            source = str(where / PurePosixPath(pixels).name)
            metadata = parse_metadata(parse_table(files[name](), source), source)
            found.append((metadata, source, files[pixels]))
    return found


def _in_folder(where: Path) -> dict[str, Callable[[], bytes]]:
    paths = [path for path in where.iterdir() if PAIRED.fullmatch(path.name)]
    return {path.name.upper(): partial(read_bytes, path) for path in paths}


@contextmanager
def _opened(path: Path) -> Iterator[tarfile.TarFile]:
    with (
        readable(path, "is not an archive of white images"),
        tarfile.open(path, "r:", errorlevel=2) as archive,
    ):
        yield archive


def _in_archive(path: Path) -> dict[str, Callable[[], bytes]]:
    """Plain files of an archive, no links; nothing is written to the disk."""
    with _opened(path) as archive:
        # A negative size would let tarfile read the same header for ever.
        rising = takewhile(lambda one: archive.offset > one.offset, archive)
        members = [one for one in rising if one.isreg() and PAIRED.fullmatch(one.name)]

    def read(member: tarfile.TarInfo) -> bytes:
        check_memory(2 * member.size, path)
        with _opened(path) as archive:
            file = archive.extractfile(member)
            return b"" if file is None else file.read()

    return {one.name.upper(): partial(read, one) for one in members}
