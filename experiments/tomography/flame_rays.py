"""Light fields of flames that only add light, ray by ray; nothing of the library is used.

A lens focuses the plane at `FOCUS_MM` on square lenslets; a pixel is the mean of 16 rays,
over its lenslet and its part of the lens. A ray adds up what it meets at each depth of a flame.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from experiments.tomography.soot_rays import FOCUS_MM, IMAGE_MM, LENSLET_FOCAL_MM, PITCH_MM

VIEWS, LENSLETS = 7, 60
"""Number of views and of lenslets along each axis."""

GAUSS = np.array([-1, 1]) / np.sqrt(12)
"""Places of two rays across a lenslet, and across a view's part of the lens (Gauss-Legendre)."""

EVEN = (np.arange(6) + 0.5) / 6 - 0.5
"""Places across a cell at which its true emission is averaged."""

FADES_MM = 1.5
"""Height over which round flames fade, to 1 / e."""

Glow = Callable[[np.ndarray, np.ndarray, float], np.ndarray]
"""Emission at places y, x, z in mm: per mm of depth, or of a sheet at the depth z."""


@dataclass(frozen=True, eq=False)
class Flame:
    """A flame, by its glow, at depths from the plane in focus.

    Those of sheets, with a step of 1, or of the middles of thin slabs, as thick as the step.
    """

    glow: Glow
    depths_mm: Sequence[float]
    step_mm: float = 1.0

    def record(self, pitch_mm: float = PITCH_MM) -> np.ndarray:
        """Trace the views, float64, shape (v, u, t, s), for a pitch of the lenslets."""
        cell, step = pitch_mm * FOCUS_MM / IMAGE_MM, IMAGE_MM * pitch_mm / LENSLET_FOCAL_MM / VIEWS
        at, lens = cell * _places(LENSLETS, GAUSS), step * _places(VIEWS, GAUSS)
        rays = np.zeros((lens.size, lens.size, at.size, at.size))
        for z in self.depths_mm:
            # Where a ray through each place of the lens meets the depth.
            met = at + (at - lens[:, None]) * z / FOCUS_MM
            for down, views in zip(met, rays, strict=True):
                for across, view in zip(met, views, strict=True):
                    view += self.glow(down[:, None], across, z)
        shape = (VIEWS, 2, VIEWS, 2, LENSLETS, 2, LENSLETS, 2)
        return self.step_mm * rays.reshape(shape).mean(axis=(1, 3, 5, 7))

    def truth(self, planes_mm: Sequence[float]) -> np.ndarray:
        """Emission of all that is nearest to each plane, on the cells of the central view."""
        parts = len(EVEN)
        planes = np.zeros((len(planes_mm), LENSLETS * parts, LENSLETS * parts))
        for z in self.depths_mm:
            nearest = int(np.argmin(np.abs(np.subtract(planes_mm, z))))
            cell = PITCH_MM * FOCUS_MM / IMAGE_MM * (1 + planes_mm[nearest] / FOCUS_MM)
            at = cell * _places(LENSLETS, EVEN)
            planes[nearest] += self.step_mm * self.glow(at[:, None], at, z)
        shape = (len(planes_mm), LENSLETS, parts, LENSLETS, parts)
        return planes.reshape(shape).mean(axis=(2, 4))


def _places(count: int, offsets: np.ndarray) -> np.ndarray:
    """Places in so many elements of width 1 about 0, at offsets from their middles."""
    return (np.arange(count)[:, None] - (count - 1) / 2 + offsets).ravel()


def _slabs(reach_mm: float, step_mm: float) -> np.ndarray:
    return (np.arange(round(2 * reach_mm / step_mm)) + 0.5) * step_mm - reach_mm


def sheets(depths_mm: Sequence[float], sideways_mm: float = 0.0) -> Flame:
    """Four Gaussian sheets behind each other, some beside others, moved sideways as asked."""
    places = dict(zip(depths_mm, (-1.2, 1.1, -0.3, 0.6), strict=True))

    def glow(y, x, z):
        across = (x - places[z] - sideways_mm) / 0.7
        return np.exp(-(((y - sideways_mm) / 1.5) ** 2) - across**2)

    return Flame(glow, depths_mm)


def sharp_edges(depths_mm: tuple[float, float]) -> Flame:
    """Draw a disc and a square that glow evenly, in line; their edges are 0.1 mm wide."""

    def glow(y, x, z):
        disc = z == depths_mm[0]
        out = np.hypot(y, x + 0.6) - 1.7 if disc else np.maximum(np.abs(y), np.abs(x - 0.6)) - 1.5
        return (1.0 if disc else 0.7) * np.clip(0.5 - out / 0.1, 0, 1)

    return Flame(glow, depths_mm)


def hollow() -> Flame:
    """Draw a round shell, dark on its axis."""

    def glow(y, x, z):
        return np.exp(-(((np.hypot(x, z) - 1.2) / 0.35) ** 2) - (y / FADES_MM) ** 2)

    return Flame(glow, _slabs(2.5, 0.1), 0.1)


def elliptic() -> Flame:
    """Draw a full flame, twice as deep as wide."""

    def glow(y, x, z):
        return np.exp(-((x / 0.8) ** 2) - (z / 1.6) ** 2 - (y / FADES_MM) ** 2)

    return Flame(glow, _slabs(3.5, 0.1), 0.1)


CREMERS_RADIUS_MM = 2.2
"""Radius of the edge of the printed profile."""


def cremers_profile(r: np.ndarray) -> np.ndarray:
    """Profile with a peak off the axis, by radius relative to its edge.

    C. J. Cremers and R. C. Birkebak, Applied Optics 5, 1057 (1966), equation 13; the emission
    printed in its table I at m / 30 is this to the last digit.
    """
    inner = 0.75 + 12 * r**2 - 32 * r**3
    outer = 16 / 27 * (1 + 6 * r - 15 * r**2 + 8 * r**3)
    return np.where(r < 0.25, inner, np.where(r < 1, outer, 0))


def cremers() -> Flame:
    """Round flame with that profile, which fades slowly with height."""

    def glow(y, x, z):
        return cremers_profile(np.hypot(x, z) / CREMERS_RADIUS_MM) * np.exp(-((y / FADES_MM) ** 2))

    return Flame(glow, _slabs(2.5, 0.1), 0.1)
