"""Views for a page of bounded size: unchanged if they fit, else with fewer bits or views."""

import io
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
from PIL import Image

from lf_flame.errors import InputError
from lf_flame.viewer.coded_views import CodedViews, cut_into_pieces, deflated, piece_bytes


@dataclass(frozen=True, eq=False)
class ShrunkViews:
    """Views as stored in a page."""

    coded: CodedViews  # as the page decodes them, apart from JPEG errors
    pieces: list[tuple[int, int]]  # first view and number of views of each
    data: list[bytes]  # compressed pieces
    coding: str  # "deflate" or "jpeg"
    quality: str  # accuracy of the views, in words

    @property
    def length(self) -> int:
        """Number of characters that the pieces take in a page, including their elements."""
        return sum(-(-len(piece) // 3) * 4 + 64 for piece in self.data)


def shrink(coded: CodedViews, most_bytes: int, carried: int, *, exact: bool = False) -> ShrunkViews:
    """Compress views as exactly as fits into a page of `most_bytes`, `carried` without them.

    Views that no form makes small enough are refused; with `exact`, so are all but the first form.
    """
    for shrunk in islice(_ways(coded), 1 if exact else None):
        if shrunk.length <= most_bytes - carried:
            return shrunk
    needed = math.ceil((shrunk.length + carried) / 1e5) / 10
    what = "all planes" if exact else "a few of the views as coarse JPEG images"
    raise InputError(
        f"A page with {what} needs {needed:.1f} MB, but {most_bytes / 1e6:g} MB are allowed; allow "
        f"that many (--megabytes {needed:.1f})."
    )


def _ways(coded: CodedViews) -> Iterator[ShrunkViews]:
    bits = coded.codes.dtype.itemsize * 8
    yield _packed(coded, f"all views, with {bits} bits")
    if bits == 16:
        coded = replace(coded, codes=np.rint(coded.codes / np.float32(257)).astype(np.uint8))
        yield _packed(coded, "preview: views of 8 bits instead of 16")
    whole = coded.codes.shape[:2]
    while True:
        for quality in (92, 85, 75):
            yield _as_jpeg(coded, quality, whole)
        if max(coded.codes.shape[:2]) <= 3:
            return
        coded = _thinned(coded)


def _packed(coded: CodedViews, quality: str) -> ShrunkViews:
    pieces = cut_into_pieces(coded)
    data = [deflated(piece_bytes(coded, piece)) for piece in pieces]
    return ShrunkViews(coded, pieces, data, "deflate", quality)


def _as_jpeg(coded: CodedViews, quality: int, whole: tuple) -> ShrunkViews:
    pieces = cut_into_pieces(coded, 0)  # one view each
    views = coded.codes.reshape(-1, *coded.codes.shape[2:])
    data = [_jpeg(views[first], quality) for first, _ in pieces]
    decibels = np.mean([_psnr(views[k], data[i]) for i, (k, _) in enumerate(pieces[:9])])
    words = f"preview: views as JPEG of quality {quality}, {decibels:.1f} dB"
    if coded.codes.shape[:2] != whole:
        words += f", {'{} × {}'.format(*coded.codes.shape[:2])} of the {'{} × {}'.format(*whole)}"
    return ShrunkViews(coded, pieces, data, "jpeg", words)


def _jpeg(view: np.ndarray, quality: int) -> bytes:
    file = io.BytesIO()
    image = Image.fromarray(view[..., 0] if view.shape[2] == 1 else view)
    image.save(file, "JPEG", quality=quality, subsampling=0, optimize=True)
    return file.getvalue()


def _psnr(view: np.ndarray, jpeg: bytes) -> float:
    decoded = np.asarray(Image.open(io.BytesIO(jpeg)), float).reshape(view.shape)
    return 20 * np.log10(255 / max(np.sqrt(np.mean((decoded - view) ** 2)), 1e-3))


def _thinned(coded: CodedViews) -> CodedViews:
    """Keep every second row and column of views, counted outward from the centre."""
    kept = [_every_second(len(at)) for at in coded.positions]
    positions = tuple(at[some] for at, some in zip(coded.positions, kept, strict=True))
    some = np.ix_(*kept)
    return replace(coded, codes=coded.codes[some], positions=positions, weights=coded.weights[some])


def _every_second(count: int) -> list[int]:
    """Choose indices symmetric about the centre; up to three are all kept."""
    if count <= 3:
        return list(range(count))
    outward = range(0, count // 2 + count % 2, 2)
    middle = (count - 1) // 2
    return sorted({middle - k for k in outward} | {count - 1 - middle + k for k in outward})
