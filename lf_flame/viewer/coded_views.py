"""Views as integers of 8 or 16 bits (codes), the form in which graphics processors read them."""

import zlib
from dataclasses import dataclass

import numpy as np

from lf_flame._common.arrays import centred
from lf_flame.errors import InputError
from lf_flame.formats.images import white_of
from lf_flame.lightfield import LightField
from lf_flame.refocus._arguments import as_weights

MOST_BYTES = 256 * 2**20
"""Largest size of the codes in bytes that browsers and graphics processors hold without trouble."""

PIECE_BYTES = 4 * 2**20
"""Largest size of one answer in bytes, so that a page can show progress."""

DARKEST = 1e-30
"""Smallest radiance shown as white, so that codes of a black light field are finite in float32."""


@dataclass(frozen=True, eq=False)
class CodedViews:
    """Views as codes: ``radiance = low + (high - low) codes / levels``."""

    codes: np.ndarray  # uint8 or uint16, (v, u, t, s, channels)
    low: float  # radiance of code 0
    high: float  # radiance of the highest code
    white: float  # radiance shown as white
    positions: tuple[np.ndarray, ...]  # of rows and columns of views, in steps from the centre
    weights: np.ndarray  # of views, (v, u); the aperture's weights multiply them

    @property
    def levels(self) -> int:
        """Highest code."""
        return int(np.iinfo(self.codes.dtype).max)

    def radiance(self) -> np.ndarray:
        """Radiance of the codes: float32, shape (v, u, t, s, channels)."""
        return np.float32(self.low) + self.codes / np.float32(self.levels / (self.high - self.low))


def check_shown(light_field: LightField) -> None:
    """Refuse a light field that is neither grey nor of three channels, or too large for a page."""
    channels, size = light_field.channels, light_field.views.size
    if channels not in (1, 3):
        raise InputError(f"A picture has 1 or 3 channels; this light field has {channels}.")
    if size > MOST_BYTES:
        raise InputError(
            f"A page has room for {MOST_BYTES:,} values (pixels times channels), but this "
            f"light field has {size:,}; "
            f"`lf-flame refocus` takes it."
        )


def shown_white(light_field: LightField) -> float:
    """Radiance that is shown as white, above 0."""
    return max(white_of(light_field), DARKEST)


def encode_views(light_field: LightField, *, white: float | None = None) -> CodedViews:
    """Encode views with 8 bits if that is exact or 16 would exceed `MOST_BYTES`, else with 16 bits.

    `white` is the radiance that is shown as white, and the highest that has a code.
    """
    check_shown(light_field)
    views = light_field.filled if light_field.views.ndim == 5 else light_field.filled[..., None]
    white = shown_white(light_field) if white is None else white
    low, high = min(0.0, float(views.min())), white
    positions = tuple(centred(n) for n in views.shape[:2])
    weights = as_weights(None, light_field)
    for kind in (np.uint8, np.uint16):
        coded = CodedViews(_codes(views, low, high, kind), low, high, white, positions, weights)
        if 2 * views.size > MOST_BYTES or np.array_equal(coded.radiance(), views):
            break
    return coded


def _codes(views: np.ndarray, low: float, high: float, kind: type) -> np.ndarray:
    levels = np.iinfo(kind).max
    codes = views - np.float32(low)
    codes *= np.float32(levels / (high - low))
    return np.clip(np.rint(codes, out=codes), 0, levels, out=codes).astype(kind)


def cut_into_pieces(coded: CodedViews, most_bytes: int = PIECE_BYTES) -> list[tuple[int, int]]:
    """Cut views, counted row by row, into runs of bounded size, the central view first.

    Returns first view and number of views of each run, nearer runs first; a view is never cut.
    """
    rows, columns = coded.codes.shape[:2]
    middle = (rows - 1) // 2 * columns + (columns - 1) // 2
    length = max(most_bytes // coded.codes[0, 0].nbytes, 1)
    runs = [(0, middle), (middle + 1, rows * columns)]
    cut = [
        (first, min(length, end - first))
        for begin, end in runs
        for first in range(begin, end, length)
    ]
    return [(middle, 1), *sorted(cut, key=lambda run: abs(run[0] + run[1] / 2 - middle))]


def piece_bytes(coded: CodedViews, piece: tuple[int, int]) -> bytes:
    """Codes of a run of views, little-endian, in the form that pages read."""
    first, count = piece
    views = coded.codes.reshape(-1, *coded.codes.shape[2:])[first : first + count]
    return views.astype(views.dtype.newbyteorder("<"), copy=False).tobytes()


def deflated(data: bytes) -> bytes:
    """Compress data for a page, which inflates them with the browser's own functions."""
    return zlib.compress(data, 6)
