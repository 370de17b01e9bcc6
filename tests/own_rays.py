"""Light fields of Gaussian sheets by thin-lens rays that are written out here.

Nothing of the package's optics is used. A lens of focal length f focuses a plane at the distance a
on lenslets at the distance i, 1/f = 1/a + 1/i. View v looks through the place
``x = (v - centre) step`` of the lens, step = i pitch / (N f_lenslet), and lenslet t sees the place
``y = (t - centre) pitch a / i`` of the plane in focus: a ray meets the depth d behind that plane at
``y + (y - x) d / a``. A pixel is the mean over the squares of its lenslet and of its part of the
lens, which for a Gaussian factorises.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import erf

NODES, WEIGHTS = np.polynomial.legendre.leggauss(6)


@dataclass(frozen=True)
class Lens:
    """A camera: lengths in mm."""

    views: int = 7
    lenslets: tuple[int, int] = (72, 84)
    focal: float = 150.0
    focus: float = 326.0
    lenslet_focal: float = 0.4
    pitch: float = 0.112

    @property
    def image(self):
        return 1 / (1 / self.focal - 1 / self.focus)

    @property
    def cell(self):
        """Side of a lenslet's picture in the plane in focus."""
        return self.pitch * self.focus / self.image

    @property
    def step(self):
        return self.image * self.pitch / (self.views * self.lenslet_focal)


@dataclass(frozen=True)
class Sheet:
    """A glow of ``peak exp(-((y - y0) / sy)^2 - ((x - x0) / sx)^2)`` at one depth."""

    depth: float
    middle: tuple[float, float]
    width: tuple[float, float]
    peak: float = 1.0


def _line(lens, sheet, axis, rim=None):
    """Mean of a Gaussian over each pixel along an axis, shape (views, lenslets)."""
    count = lens.lenslets[axis]
    at = (np.arange(count) - (count - 1) / 2)[:, None, None] + NODES[:, None] / 2
    lens_at = (np.arange(lens.views) - (lens.views - 1) / 2)[:, None, None, None] + NODES / 2
    y, x = lens.cell * at, lens.step * lens_at
    place = y + (y - x) * sheet.depth / lens.focus
    glow = np.exp(-(((place - sheet.middle[axis]) / sheet.width[axis]) ** 2))
    return glow @ WEIGHTS @ WEIGHTS / 4


def record(lens, sheets):
    """Views of sheets whose light adds, float64, shape (v, u, t, s)."""
    views = 0.0
    for one in sheets:
        down, across = _line(lens, one, 0), _line(lens, one, 1)
        views = views + one.peak * down[:, None, :, None] * across[None, :, None, :]
    return views


def cells(lens, sheet, depth=None):
    """Mean of a sheet over the cells of a plane at a depth, shape (rows, columns)."""
    lines = []
    for axis in (0, 1):
        count = lens.lenslets[axis]
        edges = (np.arange(count + 1) - count / 2) * lens.cell
        edges = edges * (1 + (sheet.depth if depth is None else depth) / lens.focus)
        width = sheet.width[axis]
        whole = np.sqrt(np.pi) / 2 * width * erf((edges - sheet.middle[axis]) / width)
        lines.append(np.diff(whole) / np.diff(edges))
    return sheet.peak * np.outer(*lines)


def slabs(sheet, width, step):
    """Cut a glow that is Gaussian along depth too, of the given width, into sheets.

    The sheet's peak is what all of them add along the line of sight.
    """
    offsets = np.arange(-round(3 * width / step), round(3 * width / step) + 1) * step
    share = np.exp(-((offsets / width) ** 2))
    share /= share.sum()
    return [
        Sheet(sheet.depth + at, sheet.middle, sheet.width, sheet.peak * part)
        for at, part in zip(offsets, share, strict=True)
    ]
