"""Containers of the Lytro cameras (``.lfp``, ``.lfr``): sections of data, each under its SHA-1.

A container is a header of 16 bytes and sections that begin at multiples of 16 bytes. A section has
a header of 96 bytes: its kind (8 bytes), the length of its data (8 bytes, big endian) and its name
(80 bytes), which is ``sha1-`` and the 40 hexadecimal digits of the data's SHA-1. One section, of
the kind LFM, is a table of contents in JSON, which refers to others by name. The format is not
published; this description follows from files of both cameras.
"""

import hashlib
import re
from pathlib import Path
from typing import Any

from lf_flame._common.input_files import check_memory, check_regular, parse_json, readable
from lf_flame.errors import InputError

START = b"\x89LFP\r\n\x1a\n"
"""First bytes of a container."""

TABLE, CONTENT = b"\x89LFM\r\n\x1a\n", b"\x89LFC\r\n\x1a\n"
"""First bytes of the table of contents, and of any other section."""

ALIGNMENT, HEADER = 16, 96
"""Number of bytes of which the offset of a section is a multiple, and of a section's header."""

NAME = re.compile(rb"(sha1-[0-9a-fA-F]{40})\0*")
"""Name of a section, from the SHA-1 of its data."""


def read_container(path: str | Path) -> tuple[dict[str, Any], dict[str, bytes]]:
    """Read the table of contents, and the sections by their names in small letters."""
    data = read_bytes(path)
    if not data.startswith(START):
        raise InputError(f"{path} is no container of a Lytro camera: it begins otherwise.")
    tables, sections, offset = [], {}, ALIGNMENT
    while (header := data[offset : offset + HEADER]).strip(b"\0"):  # zeros may follow at the end
        kind, length = header[:8], int.from_bytes(header[8:16], "big")
        if kind not in (TABLE, CONTENT):
            raise InputError(
                f"{path} is damaged: at byte {offset:,} no section of a container begins."
            )
        named = NAME.fullmatch(header[16:])
        if named is None and length > 0:
            raise InputError(
                f"{path} is damaged: the section at byte {offset:,} has no SHA-1 for name."
            )
        begin = offset + (HEADER if named else ALIGNMENT)  # empty ones may have a short header
        content = data[begin : begin + length]
        if len(content) < length:
            raise InputError(
                f"{path} is cut: its section at byte {offset:,} should have {length:,} bytes, and "
                f"{len(content):,} are left."
            )
        if named is not None:
            name = named[1].decode().lower()
            if name != f"sha1-{hashlib.sha1(content, usedforsecurity=False).hexdigest()}":
                raise InputError(
                    f"{path} is damaged: its section at byte {offset:,} is not as its SHA-1."
                )
            sections[name] = content
        if kind == TABLE:
            tables.append(content)
        offset = -(-(begin + length) // ALIGNMENT) * ALIGNMENT
    if not tables:
        raise InputError(f"{path} has no table of contents: its end may be missing.")
    return parse_table(tables[0], path), sections


def read_bytes(path: str | Path) -> bytes:
    """Read a regular file whole, if its size may be held."""
    check_memory(2 * check_regular(path), path)
    with readable(path):
        return Path(path).read_bytes()


def check_table_size(size: int, source: str | Path) -> None:
    """Refuse metadata of more than 4 MiB; those of the cameras have some 10 kB."""
    if size > 1 << 22:
        raise InputError(
            f"{source} cannot be read: its metadata have {size:,} bytes, and {1 << 22:,} are the "
            f"most."
        )


def parse_table(data: bytes, source: str | Path) -> dict[str, Any]:
    """Parse JSON of bounded size that must hold names and values."""
    check_table_size(len(data), source)
    try:
        text = data.rstrip(b"\0").decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(
            f"{source} cannot be read: its metadata are no UTF-8, {error.reason} at {error.start}."
        ) from None
    values = parse_json(text, source)
    if not isinstance(values, dict):
        raise InputError(f"{source} cannot be read: its metadata must hold names and values.")
    return values
