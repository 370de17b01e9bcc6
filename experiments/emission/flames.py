"""Axisymmetric flames by `abel`, and soot temperature from one exposure of a colour camera."""

from collections.abc import Iterator
from functools import cache

import numpy as np

from experiments.emission import truth
from experiments.emission.rivals import round_methods
from experiments.report import step_bar
from lf_flame import LightField, PlenopticCamera
from lf_flame.formats import DecodePlan, estimate_grid
from lf_flame.tomography import (
    AxisymmetricGrid,
    SpectralResponses,
    calibrate_colours,
    find_axis,
    reconstruct_axisymmetric,
    reconstruct_soot,
    soot_temperature,
)

PAPER = truth.Lens(views=15, lenslets=(90, 180), lenslet_focal=1.2, pitch=0.336)
"""The paper's camera, whose images of 270 x 540 lenslets are averaged to 90 x 180 pixels."""

HEIGHT, RADIUS, REACH = 25.0, 4.0, 12.0
"""Height and radius of the axisymmetric flame, and the radius up to which it is sought, in mm."""


@cache
def round_views() -> np.ndarray:
    """Trace the axisymmetric flame; its axis is in the middle of a pixel column."""
    slabs = truth.volume(round_glow, REACH, 0.25, (-HEIGHT / 2, HEIGHT / 2, -REACH, REACH + 1))
    return truth.trace(PAPER, slabs, spots=4, parts=1)


def round_glow(y: np.ndarray, x: np.ndarray, z: np.ndarray | float) -> np.ndarray:
    """Emission of the axisymmetric flame per mm."""
    return truth.round_glow(0.5 - y / HEIGHT, np.hypot(x - PAPER.cell / 2, z), RADIUS)


def noisy(views: np.ndarray, noise: float, rng: np.random.Generator) -> LightField:
    """Add Gaussian noise, relative to the brightest pixel."""
    return LightField(views + noise * views.max() * rng.standard_normal(views.shape))


Section = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Heights and radii in mm, and the emission there, (heights, radii)."""


def sections(light_field: LightField) -> Iterator[tuple[str, list[Section]]]:
    """Find the half section by every method: from all views, and from the central view alone."""
    camera = PlenopticCamera(**PAPER.numbers())
    axis, step, centre = find_axis(light_field, camera), PAPER.cell, PAPER.views // 2
    for views, seen, image in (
        ("all", "all views", light_field.photograph),
        ("central", "central view", light_field.views[centre, centre]),
    ):
        grid = AxisymmetricGrid(camera, axis.across_mm, axis.depth_mm, REACH, 1, views, -HEIGHT / 2)
        found = reconstruct_axisymmetric(light_field, grid)
        yield f"abel, {seen}", [(grid.heights_mm, grid.radii_mm, found.emission)]
        middle, count = image.shape[1] // 2, int(np.ceil(REACH / step))  # right of the middle
        right = np.asarray(image[:, middle:], float)
        half = (right + image[:, middle::-1][:, : right.shape[1]]) / 2
        heights = ((len(half) - 1) / 2 - np.arange(len(half))) * step
        for name, invert in round_methods():
            found_by = (one[:, :count] for one in invert(half, step))
            yield f"{name}, {seen}", [(heights, np.arange(count) * step, one) for one in found_by]


def section_error(heights: np.ndarray, radii: np.ndarray, found: np.ndarray) -> float:
    """Root-mean-square error over the volume, but for the tip, which is finer than a pixel."""
    up = heights / HEIGHT + 0.5
    rows = (up > 0.03) & (up < 0.97)
    wanted = truth.round_glow(up[rows, None], radii[None], RADIUS)
    weight = np.sqrt(radii)
    return float(np.linalg.norm((found[rows] - wanted) * weight) / np.linalg.norm(wanted * weight))


def round_flame(rng: np.random.Generator) -> Iterator[dict]:
    """Find the half section of an axisymmetric flame whose axis is to be found, too."""
    for noise in (0.0, 0.01, 0.05):
        for method, found in sections(noisy(round_views(), noise, rng)):
            error = min(section_error(*one) for one in found)
            yield {"flame": "axisymmetric", "noise": noise, "method": method, "error": error}


CREMERS, CREMERS_RADIUS, FADES = truth.Lens(lenslets=(60, 60)), 2.2, 1.5
"""Camera, radius of the profile's edge, and height over which the flame fades, in mm."""

PRINTED = {
    "Nestor and Olsen": (0.0040, 0.0071),
    "Maecker": (0.0210, 0.0308),
    "Ladenburg and others": (0.0011, 0.0030),
    "Frie": (0.0008, 0.0018),
    "Cremers and Birkebak, 3rd degree": (0.0057, 0.0149),
    "Cremers and Birkebak, 4th degree": (0.0023, 0.0073),
}
"""Root-mean-square and largest error at m / 30, m = 0 to 18, by the differences that table I of
Cremers and Birkebak prints; its further lines could not be read."""


def cremers_profile(r: np.ndarray) -> np.ndarray:
    """Profile with a peak off the axis, by radius relative to its edge.

    C. J. Cremers and R. C. Birkebak, Applied Optics 5, 1057 (1966), equation 13; the emission
    printed in its table I at m / 30 is this to the last digit.
    """
    inner = 0.75 + 12 * r**2 - 32 * r**3
    outer = 16 / 27 * (1 + 6 * r - 15 * r**2 + 8 * r**3)
    return np.where(r < 0.25, inner, np.where(r < 1, outer, 0))


def beside_print(rng: np.random.Generator) -> Iterator[dict]:
    """Give errors of `abel` on the profile of Cremers and Birkebak, and those that they print."""
    one = "one projection, 31 points, no noise, four digits"
    for method, (rms, worst) in PRINTED.items():
        yield {"method": f"{method}, as printed", "input": one, "rms": rms, "largest": worst}

    def glow(y, x, z):
        return cremers_profile(np.hypot(x, z) / CREMERS_RADIUS) * np.exp(-((y / FADES) ** 2))

    views = truth.trace(CREMERS, truth.volume(glow, 2.5, 0.1))
    grid = AxisymmetricGrid(PlenopticCamera(**CREMERS.numbers()), 0.0, 0.0, 2.6)
    row, radii = int(np.argmin(np.abs(grid.heights_mm))), np.arange(19) / 30
    for noise in (0.0, 0.01, 0.1):
        found = reconstruct_axisymmetric(noisy(views, noise, rng), grid).emission[row]
        fade = np.exp(-((grid.heights_mm[row] / FADES) ** 2))
        off = np.interp(CREMERS_RADIUS * radii, grid.radii_mm, found) / fade
        off -= cremers_profile(radii)
        rms, worst = float(np.sqrt(np.mean(off**2))), float(np.abs(off).max())
        pixels = f"49 views, {CREMERS_RADIUS / grid.radii_mm[1]:.0f} pixels, noise {noise:.0%}"
        yield {"method": "abel", "input": pixels, "rms": rms, "largest": worst}


LENSLETS, UNDER = (72, 52), 14
"""Number of lenslets, and of pixels under one along each axis."""

RAW, SEEN = (truth.Lens(views=views, lenslets=LENSLETS) for views in (UNDER, UNDER // 2))
CAMERA = PlenopticCamera(**SEEN.numbers(), aperture_diameter_mm=UNDER * RAW.step)
GRID = AxisymmetricGrid(CAMERA, axis_mm=0.0, depth_mm=0.0, radius_mm=3.0)
NM, PEAKS = np.arange(375.0, 726.0, 25.0), np.array([[610.0], [540.0], [460.0]])
MOSAIC = np.array([[0, 1], [1, 2]])[np.ix_(np.arange(UNDER) % 2, np.arange(UNDER) % 2)]
"""Colour of each pixel under a lenslet: rggb."""

OPEN = np.hypot(*(np.indices((UNDER, UNDER)) - (UNDER - 1) / 2)) <= UNDER / 2
BLACK, WHITE, FULL = 64.0, 3000.0, 4095
"""Black level, brightest signal above it, and largest number of the sensor."""

FURNACE_K, DRAWS = (1473.0, 1573.0, 1673.0, 1773.0, 1873.0), 20
"""Temperatures of the furnace, and number of bootstrap draws."""

SOOT = {
    "hollow, thickness 0.5": (truth.SootFlame(), 0.01, 1.0),
    "thin, thickness 0.05": (truth.SootFlame(thickness=0.05), 0.01, 1.0),
    "thick, thickness 1": (truth.SootFlame(thickness=1.0), 0.01, 1.0),
    "full core": (truth.SootFlame(core=1.0), 0.01, 1.0),
    "hollow, more noise": (truth.SootFlame(), 0.03, 1.0),
    "deeper than wide by 1.3": (truth.SootFlame(depth_ratio=1.3), 0.01, 1.0),
    "absorbs as wavelength^-1.4, taken for ^-1": (truth.SootFlame(), 0.01, 1.4),
}
"""Flame, noise relative to the brightest pixel, and exponent of its absorption."""


def curves(nm: np.ndarray) -> np.ndarray:
    """Give the camera's responses in red, green and blue, 67 nm wide and overlapping."""
    return np.exp(-(((nm - PEAKS) / 40) ** 2))


@cache
def soot_light(flame: truth.SootFlame, exponent: float) -> np.ndarray:
    """Trace the light of each pixel, [v, u, t, s]."""
    light = np.zeros((UNDER, UNDER, *LENSLETS))
    for colour, curve in enumerate(curves(NM)):
        band, where = curve > 1e-4, OPEN & (colour == MOSAIC)
        slabs = flame.slabs(NM[band], exponent)
        seen = truth.trace(RAW, slabs, parts=1, where=where, channels=(band.sum(),))
        light += seen @ curve[band] * (NM[1] - NM[0])
    return light


class Sensor:
    """Raw images of a colour camera, their decoding, and its calibration by a furnace."""

    def __init__(self, light: np.ndarray, noise: float, rng: np.random.Generator):
        self._rng, self._noise = rng, noise * WHITE
        self._gains = np.array([WHITE / light[colour == MOSAIC].max() for colour in range(3)])
        white = self._read(self._even([2000.0, 2600.0, 1500.0]), 2.0)
        dark = np.full(white.shape, BLACK, np.float32)
        self._plan = DecodePlan(
            estimate_grid(white - dark), shape=white.shape, views=SEEN.views, white=white,
            dark=dark, bayer="rggb",
        )  # fmt: skip
        nm = np.arange(375.0, 726.0, 5.0)
        responses = SpectralResponses(("red", "green", "blue"), nm, curves(nm))
        signals, exposures = [], []
        for kelvin in FURNACE_K:
            black = self._gains * (curves(NM) @ truth.planck(NM, kelvin)) * (NM[1] - NM[0])
            exposures.append(WHITE / black.max())
            picture = self._decode(self._even(black * exposures[-1]))
            signals.append(picture.photograph[8:-8, 8:-8].mean(axis=(0, 1), dtype=float))
        found = calibrate_colours(FURNACE_K, signals, responses, exposures=exposures)
        self.calibration = found.calibration

    def record(self, light: np.ndarray) -> LightField:
        """Record light with noise, and decode it."""
        return self._decode(light * self._gains[MOSAIC][..., None, None])

    def _decode(self, light: np.ndarray) -> LightField:
        return self._plan.decode(self._read(light, self._noise))

    def _even(self, colours) -> np.ndarray:
        return (OPEN * np.asarray(colours)[MOSAIC])[..., None, None] * np.ones(LENSLETS)

    def _read(self, light: np.ndarray, noise: float) -> np.ndarray:
        raw = light.transpose(2, 0, 3, 1).reshape([n * UNDER for n in LENSLETS])
        values = BLACK + raw + noise * self._rng.standard_normal(raw.shape)
        return np.clip(np.rint(values), 0, FULL).astype(np.float32)


def soot_truth(flame: truth.SootFlame) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Absorption and temperature at the nodes, and where the emission in red counts."""
    up, r = np.meshgrid(GRID.heights_mm, GRID.radii_mm, indexing="ij")
    absorption, kelvin = flame.absorption(r, up), flame.kelvin(r, up)
    red = absorption * truth.planck(PEAKS[0], kelvin)
    return absorption, kelvin, red > 0.2 * red.max()


def soot(rng: np.random.Generator) -> Iterator[dict]:
    """Find temperature and absorption together, and by two simpler assumptions."""
    for name, (flame, noise, exponent) in step_bar(SOOT.items(), len(SOOT)):
        light = soot_light(flame, exponent)
        sensor = Sensor(light, noise, rng)
        light_field, calibration = sensor.record(light), sensor.calibration
        together, thin = (
            reconstruct_soot(light_field, GRID, calibration, absorbing=absorbing, bootstrap=draws)
            for absorbing, draws in ((True, DRAWS), (False, DRAWS // 4))  # its bars mean nothing
        )
        peaks = SpectralResponses.single(PEAKS[:, 0])
        black = calibration.responses.black_body(1700.0) / peaks.black_body(1700.0)
        lines = soot_temperature(
            [one.emission for one in thin.colours], peaks,
            sigmas=[one.sigma for one in thin.colours], gains=calibration.gains * black,
        )  # fmt: skip
        for method, temperatures in (
            ("temperature and absorption together", together.temperatures),
            ("taken for optically thin", thin.temperatures),
            ("thin, each colour one wavelength", lines),
        ):
            judged = _judged(temperatures, *soot_truth(flame))
            if temperatures is not together.temperatures:
                del judged["covered"]
            yield {"flame": name, "noise": noise, "method": method} | judged


def _judged(temperatures, absorption: np.ndarray, kelvin: np.ndarray, lit: np.ndarray) -> dict:
    off, sigma = (temperatures.kelvin - kelvin)[lit], temperatures.sigma[lit]
    return {
        "rms_K": float(np.sqrt(np.nanmean(off**2))),
        "mean_K": float(np.nanmean(off)),
        "covered": float(np.nanmean(np.abs(off) < 1.96 * sigma)),
        "thickness": float(np.nanmedian(temperatures.amount[lit] / absorption[lit])),
    }


def in_the_mean(judged: list[tuple[float, float]]) -> dict:
    """Mean of the shares that bars cover, its standard error, and the mean error, over draws."""
    covered, error = np.array(judged).T
    standard_error = float(covered.std(ddof=1) / np.sqrt(covered.size))
    mean = {"covered": float(covered.mean()), "standard_error": standard_error}
    return mean | {"error": float(error.mean())}


def soot_bars(rng: np.random.Generator) -> Iterator[dict]:
    """Count how often bars of 95 % cover the true temperature of the first flame."""
    name, (flame, noise, exponent) = next(iter(SOOT.items()))
    light, judged = soot_light(flame, exponent), []
    sensor = Sensor(light, noise, rng)
    for draw in step_bar(range(10)):
        found = reconstruct_soot(
            sensor.record(light), GRID, sensor.calibration, bootstrap=DRAWS, seed=10 * draw
        )
        one = _judged(found.temperatures, *soot_truth(flame))
        judged.append((one["covered"], one["rms_K"]))
    yield {"flame": name, "noise": noise, "what": "temperatures"} | in_the_mean(judged)
