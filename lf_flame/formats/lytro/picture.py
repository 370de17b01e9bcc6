"""Pictures of the Lytro cameras: packed pixels and white image, from their files."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from lf_flame._common.input_files import check_regular, read_text, readable
from lf_flame._common.memory import check_memory
from lf_flame.errors import InputError
from lf_flame.formats.images import CONTAINER_SUFFIXES
from lf_flame.formats.lytro.container import (
    LARGEST_JSON,
    LytroContainer,
    open_container,
    parse_table,
)
from lf_flame.formats.lytro.metadata import LytroMetadata, NestedValues, parse_metadata, tables

DESCRIPTIONS = (".json", ".JSON", ".txt", ".TXT")
"""File endings of the metadata beside a ``.raw`` file."""


BYTES_A_PIXEL = 16
"""Memory of a picture in bytes per pixel: packed, as levels, and as floats with a copy."""


@dataclass(frozen=True, eq=False)
class LytroPicture:
    """Picture of a Lytro camera: its raw mosaic, and what the file says about it.

    Attributes
    ----------
    metadata : LytroMetadata
        Sensor, lens, lenslets and names.
    mosaic : ndarray of uint16, shape (rows, columns)
        Levels as the sensor counted them, one colour a pixel (`LytroMetadata.bayer`).
    source : str
        Name of the file, for messages.
    white_image : LytroPicture or None
        White image that the file holds, if any.
    """

    metadata: LytroMetadata
    mosaic: np.ndarray
    source: str
    white_image: "LytroPicture | None" = None

    @cached_property
    def radiance(self) -> np.ndarray:
        """Mosaic linear in radiance, float32: 0 at the black level and 1 at the white level."""
        out = np.empty(self.mosaic.shape, np.float32)
        black, span = self.metadata.black, self.metadata.white - self.metadata.black
        for i, j in np.ndindex(2, 2):
            levels = self.mosaic[i::2, j::2].astype(np.float32)
            out[i::2, j::2] = (levels - np.float32(black[i, j])) / np.float32(span[i, j])
        return out


class LytroFile:
    """Open picture file of a Lytro camera, of which nothing is unpacked yet.

    Parameters
    ----------
    path : str or Path
        Container, or ``.raw`` file with its metadata beside it under the same name.

    Raises
    ------
    InputError
        If the file cannot be read, is damaged, or has no metadata.
    """

    def __init__(self, path: str | Path):
        self.path = Path(path)
        self.container: LytroContainer | None = None
        self.metadata: LytroMetadata | None = None
        self._refs: dict[str, Any] = {}
        self._table = NestedValues({}, path)
        if self.path.suffix.lower() not in CONTAINER_SUFFIXES:
            self.metadata = parse_metadata(_description(self.path), self.path)
            return
        self.container = container = open_container(path)
        self._table = NestedValues(container.table, path)
        frames = self._table.find("picture/frameArray", "frames")
        refs = next(iter(tables(frames)), {}).get("frame")
        self._refs = refs if isinstance(refs, dict) else {}
        if self._held("metadataRef"):
            private = self._held("privateMetadataRef")
            self.metadata = parse_metadata(
                container.read_json(self._refs["metadataRef"]),
                path,
                container.read_json(self._refs["privateMetadataRef"]) if private else None,
            )
        elif isinstance(self._refs.get("metadata"), dict):  # of a processed file
            self.metadata = parse_metadata(self._refs, path)

    def _held(self, name: str) -> bool:
        """Whether the frame refers to a section by this name, and the container holds it."""
        return self.container is not None and self._refs.get(name) in self.container

    @property
    def has_raw(self) -> bool:
        """Whether the file holds the sensor's pixels."""
        return self.metadata is not None and (self.container is None or self._held("imageRef"))

    @property
    def has_white(self) -> bool:
        """Whether the file holds its own white image."""
        return self._held("modulationDataRef")

    def read(self) -> LytroPicture:
        """Unpack the picture, and the white image that the file holds."""
        if self.metadata is None or not self.has_raw:
            raise InputError(
                f"{self.path} holds no raw image of the sensor: export the raw picture from the "
                f"camera's library."
            )
        check_memory(BYTES_A_PIXEL * (1 + self.has_white) * self.mosaic_pixels, self.path)
        if self.container is None:
            packed = read_packed(self.path, self.metadata)
        else:
            packed = self.container.read(self._refs["imageRef"])
        mosaic = unpack(packed, self.metadata, self.path)
        white = None
        if self.container is not None and self.has_white:
            packed = self.container.read(self._refs["modulationDataRef"])
            name = f"the white image in {self.path}"
            white = LytroPicture(self.metadata, unpack(packed, self.metadata, name), name)
        return LytroPicture(self.metadata, mosaic, str(self.path), white)

    @property
    def mosaic_pixels(self) -> int:
        """Number of pixels of the sensor, 0 without metadata."""
        return 0 if self.metadata is None else self.metadata.shape[0] * self.metadata.shape[1]


def read_lytro(path: str | Path) -> LytroPicture:
    """Read a raw picture of a Lytro camera, F01 or Illum.

    Parameters
    ----------
    path : str or Path
        Container (``.lfp``, ``.lfr``), whose sections are checked by their SHA-1; or packed pixels
        (``.raw``) with their metadata beside them, in ``.json`` or ``.txt`` under the same name.

    Returns
    -------
    LytroPicture

    Raises
    ------
    InputError
        If the file cannot be read, is damaged or is cut, holds no raw picture, or is packed in
        another way than those of the two cameras.

    Examples
    --------
    >>> import json
    >>> from pathlib import Path
    >>> from lf_flame.formats import read_lytro
    >>> image = {
    ...     "height": 2, "width": 4,
    ...     "pixelPacking": {"bitsPerPixel": 10, "endianness": "little"},
    ...     "mosaic": {"tile": "r,gr:gb,b", "upperLeftPixel": "gr"},
    ...     "pixelFormat": {
    ...         "black": dict.fromkeys(["r", "gr", "gb", "b"], 64),
    ...         "white": dict.fromkeys(["r", "gr", "gb", "b"], 1023),
    ...     },
    ... }
    >>> _ = Path("picture.json").write_text(json.dumps({"image": image}))
    >>> _ = Path("picture.raw").write_bytes(bytes([16, 255, 0, 0, 0b1100, 0, 0, 0, 0, 0]))
    >>> picture = read_lytro("picture.raw")
    >>> picture.metadata.bayer, picture.mosaic[0].tolist(), picture.radiance[0, :2].tolist()
    ('grbg', [64, 1023, 0, 0], [0.0, 1.0])
    """
    return LytroFile(path).read()


def _description(path: Path) -> dict[str, Any]:
    """Metadata of a ``.raw`` file, from the file of the same name beside it."""
    check_regular(path)
    for ending in DESCRIPTIONS:
        beside = path.with_suffix(ending)
        if beside.is_file():
            return parse_table(read_text(beside, LARGEST_JSON), beside)
    raise InputError(
        f"{path} is packed pixels without a description: put the camera's metadata beside it as "
        f"{path.with_suffix('.json').name} (Lytro), or export the image as PNG or TIFF."
    )


def unpack(packed: bytes, metadata: LytroMetadata, source: str | Path) -> np.ndarray:
    """Unpack pixels of 10 bits (Illum) or 12 bits (F01) into uint16, shape (rows, columns)."""
    check_packed(len(packed), metadata, source)
    data = np.frombuffer(packed, np.uint8)
    levels = _unpack_ten(data) if metadata.bits == 10 else _unpack_twelve(data)
    return levels.reshape(metadata.shape)


def check_packed(size: int, metadata: LytroMetadata, source: str | Path) -> None:
    """Refuse packed pixels of another size than that of the metadata's pixels."""
    rows, columns = metadata.shape
    if size != metadata.packed_size:
        raise InputError(
            f"{source} must hold {metadata.packed_size:,} bytes, {rows} x {columns} pixels of "
            f"{metadata.bits} bits as its metadata say, got {size:,}."
        )


def _unpack_ten(data: np.ndarray) -> np.ndarray:
    """Four pixels in five bytes: the high 8 bits of each, then the low 2 bits of all four."""
    groups = data.reshape(-1, 5)
    levels = groups[:, :4].astype(np.uint16) << 2
    for k in range(4):
        levels[:, k] |= (groups[:, 4] >> 2 * k) & 3
    return levels


def _unpack_twelve(data: np.ndarray) -> np.ndarray:
    """Two pixels in three bytes: the middle one holds the low 4 bits and the next high 4 bits."""
    high, middle, low = (data[k::3].astype(np.uint16) for k in range(3))
    return np.stack([high << 4 | middle >> 4, (middle & 15) << 8 | low], axis=-1)


def read_packed(path: Path, metadata: LytroMetadata) -> bytes:
    """Read the packed pixels of a ``.raw`` file, after a check of its size."""
    check_packed(check_regular(path), metadata, path)
    with readable(path, (OSError,)), path.open("rb") as file:
        return file.read(metadata.packed_size)
