"""Soot temperature from one exposure of a colour camera: made-up flames, and measured ones.

Two flames follow published tables (`tables`):

- Smyth's methane slot flame: temperatures by a thermocouple, corrected for radiation
  (github.com/firemodels/exp, Smyth_Slot_Burner; K. C. Smyth and others, Combustion and Flame 62,
  157, 1985). Its soot, 0.1 optical thickness in 12 mm, is assumed: the table has none.
- FM Global's ethylene flame of 15.2 cm in air: means by an emission probe, of both sides
  (github.com/MaCFP/macfp-db, Extinction/FM_Burner, Emission_probe 05 and 10; D. Zeng and others,
  Proc. Combust. Inst. 37, 825, 2019). They are not a frame of a turbulent flame. Soot absorbs 7.6
  times its volume fraction per wavelength, as that database states.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.interpolate import RegularGridInterpolator
from scipy.ndimage import map_coordinates

from experiments.emission import truth
from experiments.report import step_bar
from lf_flame import LightField, PlenopticCamera
from lf_flame.formats import DecodePlan, estimate_grid
from lf_flame.tomography import (
    AxisymmetricGrid,
    FrustumGrid,
    SpectralResponses,
    Temperatures,
    calibrate_colours,
    reconstruct_soot,
    soot_temperature,
)

NM, PEAKS = np.arange(375.0, 726.0, 25.0), np.array([[610.0], [540.0], [460.0]])
UNDER = 14
"""Number of pixels under a lenslet along each axis; decoded views are two pixels wide."""

TABLES, SLOT_STEP = Path(__file__).with_name("tables"), 4.0
"""Folder of the tables, and distance of the planes on which the slot flame is sought, in mm."""

MOSAIC = np.array([[0, 1], [1, 2]])[np.ix_(np.arange(UNDER) % 2, np.arange(UNDER) % 2)]
"""Colour of each pixel under a lenslet: rggb."""

OPEN = np.hypot(*(np.indices((UNDER, UNDER)) - (UNDER - 1) / 2)) <= UNDER / 2
BLACK, WHITE, FULL = 64.0, 3000.0, 4095
"""Black level, brightest signal above it, and largest number of the sensor."""

FURNACE_K, DRAWS = (1473.0, 1573.0, 1673.0, 1773.0, 1873.0), 20
"""Temperatures of the furnace, and number of bootstrap draws."""


class Measured(truth.Soot):
    """Soot by tables over height, from the field's middle, and distance."""

    def __init__(self, heights: np.ndarray, places: np.ndarray, kelvin, thickness):
        """`kelvin`, and absorption per mm at 600 nm, of shape (heights, places)."""
        at = {"points": (heights, places), "bounds_error": False}
        self._kelvin = RegularGridInterpolator(values=kelvin, fill_value=1000.0, **at)
        self._soot = RegularGridInterpolator(values=thickness, fill_value=0.0, **at)

    def kelvin(self, place: np.ndarray, up: np.ndarray) -> np.ndarray:
        """Temperature of the soot."""
        return self._kelvin(np.stack(np.broadcast_arrays(up, place), axis=-1))

    def absorption(self, place: np.ndarray, up: np.ndarray) -> np.ndarray:
        """Absorption coefficient at 600 nm per mm."""
        return self._soot(np.stack(np.broadcast_arrays(up, place), axis=-1))


class SlotFlame(Measured):
    """The slot flame, seen along the slot, from 3 to 19 mm above the burner."""

    box, reach, steps = (-8.0, 8.0, -10.0, 10.0), 6.0, 24

    def __init__(self):
        table = pd.read_csv(TABLES / "slot_flame.csv", index_col=0)
        heights = np.arange(3.0, 20.0, 2.0) - 11
        even = np.full(table.T.shape, 0.1 / (2 * self.reach))
        super().__init__(heights, table.index.to_numpy(), table.T.to_numpy(), even)

    def place(self, x, z):
        """Place across the slot."""
        return x


class EthyleneFlame(Measured):
    """The flame of 15.2 cm, from 1 to 3.5 diameters above the burner."""

    box, reach = (-190.0, 190.0, -100.0, 100.0), 100.0

    def __init__(self):
        table = pd.read_csv(TABLES / "ethylene_flame.csv", index_col=0)
        table.loc[10] = np.nan  # dark, and as hot as next to it
        ppm, kelvin = table.iloc[:, :6].fillna(0.0).T.to_numpy(), table.iloc[:, 6:].ffill().T
        heights = 152 * np.arange(1.0, 3.6, 0.5) - 342
        absorption = 7.6 * ppm * 1e-6 / 600e-6
        super().__init__(heights, 10.0 * table.index.to_numpy(), kelvin.to_numpy(), absorption)


@dataclass(frozen=True, eq=False)
class Exposure:
    """One raw image of a flame, its decoding, and the camera's calibration by a furnace.

    The depths of soot on planes are known, and the radius of an axisymmetric flame.
    """

    flame: Any
    lens: truth.Lens
    radius: float = 0.0
    depths: tuple[float, ...] = ()
    noise: float = 0.01
    exponent: float = 1.0

    @property
    def camera(self) -> PlenopticCamera:
        """Camera of the decoded views, behind a round stop."""
        seen, raw = (replace(self.lens, views=views) for views in (UNDER // 2, UNDER))
        return PlenopticCamera(**seen.numbers(), aperture_diameter_mm=UNDER * raw.step)

    @cached_property
    def grid(self) -> AxisymmetricGrid | FrustumGrid:
        """Depth planes, or the half section about the known axis."""
        if self.depths:
            return FrustumGrid(self.camera, self.depths)
        return AxisymmetricGrid(self.camera, 0.0, 0.0, self.radius)

    @cached_property
    def light(self) -> np.ndarray:
        """Light of each pixel along own rays, [v, u, t, s]."""
        raw = replace(self.lens, views=UNDER)
        light = np.zeros((UNDER, UNDER, *raw.lenslets))
        for colour, curve in enumerate(curves(NM)):
            band, where = curve > 1e-4, OPEN & (colour == MOSAIC)
            slabs = self.flame.slabs(NM[band], self.exponent)
            seen = truth.trace(raw, slabs, parts=1, where=where, channels=(band.sum(),))
            light += seen @ curve[band] * (NM[1] - NM[0])
        return light

    def places(self) -> tuple[np.ndarray, np.ndarray]:
        """Places across, or radii, and heights of the cells or nodes."""
        if isinstance(self.grid, AxisymmetricGrid):
            up, across = np.meshgrid(self.grid.heights_mm, self.grid.radii_mm, indexing="ij")
            return across, up
        sides = np.array([self.grid.cell_mm(depth) for depth in self.depths])[:, None, None]
        rows, columns = self.lens.lenslets
        up, across = ((np.arange(n) - (n - 1) / 2) for n in (rows, columns))
        shape = (len(sides), rows, columns)
        return np.broadcast_to(sides * across, shape), np.broadcast_to(-sides * up[:, None], shape)

    def truth(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Absorption and temperature of cells or nodes, and where the emission in red counts.

        A cell has the mean over 5 x 5 points, weighted by the emission in red.
        """
        across, up = self.places()
        side = self.lens.cell if self.depths else 0.0
        light: Any = 0.0
        heat: Any = 0.0
        for down, right in np.ndindex(5, 5):
            at = across + side * (right - 2) / 5, up + side * (down - 2) / 5
            kelvin = self.flame.kelvin(*at)
            red = self.flame.absorption(*at) * truth.planck(PEAKS[0], kelvin)
            light, heat = light + red, heat + red * kelvin
        kelvin = heat / np.maximum(light, 1e-300)
        absorption = self.flame.absorption(across, up)
        return absorption, kelvin, (light > 0.2 * light.max()) & (absorption > 0)

    @cached_property
    def gains(self) -> np.ndarray:
        """Gain of each colour, with which its brightest pixel is at `WHITE`."""
        return np.array([WHITE / self.light[colour == MOSAIC].max() for colour in range(3)])

    def read(self, light: np.ndarray, noise: float, rng: np.random.Generator) -> np.ndarray:
        """Raw image of the light of each pixel, with noise, of 12 bits."""
        raw = light.transpose(2, 0, 3, 1).reshape([n * UNDER for n in self.lens.lenslets])
        values = BLACK + raw + noise * rng.standard_normal(raw.shape)
        return np.clip(np.rint(values), 0, FULL).astype(np.float32)

    def record(self, rng: np.random.Generator):
        """Expose the flame and the furnace; give the light field and the calibration."""
        rows, columns = self.lens.lenslets

        def even(colours) -> np.ndarray:
            return (OPEN * np.asarray(colours)[MOSAIC])[..., None, None] * np.ones((rows, columns))

        white = self.read(even([2000.0, 2600.0, 1500.0]), 2.0, rng)
        dark = np.full(white.shape, BLACK, np.float32)
        plan = DecodePlan(
            estimate_grid(white - dark), shape=white.shape, views=UNDER // 2, white=white,
            dark=dark, bayer="rggb",
        )  # fmt: skip

        def decode(light: np.ndarray) -> LightField:
            return plan.decode(self.read(light, self.noise * WHITE, rng))

        nm = np.arange(375.0, 726.0, 5.0)
        responses = SpectralResponses(("red", "green", "blue"), nm, curves(nm))
        signals, exposures = [], []
        for kelvin in FURNACE_K:
            black = self.gains * (curves(NM) @ truth.planck(NM, kelvin)) * (NM[1] - NM[0])
            exposures.append(WHITE / black.max())
            picture = decode(even(black * exposures[-1])).photograph[8:-8, 8:-8]
            signals.append(picture.mean(axis=(0, 1), dtype=float))
        found = calibrate_colours(FURNACE_K, signals, responses, exposures=exposures)
        return decode(self.light * self.gains[MOSAIC][..., None, None]), found.calibration

    def judge(self, temperatures) -> dict:
        """Bias, scatter and coverage of temperatures where the flame is bright."""
        absorption, kelvin, lit = self.truth()
        off = (temperatures.kelvin - kelvin)[lit]
        judged = {
            "rms_K": float(np.sqrt(np.nanmean(off**2))),
            "mean_K": float(np.nanmean(off)),
            "scatter_K": float(np.nanstd(off)),
        }
        if temperatures.sigma is not None:
            judged["covered"] = float(np.nanmean(np.abs(off) < 1.96 * temperatures.sigma[lit]))
        if temperatures.amount is not None:
            ratio = temperatures.amount[lit] / absorption[lit]
            judged["thickness"] = float(np.nanmedian(ratio)) / (SLOT_STEP if self.depths else 1.0)
        return judged


def curves(nm: np.ndarray) -> np.ndarray:
    """Give the camera's responses in red, green and blue, 67 nm wide and overlapping."""
    return np.exp(-(((nm - PEAKS) / 40) ** 2))


SMALL = truth.Lens(lenslets=(72, 52))
"""The paper's optics, with a field for small flames."""

SOOT = {
    "hollow, thickness 0.5": Exposure(truth.SootFlame(), SMALL, 3.0),
    "thin, thickness 0.05": Exposure(truth.SootFlame(thickness=0.05), SMALL, 3.0),
    "thick, thickness 1": Exposure(truth.SootFlame(thickness=1.0), SMALL, 3.0),
    "deeper than wide by 1.3": Exposure(truth.SootFlame(depth_ratio=1.3), SMALL, 3.0),
    "absorbs as wavelength^-1.4, taken for ^-1": Exposure(
        truth.SootFlame(), SMALL, 3.0, exponent=1.4
    ),
}


def measured_flames() -> dict[str, Exposure]:
    """Flames after tables: by the paper's optics, 2 x 2 lenslets averaged, near and 3 m away."""
    wide = truth.Lens(lenslets=(72, 84), lenslet_focal=0.8, pitch=0.224)
    far = replace(wide, lenslets=(112, 56), focus=3000.0)
    planes = (-SLOT_STEP, 0.0, SLOT_STEP)
    return {
        "Smyth's methane slot flame": Exposure(SlotFlame(), wide, depths=planes),
        "FM Global's ethylene flame": Exposure(EthyleneFlame(), far, radius=105.0),
    }


def temperatures(exposures: dict[str, Exposure], rng: np.random.Generator) -> Iterator[dict]:
    """Find the temperatures of flames, with and without absorption, and in a photograph."""
    for name, exposure in step_bar(exposures.items(), len(exposures)):
        light_field, calibration = exposure.record(rng)
        colours, gains = calibration.responses, calibration.gains
        photograph = np.moveaxis(light_field.photograph.astype(float), -1, 0)
        flat = soot_temperature(list(photograph), colours, gains=gains).kelvin
        across, up = exposure.places()
        at = [(n - 1) / 2 + x / exposure.lens.cell
              for n, x in zip(flat.shape, (-up, across), strict=True)]  # fmt: skip
        alone = Temperatures(map_coordinates(flat, at, order=1), None)
        found = {"one photograph, without depth": alone}
        command = "reconstruct" if exposure.depths else "abel"
        # Planes that the light field barely separates have no absorption that can be found.
        for absorbing in (False,) if exposure.depths else (False, True):
            soot = reconstruct_soot(
                light_field, exposure.grid, calibration, absorbing=absorbing, bootstrap=DRAWS
            )
            words = "with absorption" if absorbing else "taken for thin"
            found[f"{command} --colours, {words}"] = soot.temperatures
        for method, one in found.items():
            row = {"flame": name, "noise": exposure.noise, "method": method}
            yield row | exposure.judge(one)
