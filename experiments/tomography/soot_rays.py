"""Raw images of a sooty flame behind a round lens, ray by ray; nothing of the library is used.

A lens focuses the plane at `FOCUS_MM` on square lenslets. A pixel sees, through its lenslet and its
place of the pupil, one ray for each of 2 x 2 places on the lenslet. Along a ray through the flame,
each step adds ``(1 - exp(-tau)) B`` of its light through all that is nearer to the camera.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit, prange

FOCAL_MM, FOCUS_MM, LENSLET_FOCAL_MM, PITCH_MM = 150.0, 326.0, 0.4, 0.112
IMAGE_MM = 1 / (1 / FOCAL_MM - 1 / FOCUS_MM)
CELL_MM = PITCH_MM * FOCUS_MM / IMAGE_MM
PUPIL_MM = IMAGE_MM * PITCH_MM / LENSLET_FOCAL_MM
UNDER = 14
"""Number of pixels under a lenslet along each axis."""

NM = np.arange(375.0, 726.0, 25.0)
CURVES = np.exp(-(((NM - np.array([[460.0], [540.0], [610.0]])) / 40) ** 2))
NAMES = "blue", "green", "red"
MOSAIC = np.array([[2, 1], [1, 0]])
"""Colours of the sensor's upper left pixels: rggb."""

C1, C2 = 1.191042972397188e20, 1.4387768775e7
STEPS, PARTS = 60, 2


@dataclass(frozen=True)
class SootFlame:
    """A hollow flame on a burner.

    The thickness is optical, at 600 nm through the axis, where it is largest; the depth ratio the
    extent in depth relative to that across; the core the soot on the axis, relative to the shell's.
    """

    thickness: float = 0.5
    radius_mm: float = 2.4
    height_mm: float = 7.0
    depth_ratio: float = 1.0
    core: float = 0.15

    def absorption(self, radius: np.ndarray, height: np.ndarray) -> np.ndarray:
        """Absorption coefficient at 600 nm per mm; heights from the middle of the field."""
        return self._scale() * np.vectorize(_soot)(*self._unit(radius, height), self.core)

    def kelvin(self, radius: np.ndarray, height: np.ndarray) -> np.ndarray:
        """Temperature of the soot."""
        return np.vectorize(_kelvin)(*self._unit(radius, height))

    def _unit(self, radius, height):
        return radius / self.radius_mm, height / self.height_mm + 0.5

    def _scale(self) -> float:
        r, h = np.linspace(0, 2, 1001), np.linspace(0, 1, 201)[:, None]
        soot = np.vectorize(_soot)(*np.broadcast_arrays(r, h), self.core)
        widest = 2 * np.trapezoid(soot, r, axis=1).max() * self.radius_mm
        return self.thickness / widest


@njit(cache=False)
def _soot(r, h, core):
    """Soot by radius and height, both relative to the flame's; 1 in the shell's middle."""
    if h <= 0 or h >= 1 or r > 2:
        return 0.0
    wide = 0.6 + 0.8 * h - 1.1 * h * h
    x = r / wide
    shell = np.exp(-(((x - 0.75) / 0.3) ** 2)) + core * np.exp(-((x / 0.5) ** 2))
    return shell * np.sin(np.pi * h) ** 1.5


@njit(cache=False)
def _kelvin(r, h):
    return 1900.0 - 200.0 * h + 80.0 * np.tanh(3 * (r - 0.6))


@njit(parallel=True, cache=False)
def _march(rows, columns, radius, height, ratio, core, scale, exponent, nm, curves, mosaic):
    raw = np.zeros((rows * UNDER, columns * UNDER))
    reach = 1.5 * radius * ratio
    step = 2 * reach / STEPS
    for i in prange(rows * UNDER):
        for j in range(columns * UNDER):
            py = ((i % UNDER + 0.5) / UNDER - 0.5) * PUPIL_MM
            px = ((j % UNDER + 0.5) / UNDER - 0.5) * PUPIL_MM
            if py * py + px * px > PUPIL_MM * PUPIL_MM / 4:
                continue
            colour = mosaic[i % 2, j % 2]
            total = 0.0
            for part in range(PARTS * PARTS):
                down = (part // PARTS + 0.5) / PARTS - 0.5
                right = (part % PARTS + 0.5) / PARTS - 0.5
                y = CELL_MM * (i // UNDER - (rows - 1) / 2 + down)
                x = CELL_MM * (j // UNDER - (columns - 1) / 2 + right)
                before = 0.0
                for k in range(STEPS):
                    z = (k + 0.5) * step - reach
                    up = -(y + (y - py) * z / FOCUS_MM) / height + 0.5
                    across = x + (x - px) * z / FOCUS_MM
                    r = np.sqrt(across * across + z * z / ratio**2) / radius
                    soot = _soot(r, up, core)
                    if soot < 1e-6:
                        continue
                    tau, kelvin = soot * scale * step, _kelvin(r, up)
                    for m in range(nm.size):
                        if curves[colour, m] > 1e-4:
                            more = (600.0 / nm[m]) ** exponent
                            black = C1 / nm[m] ** 5 / (np.exp(C2 / (nm[m] * kelvin)) - 1)
                            leaves = (1 - np.exp(-tau * more)) * np.exp(-before * more)
                            total += curves[colour, m] * leaves * black
                    before += tau
            raw[i, j] = total / (PARTS * PARTS)
    return raw * (nm[1] - nm[0])


def record(flame: SootFlame, lenslets: tuple[int, int], exponent: float = 1.0) -> np.ndarray:
    """Raw image of a flame behind a colour filter array, float64."""
    return _march(
        *lenslets, flame.radius_mm, flame.height_mm, flame.depth_ratio, flame.core,
        flame._scale(), exponent, NM, CURVES, MOSAIC,
    )  # fmt: skip


def even(lenslets: tuple[int, int], colours: np.ndarray) -> np.ndarray:
    """Raw image of an evenly bright source, with a light in each colour."""
    y, x = np.indices([n * UNDER for n in lenslets])
    place = [((at % UNDER + 0.5) / UNDER - 0.5) ** 2 for at in (y, x)]
    return (sum(place) <= 0.25) * np.asarray(colours)[MOSAIC[y % 2, x % 2]]


def black_body(kelvin: float) -> np.ndarray:
    """Light of a black body in each colour."""
    radiance = C1 / NM**5 / (np.exp(C2 / (NM * kelvin)) - 1)
    return CURVES @ radiance * (NM[1] - NM[0])
