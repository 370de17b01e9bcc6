"""Containers of the Lytro cameras (``.lfp``, ``.lfr``): sections of data, each under its SHA-1.

A container is a header of 16 bytes and sections that begin at multiples of 16 bytes. A section has
a header of 96 bytes: its kind (8 bytes), the length of its data (8 bytes, big endian) and its name
(80 bytes), which is ``sha1-`` and the 40 hexadecimal digits of the data's SHA-1. One section, of
the kind LFM, is a table of contents in JSON, which refers to others by name. The format is not
published; this description follows from files of both cameras.
"""

import hashlib
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

from lf_flame._common.input_files import check_regular, parse_json, readable
from lf_flame._common.memory import check_memory
from lf_flame.errors import InputError

START = b"\x89LFP\r\n\x1a\n"
"""First bytes of a container."""

TABLE, CONTENT = b"\x89LFM\r\n\x1a\n", b"\x89LFC\r\n\x1a\n"
"""First bytes of the table of contents, and of any other section."""

ALIGNMENT = 16
"""Number of bytes of which the offset of a section is a multiple."""

HEADER = 96
"""Number of bytes of a section's header."""

NAME = re.compile(rb"sha1-([0-9a-fA-F]{40})\0*")
"""Name of a section, from the SHA-1 of its data."""

MOST_SECTIONS = 10_000
"""Largest number of sections; pictures have about ten, exported ones some hundred."""

LARGEST_JSON = 1 << 22
"""Largest size of a section of JSON, in bytes; those of the cameras have some 10 kB."""

BLOCK = 1 << 20
"""Number of bytes that are hashed at a time."""


@dataclass(frozen=True)
class Section:
    """Place of a section's data in its file: offset and length in bytes."""

    offset: int
    length: int


@dataclass(frozen=True, eq=False)
class LytroContainer:
    """Sections of a container whose SHA-1 sums are right.

    Attributes
    ----------
    path : Path
    table : dict
        Table of contents.
    sections : dict of str to Section
        Sections by name, in lower case.
    """

    path: Path
    table: dict[str, Any]
    sections: dict[str, Section]

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and name.lower() in self.sections

    def read(self, name: str) -> bytes:
        """Read the data of a section."""
        section = self.sections.get(name.lower())
        if section is None:
            raise InputError(
                f"{self.path} refers to a section {name[:60]!r} that it does not hold."
            )
        check_memory(section.length, self.path)
        with readable(self.path, (OSError,)), self.path.open("rb") as file:
            return _bytes_at(file, section, self.path)

    def read_json(self, name: str) -> dict[str, Any]:
        """Read a section of JSON that holds names and values."""
        section = self.sections.get(name.lower())
        if section is not None and section.length > LARGEST_JSON:
            raise InputError(
                f"{self.path} cannot be read: its metadata have {section.length:,} bytes, and "
                f"{LARGEST_JSON:,} are the most."
            )
        return _parse_bytes(self.read(name), self.path)


def open_container(path: str | Path) -> LytroContainer:
    """Find the sections of a container, and check the SHA-1 of each."""
    path, size = Path(path), check_regular(path)
    tables: list[Section] = []
    sections: dict[str, Section] = {}
    with readable(path, (OSError,)), path.open("rb") as file:
        if file.read(len(START)) != START:
            raise InputError(f"{path} is no container of a Lytro camera: it begins otherwise.")
        offset = ALIGNMENT
        while offset < size and (found := _next_section(file, offset, size, path)):
            kind, name, section = found
            if kind == TABLE:
                tables.append(section)
            if name:
                sections[name] = section
            if len(sections) > MOST_SECTIONS:
                raise InputError(
                    f"{path} cannot be read: it has more than {MOST_SECTIONS} sections."
                )
            end = section.offset + section.length
            offset = -(-end // ALIGNMENT) * ALIGNMENT
        if not tables:
            raise InputError(f"{path} has no table of contents: its end may be missing.")
        if tables[0].length > LARGEST_JSON:
            raise InputError(
                f"{path} cannot be read: its table of contents has {tables[0].length:,} bytes, and "
                f"{LARGEST_JSON:,} are the most."
            )
        table = _parse_bytes(_bytes_at(file, tables[0], path), path)
    return LytroContainer(path, table, sections)


def _next_section(
    file: BinaryIO, offset: int, size: int, path: Path
) -> tuple[bytes, str, Section] | None:
    """Kind, name and place of the section at an offset; None where only zeros are left."""
    file.seek(offset)
    header = file.read(HEADER)
    kind, length = header[:8], int.from_bytes(header[8:16], "big")
    if not header.strip(b"\0"):
        return None
    if kind not in (TABLE, CONTENT):
        raise InputError(f"{path} is damaged: at byte {offset:,} no section of a container begins.")
    name = NAME.fullmatch(header[16:])
    if length == 0 and name is None:  # empty sections may have a header of 16 bytes alone
        return kind, "", Section(offset + ALIGNMENT, 0)
    if name is None:
        raise InputError(
            f"{path} is damaged: the section at byte {offset:,} has no SHA-1 for name."
        )
    section = Section(offset + HEADER, length)
    if section.offset + length > size:
        raise InputError(
            f"{path} is cut: its section at byte {offset:,} should have {length:,} bytes, and "
            f"{max(size - section.offset, 0):,} are left."
        )
    if _sha1(file, length) != name[1].decode().lower():
        raise InputError(f"{path} is damaged: its section at byte {offset:,} is not as its SHA-1.")
    return kind, f"sha1-{name[1].decode().lower()}", section


def _sha1(file: BinaryIO, length: int) -> str:
    """SHA-1 of the next bytes of a file, in blocks, so that memory stays small."""
    digest = hashlib.sha1(usedforsecurity=False)
    while length > 0 and (block := file.read(min(length, BLOCK))):
        digest.update(block)
        length -= len(block)
    return digest.hexdigest()


def _bytes_at(file: BinaryIO, section: Section, path: Path) -> bytes:
    file.seek(section.offset)
    data = file.read(section.length)
    if len(data) < section.length:
        raise InputError(f"{path} has become shorter while it was read.")
    return data


def _parse_bytes(data: bytes, source: str | Path) -> dict[str, Any]:
    try:
        text = data.rstrip(b"\0").decode("utf-8")
    except UnicodeDecodeError as error:
        raise InputError(
            f"{source} cannot be read: its metadata are no UTF-8, {error.reason} at {error.start}."
        ) from None
    return parse_table(text, source)


def parse_table(text: str, source: str | Path) -> dict[str, Any]:
    """Parse JSON that must hold names and values."""
    values = parse_json(text.removeprefix("\ufeff"), source)  # a byte order mark
    if not isinstance(values, dict):
        raise InputError(f"{source} cannot be read: its metadata must hold names and values.")
    return values
