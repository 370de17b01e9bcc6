"""Temperature of sooty flames from one raw image of a colour camera, against their truth.

The raw images are traced ray by ray (`experiments.tomography.soot_rays`), with black level, white
image, noise and 12 bits, and go the way of a user's: decoding, a calibration by five pictures of a
furnace, and `reconstruct_axisymmetric_soot`.
"""

import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from experiments.command_parts import step_bar
from experiments.report import markdown, write_report
from experiments.tomography import soot_rays as rays
from lf_flame import LightField, PlenopticCamera
from lf_flame._common.figures import subplots
from lf_flame.formats import DecodePlan, estimate_grid
from lf_flame.tomography import (
    AxisymmetricGrid,
    SpectralResponses,
    calibrate_colours,
    reconstruct_axisymmetric_soot,
    soot_temperature,
)

LENSLETS, VIEWS = (72, 52), 7
BLACK, WHITE, FULL = 64.0, 3000.0, 4095
"""Black level, brightest signal above it, and largest number of the sensor."""

FURNACE_K = 1473.0, 1573.0, 1673.0, 1773.0, 1873.0
NOISE, BARS, LIT = 0.01, 20, 0.2
"""Noise relative to the brightest signal; bootstrap draws; emission relative to its peak above
which temperatures count."""

CAMERA = PlenopticCamera(
    main_lens_focal_mm=rays.FOCAL_MM,
    focus_distance_mm=rays.FOCUS_MM,
    lenslet_focal_mm=rays.LENSLET_FOCAL_MM,
    lenslet_pitch_mm=rays.PITCH_MM,
    views=VIEWS,
    lenslets=LENSLETS,
    aperture_diameter_mm=rays.PUPIL_MM,
)
GRID = AxisymmetricGrid(CAMERA, axis_mm=0.0, depth_mm=0.0, radius_mm=3.0)


@dataclass(frozen=True)
class Case:
    """A flame, how it is recorded, and what is assumed of it."""

    name: str
    flame: rays.SootFlame = field(default_factory=rays.SootFlame)
    noise: float = NOISE
    exponent: float = 1.0

    @cached_property
    def raw(self) -> np.ndarray:
        """Raw image without noise."""
        return rays.record(self.flame, LENSLETS, self.exponent)


CASES = (
    Case("hollow flame, thickness 0.5"),
    Case("thin, thickness 0.05", rays.SootFlame(thickness=0.05)),
    Case("thick, thickness 1", rays.SootFlame(thickness=1.0)),
    Case("full core", rays.SootFlame(core=1.0)),
    Case("noise 3 %", noise=0.03),
    Case("deeper than wide by 1.3", rays.SootFlame(depth_ratio=1.3)),
    Case("absorption as wavelength^-1.4, taken for ^-1", exponent=1.4),
)

METHODS = {
    "soot": "temperature and absorption together",
    "thin": "taken for optically thin",
    "lines": "thin, each colour taken for its peak wavelength",
}


class Sensor:
    """A colour camera's raw images, its calibration, and its plan of decoding."""

    def __init__(self, raw: np.ndarray, noise: float, rng: np.random.Generator):
        self._rng, self._noise = rng, noise * WHITE
        self._colours = rays.MOSAIC[tuple(np.indices(raw.shape) % 2)]
        peaks = [raw[self._colours == c].max() for c in range(3)]
        self.gains = WHITE / np.array(peaks)
        white = self._read(rays.even(LENSLETS, np.array([1500.0, 2600.0, 2000.0])), 2.0)
        dark = np.full(raw.shape, BLACK, np.float32)
        self._plan = DecodePlan(
            estimate_grid(white - dark), shape=raw.shape, views=VIEWS, white=white, dark=dark,
            bayer="rggb",
        )  # fmt: skip
        self.calibration = self._calibrate()

    def decode(self, raw: np.ndarray) -> LightField:
        """Record a raw image with noise, and decode it."""
        return self._plan.decode(self._read(raw * self.gains[self._colours], self._noise))

    def _read(self, light: np.ndarray, noise: float) -> np.ndarray:
        values = BLACK + light + noise * self._rng.standard_normal(light.shape)
        return np.clip(np.rint(values), 0, FULL).astype(np.float32)

    def _calibrate(self):
        nm = np.arange(375.0, 726.0, 5.0)
        curves = np.exp(-(((nm - np.array([[610.0], [540.0], [460.0]])) / 40) ** 2))
        camera = SpectralResponses(("red", "green", "blue"), nm, curves)
        signals, exposures = [], []
        for kelvin in FURNACE_K:
            light = self.gains * rays.black_body(kelvin)
            exposures.append(WHITE / light.max())
            source = rays.even(LENSLETS, light * exposures[-1])
            picture = self._plan.decode(self._read(source, self._noise)).photograph
            signals.append(picture[8:-8, 8:-8].mean(axis=(0, 1), dtype=float))
        return calibrate_colours(FURNACE_K, signals, camera, exposures=exposures).calibration


def truth(flame: rays.SootFlame) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Absorption and temperature at the nodes, and where emission is above `LIT` of its peak."""
    height, radius = np.meshgrid(GRID.heights_mm, GRID.radii_mm, indexing="ij")
    absorption, kelvin = flame.absorption(radius, height), flame.kelvin(radius, height)
    red = absorption * np.exp(-rays.C2 / (610.0 * kelvin))
    return absorption, kelvin, red > LIT * red.max()


def measure(case: Case, rng: np.random.Generator) -> Iterator[dict]:
    """Errors of all methods on one draw of the noise."""
    sensor = Sensor(case.raw, case.noise, rng)
    light_field = sensor.decode(case.raw)
    absorption, kelvin, lit = truth(case.flame)
    for method in METHODS:
        began = time.perf_counter()
        found = reconstruct_axisymmetric_soot(
            light_field, GRID, sensor.calibration, absorbing=method == "soot", bootstrap=BARS
        )
        temperatures = found.temperatures
        if method == "lines":
            peaks = SpectralResponses.single((610.0, 540.0, 460.0))
            black = sensor.calibration.responses.black_body(1700.0) / peaks.black_body(1700.0)
            temperatures = soot_temperature(
                [one.emission for one in found.colours], peaks,
                sigmas=[one.sigma for one in found.colours],
                gains=sensor.calibration.gains * black,
            )  # fmt: skip
        apart, sigma = (temperatures.kelvin - kelvin)[lit], temperatures.sigma[lit]
        amount = temperatures.amount[lit] / absorption[lit]
        yield {
            "case": case.name,
            "method": METHODS[method],
            "rms_K": float(np.sqrt(np.nanmean(apart**2))),
            "mean_K": float(np.nanmean(apart)),
            "within_25_K": float(np.mean(np.abs(apart) < 25)),  # NaN is not
            "held": float(np.nanmean(np.abs(apart) < 1.96 * sigma)),
            "thickness": float(np.nanmedian(amount)),
            "warnings": len(set(found.warnings + sum((x.warnings for x in found.colours), ()))),
            "seconds": time.perf_counter() - began,
        }


def count_held(draws: int, rng: np.random.Generator) -> dict[str, float]:
    """How often bars of 95 % hold the true temperature, over draws of the noise."""
    case = CASES[0]
    sensor = Sensor(case.raw, case.noise, rng)
    _, kelvin, lit = truth(case.flame)
    held, errors = [], []
    for draw in step_bar(range(draws)):
        found = reconstruct_axisymmetric_soot(
            sensor.decode(case.raw), GRID, sensor.calibration, bootstrap=BARS, seed=10 * draw
        ).temperatures
        apart = (found.kelvin - kelvin)[lit]
        held.append(np.nanmean(np.abs(apart) < 1.96 * found.sigma[lit]))
        errors.append(np.sqrt(np.nanmean(apart**2)))
    return {
        "draws": draws,
        "held": float(np.mean(held)),
        "standard_error": float(np.std(held, ddof=1) / np.sqrt(draws)),
        "rms_K": float(np.mean(errors)),
    }


COLUMNS = {
    "case": ("flame", ""),
    "method": ("method", ""),
    "rms_K": ("rms (K)", ".1f"),
    "mean_K": ("mean (K)", "+.1f"),
    "within_25_K": ("within 25 K", ".0%"),
    "held": ("in 95 % bars", ".0%"),
    "thickness": ("thickness / true", ".2f"),
    "warnings": ("warnings", "d"),
}


def body(record: dict) -> list[str]:
    """Text and table of a record."""
    held = record["bars"]
    return [
        f"One raw image of {LENSLETS[0] * rays.UNDER} x {LENSLETS[1] * rays.UNDER} pixels behind a "
        f"round lens and a colour filter array (rggb, three overlapping bands of 67 nm at half "
        f"height), with noise relative to the brightest pixel, 12 bits, and a furnace at "
        f"{FURNACE_K[0]:g} to {FURNACE_K[-1]:g} K for calibration. Traced by rays that share "
        f"nothing with the reconstruction. Temperatures count where emission in "
        f"red is above {LIT:.0%} of its peak. One draw of the noise; noise {NOISE:.0%} where "
        f"nothing else is said; {BARS} bootstrap draws of three colours.",
        markdown(record["rows"], COLUMNS),
        f"Over {held['draws']} draws of the noise of the first flame, bars of 95 % (1.96 standard "
        f"deviations) hold the true temperature in {held['held']:.1%} (standard error "
        f"{held['standard_error']:.1%}); the error is {held['rms_K']:.1f} K in the mean.",
        "No real flame has been measured.",
    ]


def run_soot(out: Path, seed: int, draws: int) -> Path:
    """Measure all cases and how often error bars hold the truth; writes ``soot.md`` and more."""
    began, rng, rows = time.perf_counter(), np.random.default_rng(seed), []
    for case in step_bar(CASES):
        rows += measure(case, rng)
    held = count_held(draws, rng)
    record = {"rows": rows, "bars": held, "seed": seed, "wall_s": time.perf_counter() - began}
    pictures = {"soot": soot_figure(seed)}
    title = "Temperature of sooty flames from one exposure"
    return write_report(out, "soot", title, record, body(record), pictures=pictures)


def soot_figure(seed: int):
    """Draw the temperature of the first flame beside the truth, its error, and a profile."""
    case, rng = CASES[0], np.random.default_rng(seed)
    sensor = Sensor(case.raw, case.noise, rng)
    found = reconstruct_axisymmetric_soot(
        sensor.decode(case.raw), GRID, sensor.calibration, bootstrap=BARS
    ).temperatures
    _, kelvin, lit = truth(case.flame)
    figure, axes = subplots(
        1, 4, figsize=(13, 4), layout="constrained", width_ratios=(1, 1, 1, 1.6)
    )
    extent = (0, GRID.radius_mm, GRID.heights_mm[-1], GRID.heights_mm[0])
    low, high = np.percentile(kelvin[lit], (1, 99))
    shown = (
        ("truth", np.where(lit, kelvin, np.nan), "inferno", low, high),
        ("found", np.where(lit, found.kelvin, np.nan), "inferno", low, high),
        ("found - truth", np.where(lit, found.kelvin - kelvin, np.nan), "RdBu_r", -25, 25),
    )
    for axis, (title, values, colours, least, most) in zip(axes, shown, strict=False):
        axis.set_facecolor("0.7")
        picture = axis.imshow(
            values, cmap=colours, vmin=least, vmax=most, extent=extent, aspect="equal"
        )
        axis.set(title=title, xlabel="radius (mm)", ylim=(-3.5, 3.5))
        figure.colorbar(picture, ax=axis, label="K", shrink=0.8)
    axes[0].set_ylabel("height (mm)")
    row = int(np.argmin(np.abs(GRID.heights_mm)))
    known = np.isfinite(found.kelvin[row]) & lit[row]
    radii = GRID.radii_mm[known]
    axes[3].plot(GRID.radii_mm[lit[row]], kelvin[row][lit[row]], "k", label="truth")
    axes[3].errorbar(
        radii, found.kelvin[row][known], 1.96 * found.sigma[row][known], fmt="o", capsize=2,
        label="found, bars of 95 %",
    )  # fmt: skip
    axes[3].set(xlabel="radius (mm)", ylabel="temperature (K)", title="in the middle")
    axes[3].legend()
    return figure
