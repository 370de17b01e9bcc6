"""Pictures of the Lytro cameras: metadata, packed pixels, and their containers.

A container (``.lfp``, ``.lfr``) is a header of 16 bytes and sections that begin at multiples of 16
bytes. A section has a header of 96 bytes: its kind (8 bytes), the length of its data (8 bytes, big
endian) and its name (80 bytes), which is ``sha1-`` and the 40 hexadecimal digits of the data's
SHA-1. One section, of the kind LFM, is a table of contents in JSON, which refers to others by name.
The format is not published; this description follows from files of both cameras.
"""

import hashlib
import re
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from lf_flame._common.input_files import check_memory, check_regular, parse_json, readable
from lf_flame.errors import InputError
from lf_flame.formats.images import CONTAINER_SUFFIXES

PACKINGS = {10: "little", 12: "big"}
"""Byte order of packed pixels by their number of bits: 10 in the Illum, 12 in the F01."""

MOSAICS = {"r": "r gr gb b", "gr": "gr r b gb", "gb": "gb b r gr", "b": "b gb gr r"}
"""Upper left 2 x 2 pixels of the cameras' mosaic, row by row, by the first of them."""

FRAMES = ("master/picture/frameArray", "picture/frameArray", "frames")
"""Paths of the list of frames in tables of contents and in the metadata of white images."""

TEXT, NUMBER, TABLE = (str,), (int, float), (dict,)
"""Types of values in JSON."""

CONTENTS, SECTION = b"\x89LFM\r\n\x1a\n", b"\x89LFC\r\n\x1a\n"
"""First bytes of the table of contents, and of any other section."""

ALIGNMENT, HEADER = 16, 96
"""Number of bytes of which the offset of a section is a multiple, and of a section's header."""


# Metadata -----------------------------------------------------------------------------------------


def find(values: Any, types: tuple[type, ...], *paths: str) -> Any:
    """Find a value of given types at the first path, names and slashes, that leads to one, or None.

    A list stands for its first entry.
    """
    for path in paths:
        value = values
        for name in path.split("/"):
            value = value.get(name) if isinstance(value, dict) else None
            value = value[0] if isinstance(value, list) and value else value
        if type(value) in types:
            return value
    return None


@dataclass(frozen=True, eq=False)
class LytroMetadata:
    """Metadata of a frame; what the file does not state is None, or empty.

    `bayer` and the levels `black` (no light) and `white` (full scale) are those of the upper left
    2 x 2 pixels. White images are chosen by the positions of the lens's motors.
    """

    shape: tuple[int, int]
    bits: int
    bayer: str
    black: np.ndarray
    white: np.ndarray
    model: str
    serial: str
    zoom_step: float | None
    focus_step: float | None


def parse_metadata(values: dict[str, Any], source: str | Path) -> LytroMetadata:
    """Parse the metadata of a frame of either camera.

    values: metadata of a frame; or a table with a list of frames, the first of which contains its
    metadata and private metadata.
    """
    around = find(values, TABLE, *FRAMES) or {"frame": {"metadata": values}}
    tree = find(around, TABLE, "frame/metadata")
    image: dict[str, Any] = {}
    for place in ("devices/sensor", "image/rawDetails", "image"):  # Illum, F01, both
        image |= find(tree, TABLE, place) or {}

    def number(path: str, low: int, high: int) -> float:
        value = find(image, NUMBER, path)
        if value is None or not low <= value <= high:
            raise InputError(
                f"{source}: image/{path} must be a number from {low} to {high}, got {value}."
            )
        return value

    rows, columns = (round(number(side, 2, 65536)) for side in ("height", "width"))
    tile, first = (find(image, TEXT, f"mosaic/{name}") for name in ("tile", "upperLeftPixel"))
    if tile != "r,gr:gb,b" or first not in MOSAICS:
        raise InputError(
            f"{source}: image/mosaic must be a Bayer mosaic, r,gr:gb,b, from one of its pixels on, "
            f"got {tile} from {first} on."
        )
    names = MOSAICS[first].split()
    black, white = (
        np.array([number(f"pixelFormat/{level}/{x}", 0, 65535) for x in names]).reshape(2, 2)
        for level in ("black", "white")
    )
    if not np.all(white > black):
        raise InputError(f"{source}: white levels must be above black, got {white.tolist()}.")
    bits = find(image, NUMBER, "pixelPacking/bitsPerPixel")
    order = find(image, TEXT, "pixelPacking/endianness")
    shift = find(image, NUMBER, "pixelFormat/rightShift") or 0
    if bits not in PACKINGS or order != PACKINGS[bits] or shift or rows % 2 or columns % 2:
        raise InputError(
            f"{source}: the image must have even numbers of rows and columns, packed in 10 bits "
            f"little or 12 bits big, and not shifted, got {rows} x {columns} pixels in {bits} bits "
            f"{order}, shifted by {shift:g}."
        )
    private = find(around, TEXT, "frame/privateMetadata/camera/serialNumber")
    return LytroMetadata(
        shape=(rows, columns),
        bits=int(bits),
        bayer="".join(name[0] for name in names),
        black=black,
        white=white,
        model=find(tree, TEXT, "camera/model") or "",
        serial=(private or find(tree, TEXT, "camera/serialNumber") or "").strip(),
        zoom_step=find(tree, NUMBER, "devices/lens/zoomStep"),
        focus_step=find(tree, NUMBER, "devices/lens/focusStep"),
    )


# Pictures -----------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class LytroPicture:
    """Picture of a Lytro camera: its packed pixels, and what the file says about it.

    `source` is the name of the file, for messages; `white_image` that in the file, if any.
    """

    metadata: LytroMetadata
    packed: bytes = field(repr=False)
    source: str
    white_image: "LytroPicture | None" = None

    def __post_init__(self) -> None:
        (rows, columns), bits = self.metadata.shape, self.metadata.bits
        if len(self.packed) != rows * columns * bits // 8:
            raise InputError(
                f"{self.source} must have {rows * columns * bits // 8:,} bytes, {rows} x {columns} "
                f"pixels of {bits} bits by its metadata, got {len(self.packed):,}."
            )

    @cached_property
    def mosaic(self) -> np.ndarray:
        """Levels as the sensor counted them, one colour per pixel: uint16, (rows, columns)."""
        rows, columns = self.metadata.shape
        check_memory(16 * rows * columns, self.source)  # also for floats with a copy
        data = np.frombuffer(self.packed, np.uint8)
        if self.metadata.bits == 10:
            # Four pixels in five bytes: the high 8 bits of each, then the low 2 bits of all four.
            groups = data.reshape(-1, 5)
            levels = groups[:, :4].astype(np.uint16) << 2
            for k in range(4):
                levels[:, k] |= (groups[:, 4] >> 2 * k) & 3
        else:
            # Two pixels in three bytes: the middle one has the low 4 bits and the next high 4 bits.
            high, middle, low = (data[k::3].astype(np.uint16) for k in range(3))
            levels = np.stack([high << 4 | middle >> 4, (middle & 15) << 8 | low], axis=-1)
        return levels.reshape(rows, columns)

    @cached_property
    def radiance(self) -> np.ndarray:
        """Mosaic linear in radiance, float32: 0 at the black level and 1 at the white level."""
        rows, columns = self.metadata.shape
        cells = self.mosaic.reshape(rows // 2, 2, columns // 2, 2)
        levels = self.metadata.black, self.metadata.white
        black, white = (level[:, None].astype(np.float32) for level in levels)
        return ((cells - black) / (white - black)).reshape(rows, columns)


def read_lytro(path: str | Path) -> LytroPicture:
    """Read a raw picture of a Lytro camera: a container, whose sections must have their SHA-1.

    Or packed pixels, with their metadata beside them in ``.json`` or ``.txt``.
    """
    path = Path(path)
    if path.suffix.lower() not in CONTAINER_SUFFIXES:
        return LytroPicture(parse_metadata(_description(path), path), read_bytes(path), str(path))
    table, sections = read_container(path)
    refs = find(table, TABLE, *(f"{place}/frame" for place in FRAMES)) or {}
    held = {name: sections.get(str(ref).lower()) for name, ref in refs.items()}
    facts, packed = held.get("metadataRef"), held.get("imageRef")
    if facts is None or packed is None:
        raise InputError(
            f"{path} contains no raw image of the sensor: export the raw picture (.lfr, or .lfp) "
            f"from the camera's library."
        )
    frame = {"metadata": parse_table(facts, path)}
    if (private := held.get("privateMetadataRef")) is not None:
        frame["privateMetadata"] = parse_table(private, path)
    metadata = parse_metadata({"frames": [{"frame": frame}]}, path)
    white = None
    if (flat := held.get("modulationDataRef")) is not None:
        white = LytroPicture(metadata, flat, f"the white image in {path}")
    return LytroPicture(metadata, packed, str(path), white)


def _description(path: Path) -> dict[str, Any]:
    """Metadata of a ``.raw`` file, from the file of the same name beside it."""
    check_regular(path)
    for ending in (".json", ".JSON", ".txt", ".TXT"):
        beside = path.with_suffix(ending)
        if beside.is_file():
            return parse_table(read_bytes(beside), beside)
    raise InputError(
        f"{path} contains packed pixels without a description: put the camera's metadata beside it "
        f"as {path.with_suffix('.json').name} (Lytro), or export the image as PNG or TIFF."
    )


# Containers and tables ---------------------------------------------------------------------------


def read_container(path: str | Path) -> tuple[dict[str, Any], dict[str, bytes]]:
    """Read the table of contents, and the sections by their names in lower case."""
    data = read_bytes(path)
    if not data.startswith(b"\x89LFP\r\n\x1a\n"):
        raise InputError(f"{path} is not a container of a Lytro camera: its first bytes differ.")
    table, sections, offset = None, {}, ALIGNMENT
    while (header := data[offset : offset + HEADER]).strip(b"\0"):  # zeros may follow at the end
        kind, length = header[:8], int.from_bytes(header[8:16], "big")
        named = re.fullmatch(rb"(sha1-[0-9a-fA-F]{40})\0*", header[16:])
        begin = offset + (HEADER if named else ALIGNMENT)  # empty ones may have a short header
        content = data[begin : begin + length]
        name = named[1].decode().lower() if named else None
        digest = hashlib.sha1(content, usedforsecurity=False).hexdigest()
        if kind not in (CONTENTS, SECTION) or (name != f"sha1-{digest}" if name else length > 0):
            raise InputError(
                f"{path} is damaged or truncated: at byte {offset:,} there is no section whose "
                f"data match their SHA-1."
            )
        if name is not None:
            sections[name] = content
        if kind == CONTENTS and table is None:
            table = content
        offset = -(-(begin + length) // ALIGNMENT) * ALIGNMENT
    if table is None:
        raise InputError(f"{path} has no table of contents: its end may be missing.")
    return parse_table(table, path), sections


def read_bytes(path: str | Path) -> bytes:
    """Read all of a regular file, if twice its size fits into memory."""
    check_memory(2 * check_regular(path), path)
    with readable(path):
        return Path(path).read_bytes()


def parse_table(data: bytes, source: str | Path) -> dict[str, Any]:
    """Parse JSON that must contain names and values; those of the cameras have about 10 kB."""
    if len(data) > 1 << 22:
        raise InputError(
            f"{source} cannot be read: its metadata have {len(data):,} bytes, more than the "
            f"{1 << 22:,} allowed."
        )
    values = parse_json(data.rstrip(b"\0").decode("utf-8-sig", "replace"), source)
    if not isinstance(values, dict):
        raise InputError(f"{source} cannot be read: its metadata must contain names and values.")
    return values
