"""Light fields of a round sooty flame by rays that are written out here, with absorption.

Nothing of the package's optics, grids or radiation is used. Planck's law and the thin lens are as
in any textbook; a ray is followed from the camera through the flame in even steps, each of which
adds ``(1 - exp(-tau)) B`` of its light through all that is nearer.
"""

from dataclasses import dataclass

import numpy as np
from own_rays import Lens

PLANCK, LIGHT, BOLTZMANN = 6.62607015e-34, 299792458.0, 1.380649e-23


def planck(nm, kelvin):
    """Radiance of a black body in W / (m^2 sr nm)."""
    length = nm * 1e-9
    power = np.exp(PLANCK * LIGHT / (length * BOLTZMANN * kelvin)) - 1
    return 2e-9 * PLANCK * LIGHT**2 / length**5 / power


@dataclass(frozen=True)
class SootFlame:
    """A hollow flame: a shell of soot whose temperature rises outwards and falls with height."""

    radius: float = 2.0
    height: float = 3.0
    thickness: float = 0.5
    """Optical thickness at 600 nm across the middle."""

    def absorption(self, r, h):
        """Absorption coefficient at 600 nm, per mm."""
        shell = (
            np.exp(-(((r / self.radius - 0.6) / 0.3) ** 2))
            + np.exp(-(((r / self.radius + 0.6) / 0.3) ** 2))
        ) * np.exp(-((h / self.height) ** 2))  # fmt: skip
        # The line integral of both bells across the middle is 2 sqrt(pi) 0.3 radius.
        return self.thickness / (2 * np.sqrt(np.pi) * 0.3 * self.radius) * shell

    def kelvin(self, r, h):
        """Temperature of the soot."""
        return 1750.0 + 80.0 * np.tanh(2 * (r / self.radius - 0.6)) - 60.0 * h / self.height


def record(lens: Lens, flame: SootFlame, wavelengths_nm, depth=0.0, steps=48, parts=2):
    """Views in each wavelength, float64, shape (v, u, t, s, wavelengths)."""
    rows, columns = lens.lenslets
    at = (np.arange(parts) + 0.5) / parts - 0.5
    y = lens.cell * (np.arange(rows)[:, None] - (rows - 1) / 2 + at).ravel()
    x = lens.cell * (np.arange(columns)[:, None] - (columns - 1) / 2 + at).ravel()
    middles = lens.step * (np.arange(lens.views) - (lens.views - 1) / 2)
    reach = 2.2 * flame.radius
    places = depth + reach * ((np.arange(steps) + 0.5) * 2 / steps - 1)
    out = np.zeros((lens.views, lens.views, rows, columns, len(wavelengths_nm)))
    for v, lens_y in enumerate(middles):
        for u, lens_x in enumerate(middles):
            before = np.zeros((y.size, x.size))
            light = np.zeros((len(wavelengths_nm), y.size, x.size))
            for z in places:
                h = -(y + (y - lens_y) * z / lens.focus)[:, None]
                across = (x + (x - lens_x) * z / lens.focus)[None, :]
                r = np.hypot(across, z - depth)
                tau = flame.absorption(r, h) * 2 * reach / steps
                kelvin = flame.kelvin(r, h)
                for c, nm in enumerate(wavelengths_nm):
                    scale = 600.0 / nm
                    leaves = (1 - np.exp(-tau * scale)) * np.exp(-before * scale)
                    light[c] += leaves * planck(nm, kelvin)
                before += tau
            cells = light.reshape(-1, rows, parts, columns, parts).mean(axis=(2, 4))
            out[v, u] = np.moveaxis(cells, 0, -1)
    return out
