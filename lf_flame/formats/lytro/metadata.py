"""Metadata of a frame of a Lytro camera, from JSON: its pixels, and which white image fits it."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lf_flame.errors import InputError
from lf_flame.formats.raw.sensor_images import PATTERNS

PACKINGS = {10: ("little", 4), 12: ("big", 2)}
"""Byte order of packed pixels, and number of them that fill whole bytes, by their number of bits:
10 in the Illum, 12 in the F01."""


class NestedValues:
    """Values in nested tables, each at the first of several paths that leads to one."""

    def __init__(self, values: dict[str, Any], source: str | Path):
        self.values, self.source = values, source

    def find(self, *paths: str) -> Any:
        """Find the value at the first path (names and slashes) that leads to one, or None."""
        for path in paths:
            value: Any = self.values
            for name in path.split("/"):
                value = value.get(name) if isinstance(value, dict) else None
            if value is not None:
                return value
        return None

    def first_frame(self) -> dict[str, Any]:
        """First entry of the list of frames; empty if there is none."""
        frames = self.find("master/picture/frameArray", "picture/frameArray", "frames")
        first = frames[0] if isinstance(frames, list) and frames else {}
        return first if isinstance(first, dict) else {}

    def text(self, *paths: str) -> str:
        """Find a text, or an empty one if there is none."""
        value = self.find(*paths)
        return value.strip() if isinstance(value, str) else ""

    def number(self, *paths: str) -> float | None:
        """Find a number, or None if there is none."""
        value = self.find(*paths)
        if value is None:
            return None
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise self.error(paths[0], "must be a number", value)
        return float(value)

    def within(self, low: float, high: float, *paths: str) -> float:
        """Find a number within limits, which must be stated."""
        value = self.number(*paths)
        if value is None or not low <= value <= high:
            raise self.error(paths[0], f"must be a number from {low:g} to {high:g}", value)
        return value

    def error(self, path: str, says: str, value: Any) -> InputError:
        """Error that names the file and the path of a value."""
        got = "nothing" if value is None else repr(value)[:60]
        return InputError(f"{self.source}: {path} {says}, got {got}.")


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
    is_dark : bool
        Whether the frame was taken without light.
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
    is_dark: bool

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
    metadata, private metadata and parameters.
    """
    first = NestedValues(values, source).first_frame() or {"frame": {"metadata": values}}
    around = NestedValues(first, source)
    frame = around.find("frame/metadata")
    tree = NestedValues(frame if isinstance(frame, dict) else {}, source)
    rows, columns = (round(tree.within(2, 65536, f"image/{side}")) for side in ("height", "width"))
    names = _mosaic(tree)
    black, white = (_levels(tree, level, names) for level in ("black", "white"))
    if not np.all(white > black):
        raise tree.error("image/pixelFormat/white", "must be above black", white.tolist())
    serial = around.text("frame/privateMetadata/camera/serialNumber")
    return LytroMetadata(
        shape=(rows, columns),
        bits=_bits(tree, rows * columns),
        bayer="".join(name[0] for name in names.flat),
        black=black,
        white=white,
        model=tree.text("camera/model"),
        serial=serial or tree.text("camera/serialNumber"),
        zoom_step=tree.number("devices/lens/zoomStep"),
        focus_step=tree.number("devices/lens/focusStep"),
        is_dark=around.find("parameters/vendorContent/com.lytro.tags/darkFrame") is True,
    )


def _mosaic(tree: NestedValues) -> np.ndarray:
    """Names r, gr, gb, b of the upper left 2 x 2 pixels, from the tile and its first pixel."""
    places = [f"{place}/mosaic" for place in ("image", "image/rawDetails", "devices/sensor")]
    tile = tree.text(*(f"{place}/tile" for place in places))
    first = tree.text(*(f"{place}/upperLeftPixel" for place in places))
    rows = [[name.strip() for name in row.split(",")] for row in tile.split(":")]
    if sorted(sum(rows, [])) == ["b", "gb", "gr", "r"] and [len(row) for row in rows] == [2, 2]:
        names = np.array(rows)
        for shift in np.ndindex(2, 2):
            rolled = np.roll(names, shift, (0, 1))
            if rolled[0, 0] == first and "".join(name[0] for name in rolled.flat) in PATTERNS:
                return rolled
    raise tree.error(places[0], "must be a Bayer mosaic of r, gr, gb and b", f"{tile}; {first}")


def _levels(tree: NestedValues, level: str, names: np.ndarray) -> np.ndarray:
    """Black or white levels of the upper left 2 x 2 pixels, float64."""
    places = [f"{place}/pixelFormat/{level}" for place in ("image", "image/rawDetails")]
    levels = [
        tree.within(0, 65535, *(f"{place}/{name}" for place in places)) for name in names.flat
    ]
    return np.array(levels).reshape(2, 2)


def _bits(tree: NestedValues, pixels: int) -> int:
    """Find the number of bits of a packed pixel; only the cameras' own packings are known."""
    places = ("image/pixelPacking", "image/rawDetails/pixelPacking")
    bits = tree.number(*(f"{place}/bitsPerPixel" for place in places))
    order = tree.text(*(f"{place}/endianness" for place in places))
    shift = tree.number(*(f"{place[:-7]}Format/rightShift" for place in places)) or 0
    if bits not in PACKINGS or order != PACKINGS[int(bits)][0] or shift:
        got = f"{bits} bits, {order or 'no byte order'}, shifted by {shift:g}"
        raise tree.error(places[0], "must be 10 bits little or 12 bits big, not shifted", got)
    group = PACKINGS[int(bits)][1]
    if pixels % group:
        raise tree.error("image", f"must have a multiple of {group} pixels", pixels)
    return int(bits)
