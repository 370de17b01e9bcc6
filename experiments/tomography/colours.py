"""Temperature of soot from two reconstructions, of one flame in two colours."""

import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from experiments.tomography.phantoms import BLOCK, Recorder, paper_flames, truth_on
from experiments.tomography.tasks import DEPTHS_MM, NOISE, OURS, Row, relative_errors
from lf_flame import Scene
from lf_flame._common.figures import subplots
from lf_flame.tomography import FrustumGrid, reconstruct, two_colour_temperature
from lf_flame.tomography.two_colours import two_wavelengths

WAVELENGTHS_NM = (550.0, 650.0)

MIDDLE_K, SWING_K = 1800.0, 150.0
"""Temperature in the middle of a flame's height, and how much hotter its tip is."""

BOOTSTRAP = 20

BRIGHT = 0.2
"""Share of a plane's peak from which temperatures are compared."""

TASK = "soot in two colours"


def emission_ratio(kelvin: np.ndarray | float) -> np.ndarray:
    """Ratio of soot's emission at the first wavelength to that at the second."""
    first, second = two_wavelengths(WAVELENGTHS_NM).soot(kelvin, 1.0)
    return first / second


def in_green(scene: Scene) -> Scene:
    """Let each layer glow at the first wavelength as soot does whose red glow it is."""
    layers = []
    for layer in scene.layers:
        rows = layer.texture.shape[0]
        kelvin = MIDDLE_K + SWING_K * np.linspace(1, -1, rows)[:, None]
        glow = layer.texture * emission_ratio(kelvin)
        layers.append(replace(layer, texture=glow))
    return Scene(layers)


class Soot:
    """The paper's four flames in both colours, and temperatures from reconstructions of them."""

    def __init__(self):
        red, self.camera = paper_flames()
        self.scenes = in_green(red), red
        self.grid = FrustumGrid(self.camera, DEPTHS_MM, BLOCK)
        self.truths = [truth_on(self.grid, scene) for scene in self.scenes]
        # Of the cells' own light, so that how temperature varies within a cell is no error.
        self.wanted = two_colour_temperature(*self.truths, wavelengths_nm=WAVELENGTHS_NM).kelvin

    def find(self, noise: str, rng: np.random.Generator):
        """Emission in both colours, and the temperature, in a noise of `NOISE`."""
        found = []
        for scene in self.scenes:
            light_field = NOISE[noise](Recorder(scene, self.camera), rng)
            found.append(reconstruct(light_field, self.grid, bootstrap=BOOTSTRAP, rng=rng))
        emissions, sigmas = zip(*((one.emission, one.sigma) for one in found), strict=True)
        return emissions, two_colour_temperature(
            *emissions, wavelengths_nm=WAVELENGTHS_NM, sigmas=sigmas
        )


def two_colours(rng: np.random.Generator) -> Iterator[Row]:
    """Find temperatures of the paper's four flames from reconstructions at 550 and 650 nm."""
    flames = Soot()
    bright = flames.truths[1] > BRIGHT * flames.truths[1].max(axis=(1, 2), keepdims=True)
    for noise in ("none", "1 %"):
        begin = time.perf_counter()
        emissions, soot = flames.find(noise, rng)
        seconds = time.perf_counter() - begin
        known = bright & np.isfinite(soot.kelvin)
        off = (soot.kelvin - flames.wanted)[known]
        yield Row(TASK, noise, OURS, "temperature, rms error, K", _rms(off), None, seconds)
        yield Row(
            TASK, noise, OURS, "temperature, median error, K", float(np.median(np.abs(off))),
            1.0 if noise == "none" else None, seconds,
        )  # fmt: skip
        pairs = zip(emissions, flames.truths, strict=True)
        worst = max(max(relative_errors(*pair)) for pair in pairs)
        yield Row(TASK, noise, OURS, "emission, worst plane's error", worst, None, seconds)
        if noise != "none":
            spread = _rms(off / soot.sigma[known])
            yield Row(TASK, noise, OURS, "errors over propagated ones", spread, None, seconds)
            yield from _spread(flames, known, soot.sigma, rng)


DRAWS = 8
"""Of the noise, whose scatter is held against the propagated error."""


def _spread(flames: Soot, known, sigma, rng) -> Iterator[Row]:
    """Scatter of temperatures from draw to draw, relative to the error that was propagated."""
    recorders = [Recorder(scene, flames.camera) for scene in flames.scenes]
    begin, drawn = time.perf_counter(), []
    for _ in range(DRAWS):
        noisy = (one.with_noise(0.01, rng) for one in recorders)
        emissions = [reconstruct(one, flames.grid).emission for one in noisy]
        drawn.append(two_colour_temperature(*emissions, wavelengths_nm=WAVELENGTHS_NM).kelvin)
    scatter = np.std(drawn, axis=0, ddof=1)[known]
    ratio = float(np.sqrt(np.nanmean(scatter**2) / np.mean(sigma[known] ** 2)))
    seconds = (time.perf_counter() - begin) / DRAWS
    what = "scatter over propagated errors"
    yield Row(TASK, "1 %", OURS, what, ratio, 1.5, seconds)


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def colours_figure():
    """Show temperatures of a flame at 1 % of noise: truth, found, error, and emission's error."""
    flames = Soot()
    emissions, soot = flames.find("1 %", np.random.default_rng(0))
    wanted, truths = flames.wanted, flames.truths
    plane, (_, columns) = 1, np.nonzero(np.isfinite(soot.kelvin[1]))
    shown = slice(columns.min() - 3, columns.max() + 4)
    peak = truths[1][plane].max()
    panels = (
        ("true temperature (K)", np.where(np.isfinite(soot.kelvin), wanted, np.nan), 1600, 2000),
        ("found (K)", soot.kelvin, 1600, 2000),
        ("found - true (K)", soot.kelvin - wanted, -20, 20),
        ("standard deviation (K)", soot.sigma, 0, 20),
        ("error of emission (%)", 100 * (emissions[1] - truths[1]) / peak, -1, 1),
    )
    figure, axes = subplots(1, len(panels), figsize=(12, 4.6), layout="constrained")
    for axis, (word, planes, low, high) in zip(axes, panels, strict=True):
        colours = "RdBu_r" if low < 0 else "inferno"
        image = planes[plane][20:, shown]
        drawn = axis.imshow(image, cmap=colours, vmin=low, vmax=high)
        axis.set_facecolor("0.6")
        axis.set_xticks([])
        axis.set_yticks([])
        axis.set_title(word, fontsize=8)
        figure.colorbar(drawn, ax=axis, shrink=0.9)
    return figure
