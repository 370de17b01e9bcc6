"""White images of a Lytro camera: the one that fits a picture, from a folder or an archive.

A camera comes with white images for many positions of its zoom and focus: ``MOD_0000.RAW``,
packed pixels, and ``MOD_0000.TXT``, their metadata, and so on, in a folder or in an archive
``caldata-SERIAL.tar``.
"""

import logging
import re
import tarfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import islice
from math import inf
from pathlib import Path, PurePosixPath

from lf_flame._common.input_files import read_text, readable
from lf_flame._common.memory import check_memory
from lf_flame._common.printable import printable
from lf_flame.errors import InputError
from lf_flame.formats.lytro.container import parse_table
from lf_flame.formats.lytro.metadata import LytroMetadata, parse_metadata
from lf_flame.formats.lytro.picture import (
    BYTES_A_PIXEL,
    LytroPicture,
    check_packed,
    read_packed,
    unpack,
)

LOGGER = logging.getLogger(__name__)

PAIRED = re.compile(r"(MOD_\d{1,8})\.(TXT|RAW)", re.IGNORECASE)
"""Name of a white image's pixels or metadata."""

ARCHIVE = re.compile(r"caldata-.*\.tar", re.IGNORECASE)
"""Name of an archive of white images."""

LARGEST_TXT = 1 << 18
"""Largest size of the metadata of a white image, in bytes; those of the cameras have 6 kB."""

MOST_WHITES = 2000
"""Largest number of white images that are compared; a camera comes with some 60."""

MOST_MEMBERS = 20_000
"""Largest number of files in an archive or a folder."""

LEAST_MEAN = 500 / 4095
"""Smallest mean of a white image, relative to the highest level. The F01 comes with dark ones too,
which LFToolbox leaves out below 500 of 4095."""

TAR_ERRORS = (
    tarfile.TarError, OSError, EOFError, ValueError, OverflowError, IndexError, TypeError,
)  # fmt: skip
"""Exceptions of tarfile for a damaged archive."""


@dataclass(frozen=True)
class WhiteFile:
    """White image in a folder or archive, of which only the metadata are read.

    Attributes
    ----------
    name : str
        Name for messages.
    metadata : LytroMetadata
    read_packed : callable
        Function that reads the packed pixels, after a check of their size.
    """

    name: str
    metadata: LytroMetadata
    read_packed: Callable[[], bytes]

    def read(self) -> LytroPicture:
        """Unpack the white image."""
        check_memory(BYTES_A_PIXEL * self.metadata.shape[0] * self.metadata.shape[1], self.name)
        mosaic = unpack(self.read_packed(), self.metadata, self.name)
        return LytroPicture(self.metadata, mosaic, self.name)


def find_white(picture: LytroPicture, where: str | Path) -> LytroPicture:
    """Find the white image of a picture's camera, by serial number, zoom and focus.

    Parameters
    ----------
    picture : LytroPicture
    where : str or Path
        Archive ``caldata-SERIAL.tar``; or a folder with files MOD_*.RAW and MOD_*.TXT, or with
        such archives or folders.

    Returns
    -------
    LytroPicture
        White image of the same camera with the nearest zoom step, and among these with the nearest
        focus step. Dark frames, and images with a mean below 12 % of the highest level, are left
        out.

    Raises
    ------
    InputError
        If nothing fits, a file cannot be read, or the picture's metadata lack serial number, zoom
        or focus.

    Examples
    --------
    >>> import json
    >>> from pathlib import Path
    >>> from lf_flame.formats import find_white, read_lytro
    >>> values = {
    ...     "image": {
    ...         "height": 2, "width": 2,
    ...         "pixelPacking": {"bitsPerPixel": 12, "endianness": "big"},
    ...         "mosaic": {"tile": "r,gr:gb,b", "upperLeftPixel": "b"},
    ...         "pixelFormat": {
    ...             "black": dict.fromkeys(["r", "gr", "gb", "b"], 168),
    ...             "white": dict.fromkeys(["r", "gr", "gb", "b"], 4095),
    ...         },
    ...     },
    ...     "devices": {"lens": {"zoomStep": 900, "focusStep": 500}},
    ...     "camera": {"serialNumber": "A123"},
    ... }
    >>> for name in ("MOD_0000", "MOD_0002"):
    ...     _ = Path(f"{name}.TXT").write_text(json.dumps(values))
    ...     _ = Path(f"{name}.RAW").write_bytes(bytes(6 * [200]))
    ...     values["devices"]["lens"]["focusStep"] += 100
    >>> find_white(read_lytro("MOD_0002.RAW"), ".").source
    'MOD_0002.RAW'
    """
    where, facts = Path(where), picture.metadata
    if not facts.serial or facts.zoom_step is None or facts.focus_step is None:
        raise InputError(
            f"{picture.source} does not say which white image fits it (serial number, zoom and "
            f"focus step): name one white image instead of {where}."
        )
    with white_files(where) as files:
        fitting = [one for one in files if _is_alike(one.metadata, facts)]
        for one in sorted(fitting, key=lambda one: _distance(one.metadata, facts)):
            white = one.read()
            if white.mosaic.mean() < LEAST_MEAN * (2**facts.bits - 1):
                continue
            LOGGER.info(
                f"White image {printable(one.name)}, at zoom and focus step "
                f"{_steps(one.metadata)}; the picture's are {_steps(facts)}"
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


def _steps(metadata: LytroMetadata) -> str:
    steps = (metadata.zoom_step, metadata.focus_step)
    return " and ".join("unknown" if step is None else f"{step:g}" for step in steps)


def holds_white_files(folder: Path) -> bool:
    """Whether a folder, or one inside it, holds white images of a Lytro camera, or archives."""
    inside = _listed(folder)
    paths = inside + [path for one in inside if one.is_dir() for path in _listed(one)]
    return any(PAIRED.fullmatch(path.name) or ARCHIVE.fullmatch(path.name) for path in paths)


@contextmanager
def white_files(where: Path) -> Iterator[list[WhiteFile]]:
    """Find the white images in a folder, in its folders and archives, or in an archive.

    Archives stay open during the block, so that pixels can be read.
    """
    with ExitStack() as opened:
        if not where.is_dir():
            yield opened.enter_context(_archived(where))
            return
        inside = _listed(where)
        found = _paired(inside)
        for path in inside:
            if path.is_dir():
                found += _paired(_listed(path))
            elif ARCHIVE.fullmatch(path.name):
                found += opened.enter_context(_archived(path))
        yield _bounded(found, where)


def _listed(folder: Path) -> list[Path]:
    """Files in a folder, by name; refused if there are too many."""
    try:
        inside = sorted(islice(folder.iterdir(), MOST_MEMBERS + 1))
    except OSError as error:
        raise InputError(f"{folder} cannot be read: {error.strerror}.") from None
    if len(inside) > MOST_MEMBERS:
        raise InputError(f"{folder} has more than {MOST_MEMBERS} files.")
    return inside


def _paired(paths: list[Path]) -> list[WhiteFile]:
    """White images in files of a folder."""
    pairs: dict[str, dict[str, Path]] = {}
    for path in paths:
        if named := PAIRED.fullmatch(path.name):
            pairs.setdefault(named[1].upper(), {})[named[2].upper()] = path
    found = []
    for pair in pairs.values():
        if len(pair) == 2:
            table = parse_table(read_text(pair["TXT"], LARGEST_TXT), pair["TXT"])
            metadata = parse_metadata(table, pair["TXT"])
            read = partial(read_packed, pair["RAW"], metadata)
            found.append(WhiteFile(str(pair["RAW"]), metadata, read))
    return found


class _Member(tarfile.TarInfo):
    """Member of an archive; a negative size would let tarfile read the same header for ever."""

    def _block(self, count):
        if count < 0:
            raise tarfile.InvalidHeaderError("a size is negative")
        return super()._block(count)


@contextmanager
def _archived(path: Path) -> Iterator[list[WhiteFile]]:
    """White images in an archive, which is read without writing any file.

    Only plain files named as white images count: no links.
    """
    with readable(path, TAR_ERRORS, "is no archive of white images"):
        archive = tarfile.open(path, "r:", tarinfo=_Member, errorlevel=2)  # noqa: SIM115
    with archive:
        pairs: dict[str, dict[str, tarfile.TarInfo]] = {}
        with readable(path, TAR_ERRORS, "is no archive of white images"):
            for count, member in enumerate(archive):
                if count >= MOST_MEMBERS:
                    raise InputError(f"{path} has more than {MOST_MEMBERS} members.")
                place = PurePosixPath(member.name)
                named = PAIRED.fullmatch(place.name)
                if named and member.isreg():
                    key = str(place.parent / named[1].upper())
                    pairs.setdefault(key, {})[named[2].upper()] = member
        whole = [pair for pair in pairs.values() if len(pair) == 2]
        yield [_archived_white(archive, pair, path) for pair in _bounded(whole, path)]


def _archived_white(
    archive: tarfile.TarFile, pair: dict[str, tarfile.TarInfo], path: Path
) -> WhiteFile:
    """White image of an archive, from its metadata."""
    name = f"{path}: {PurePosixPath(pair['RAW'].name).name}"
    if pair["TXT"].size > LARGEST_TXT:
        raise InputError(
            f"{name}: its metadata have {pair['TXT'].size:,} bytes, and {LARGEST_TXT:,} are the "
            f"most."
        )
    text = _member_bytes(archive, pair["TXT"], path).decode("utf-8", errors="replace")
    metadata = parse_metadata(parse_table(text, name), name)

    def read() -> bytes:
        check_packed(pair["RAW"].size, metadata, name)
        return _member_bytes(archive, pair["RAW"], path)

    return WhiteFile(name, metadata, read)


def _member_bytes(archive: tarfile.TarFile, member: tarfile.TarInfo, path: Path) -> bytes:
    with readable(path, TAR_ERRORS, "is no archive of white images"):
        file = archive.extractfile(member)
        return b"" if file is None else file.read()


def _bounded(found: list, where: Path) -> list:
    """Refuse more white images than can be compared."""
    if len(found) > MOST_WHITES:
        raise InputError(
            f"{where} holds {len(found)} white images, and {MOST_WHITES} are the most."
        )
    return found
