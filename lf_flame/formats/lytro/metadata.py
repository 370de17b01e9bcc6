"""Metadata of a frame of a Lytro camera, from JSON: its pixels, and which white image fits it."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lf_flame.errors import InputError

PACKINGS = {10: "little", 12: "big"}
"""Byte order of packed pixels by their number of bits: 10 in the Illum, 12 in the F01."""

MOSAICS = {"r": "r gr gb b", "gr": "gr r b gb", "gb": "gb b r gr", "b": "b gb gr r"}
"""Upper left 2 x 2 pixels of the cameras' mosaic, row by row, by the first of them."""

FRAMES = ("master/picture/frameArray", "picture/frameArray", "frames")
"""Places of the list of frames in tables of contents and in the metadata of white images."""

TEXT, NUMBER, TABLE = (str,), (int, float), (dict,)


def find(values: Any, types: tuple[type, ...], *paths: str) -> Any:
    """Find a value of some types at the first path, names and slashes, that leads to one, or None.

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
    """Facts of a frame; what the file does not say is None, or empty.

    Attributes
    ----------
    shape : (int, int)
        Number of rows and columns of the frame.
    bits : int
        Number of bits of a packed pixel, 10 or 12.
    bayer : str
        Colours of the upper left 2 x 2 pixels, row by row: rggb, bggr, grbg or gbrg.
    black, white : ndarray of float64, shape (2, 2)
        Levels of no light and of full scale of the upper left 2 x 2 pixels.
    model, serial : str
        Name and serial number of the camera.
    zoom_step, focus_step : float or None
        Positions of the lens's motors, by which white images are chosen.
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

    def check_size(self, size: int, source: str | Path) -> None:
        """Refuse packed pixels of another number of bytes than the frame's."""
        rows, columns = self.shape
        if size != rows * columns * self.bits // 8:
            raise InputError(
                f"{source} must hold {rows * columns * self.bits // 8:,} bytes, {rows} x {columns} "
                f"pixels of {self.bits} bits as its metadata say, got {size:,}."
            )


def parse_metadata(values: dict[str, Any], source: str | Path) -> LytroMetadata:
    """Take the facts out of the metadata of a frame of either camera.

    values: metadata of a frame; or a table with a list of frames, the first of which holds its
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
    if bits not in PACKINGS or order != PACKINGS[bits] or shift or rows * columns % 4:
        raise InputError(
            f"{source}: the image must have a multiple of 4 pixels, packed in 10 bits little or 12 "
            f"bits big, and not shifted, got {rows} x {columns} pixels in {bits} bits {order}, "
            f"shifted by {shift:g}."
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
