"""HTML for notebooks: pictures, tables and drawings, without scripts."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from PIL import Image
from tabulate import tabulate

MOST_BYTES = 40_000
"""Largest size of a picture in bytes: a notebook keeps every picture it has shown."""

WIDTH, HEIGHT, MARGIN = 360, 180, 28
"""Width, height and margin of a drawing, in CSS pixels."""


def picture(levels: np.ndarray, words: str) -> str:
    """Image element of 8-bit levels, shape (h, w) or (h, w, 3), reduced if it is too large.

    Parameters
    ----------
    levels : ndarray of uint8
    words : str
        Alternative text: what the picture shows.
    """
    image = Image.fromarray(levels)
    data = _as_png(image)
    while len(data) > MOST_BYTES:
        image = image.reduce(2)
        data = _as_png(image)
    height, width = levels.shape[:2]
    return (
        f'<img alt="{html.escape(words)}" width="{min(width, WIDTH)}" '
        f'style="aspect-ratio: {width} / {height}" '
        f'src="data:image/png;base64,{base64.b64encode(data).decode()}">'
    )


def _as_png(image: Image.Image) -> bytes:
    file = io.BytesIO()
    image.save(file, "PNG", optimize=True)
    return file.getvalue()


def table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Table with the name of each row in its first column; all cells are text, not HTML."""
    return tabulate(rows, headings, tablefmt="html", disable_numparse=True)


def paragraph(words: str) -> str:
    """Paragraph of text."""
    return f"<p>{html.escape(words)}</p>"


class Drawing:
    """Lines in the units of two axes, as SVG.

    Parameters
    ----------
    across, upward : (float, float)
        Ends of the axes; equal ends are moved apart by 1 each.
    labels : (str, str)
        Names of the quantities on the axes, with their units.
    """

    def __init__(
        self, across: tuple[float, float], upward: tuple[float, float], labels: tuple[str, str]
    ):
        self._ends = [_apart(*ends) for ends in (across, upward)]
        self._labels = labels
        self._lines: list[str] = []

    def line(self, x: ArrayLike, y: ArrayLike, dashed: bool = False) -> None:
        """Draw a line through points."""
        places = zip(self._place(x, 0), self._place(y, 1), strict=True)
        points = " ".join(f"{right:.1f},{down:.1f}" for right, down in places)
        dashes = ' stroke-dasharray="4 3"' if dashed else ""
        self._lines.append(
            f'<polyline points="{points}" fill="none" stroke="currentColor" '
            f'stroke-width="{1 if dashed else 2}"{dashes}/>'
        )

    def _place(self, values: ArrayLike, axis: int) -> np.ndarray:
        low, high = self._ends[axis]
        share = (np.asarray(values, float) - low) / (high - low)
        if axis == 0:
            return MARGIN + share * (WIDTH - 2 * MARGIN)
        return HEIGHT - MARGIN - share * (HEIGHT - 2 * MARGIN)

    def svg(self, words: str) -> str:
        """SVG of the drawing; `words` is its alternative text."""
        (left, right), (low, high) = self._ends
        texts = [
            (MARGIN, HEIGHT - 8, "start", f"{left:.3g}"),
            (WIDTH - MARGIN, HEIGHT - 8, "end", f"{right:.3g}"),
            (WIDTH / 2, HEIGHT - 8, "middle", self._labels[0]),
            (4, 12, "start", f"{self._labels[1]}, {low:.3g} to {high:.3g}"),
        ]
        written = "".join(
            f'<text x="{x}" y="{y}" text-anchor="{anchor}" font-size="11" fill="currentColor">'
            f"{html.escape(text)}</text>"
            for x, y, anchor, text in texts
        )
        return (
            f'<svg role="img" aria-label="{html.escape(words)}" width="{WIDTH}" '
            f'height="{HEIGHT}" xmlns="http://www.w3.org/2000/svg">'
            f"{''.join(self._lines)}{written}</svg>"
        )


def _apart(low: float, high: float) -> tuple[float, float]:
    return (low, high) if high > low else (low - 1.0, high + 1.0)
