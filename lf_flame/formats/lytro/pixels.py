"""Packed pixels of the Lytro cameras: 10 bits (Illum) and 12 bits (F01)."""

from pathlib import Path

import numpy as np

from lf_flame._common.input_files import check_regular, readable
from lf_flame.errors import InputError
from lf_flame.formats.lytro.metadata import LytroMetadata

BYTES_A_PIXEL = 16
"""Memory of a picture in bytes per pixel: packed, as levels, and as floats with a copy."""


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
