"""Light fields of sooty sheets that dim each other, ray by ray; nothing of the library is used.

A lens focuses the plane at `FOCUS_MM` on square lenslets. Each colour is a broad band, summed
wavelength by wavelength. A ray meets each sheet once, and gains ``(1 - exp(-tau)) B`` of its light
through all sheets that are nearer to the camera.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from experiments.tomography.soot_rays import C1, C2, CELL_MM, FOCUS_MM, PUPIL_MM

NAMES = "red", "green", "blue"
NM = np.arange(380.0, 701.0, 20.0)
PEAKS_NM = np.array([[600.0], [530.0], [460.0]])

GAUSS, WEIGHTS = np.polynomial.legendre.leggauss(3)


def bands(nm: np.ndarray) -> np.ndarray:
    """Responses, 67 nm wide at half height, which overlap, shape (colours, wavelengths)."""
    return np.exp(-(((nm - PEAKS_NM) / 40) ** 2))


@dataclass(frozen=True)
class SootSheet:
    """Soot at one depth: its thickness is a Gaussian, and its temperature rises across it.

    Middle and half width at 1 / e along y and x in mm; optical thickness at 600 nm, and temperature
    in K, in the middle.
    """

    depth_mm: float
    middle_mm: tuple[float, float]
    width_mm: tuple[float, float]
    thickness: float
    hot: float = 1800.0

    def soot(self, y: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Optical thickness at 600 nm, and temperature in K, at places in mm."""
        up, right = (y - self.middle_mm[0]), (x - self.middle_mm[1])
        up, right = up / self.width_mm[0], right / self.width_mm[1]
        return self.thickness * np.exp(-(up**2) - right**2), self.hot + 60 * np.tanh(right - up)

    def cells(self, lenslets: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
        """Give the same in the middle of the pixels of the central view."""
        side = CELL_MM * (1 + self.depth_mm / FOCUS_MM)
        y, x = (side * (np.arange(n) - (n - 1) / 2) for n in lenslets)
        return self.soot(y[:, None], x)


def planck(kelvin: np.ndarray) -> np.ndarray:
    """Radiance of black bodies at each wavelength, shape (..., wavelengths)."""
    return C1 / NM**5 / np.expm1(C2 / (NM * np.asarray(kelvin, float)[..., None]))


def in_colours(light: np.ndarray) -> np.ndarray:
    """Sum light at each wavelength over the bands, shape (..., colours)."""
    return light @ bands(NM).T * (NM[1] - NM[0])


def record(
    sheets: Sequence[SootSheet], views: int, lenslets: tuple[int, int], exponent: float = 1.0
) -> np.ndarray:
    """Trace the views through a square pupil, float64, shape (v, u, t, s, colours)."""
    pair = np.array([-1, 1]) / np.sqrt(12)
    y, x = (CELL_MM * ((np.arange(n) - (n - 1) / 2)[:, None] + pair).ravel() for n in lenslets)
    places = ((np.arange(views) - (views - 1) / 2)[:, None] + GAUSS / 2) * PUPIL_MM / views
    out = np.zeros((views, views, *lenslets, len(NAMES)))
    for v, u, i, j in np.ndindex(views, views, 3, 3):
        light, before = 0.0, 0.0
        for sheet in sorted(sheets, key=lambda one: one.depth_mm):
            part = sheet.depth_mm / FOCUS_MM
            met = y + (y - places[v, i]) * part, x + (x - places[u, j]) * part
            soot, kelvin = sheet.soot(met[0][:, None], met[1])
            tau = soot[..., None] * (600 / NM) ** exponent
            light = light + (1 - np.exp(-tau)) * np.exp(-before) * planck(kelvin)
            before = before + tau
        rays = in_colours(light).reshape(lenslets[0], 2, lenslets[1], 2, -1)
        out[v, u] += rays.mean(axis=(1, 3)) * WEIGHTS[i] * WEIGHTS[j] / 4
    return out
