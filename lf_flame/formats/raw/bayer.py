"""Bayer mosaics: the lattice of each colour's pixels."""

from typing import NamedTuple

from lf_flame.errors import InputError

PATTERNS = ("rggb", "bggr", "grbg", "gbrg")
"""Colours of the upper left 2 x 2 pixels, row by row."""


class Lattice(NamedTuple):
    """Pixels of one colour, two apart in a mosaic; all pixels of a channel otherwise."""

    top: int
    left: int
    source: int
    """Index in the image's last axis."""
    channel: int
    """Channel of the light field."""
    share: float
    """Share in that channel."""


def check_bayer(pattern: str, shape: tuple[int, ...]) -> str:
    """Return the pattern in small letters.

    Raises
    ------
    InputError
        If there is no such pattern, or the image is no mosaic.
    """
    if str(pattern).lower() not in PATTERNS:
        raise InputError(f"bayer must be one of {', '.join(PATTERNS)}, got {pattern!r}.")
    if len(shape) > 2 or any(n % 2 for n in shape):
        raise InputError(
            f"A Bayer mosaic has an even number of rows and of columns and one channel, "
            f"got an image of shape {shape}."
        )
    return str(pattern).lower()


def lattices(pattern: str | None, shape: tuple[int, ...]) -> list[Lattice]:
    """Lattices of an image (rows, columns, channels): the channels, or the pixels of a mosaic."""
    if pattern is None:
        return [Lattice(0, 0, channel, channel, 1.0) for channel in range(shape[2])]
    return [
        Lattice(k // 2, k % 2, 0, "rgb".index(colour), 1 / pattern.count(colour))
        for k, colour in enumerate(pattern)
    ]
