"""How often bars of 95 % hold the truth: of cells, of profiles and of temperatures."""

import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from experiments.tomography.colours import WAVELENGTHS_NM, emission_ratio
from experiments.tomography.phantoms import (
    EXACT,
    overlapping_flames,
    paper_flames,
    shrunk,
    truth_on,
    volume_flame,
)
from experiments.tomography.tasks import DEPTHS_MM, OURS, Row
from lf_flame import PAPER_CAMERA, LightField, PlenopticCamera, Scene, render
from lf_flame._common.threads import one_thread
from lf_flame._common.workers import worker_pool
from lf_flame.optics.sensor import Sensor, expose
from lf_flame.tomography import FrustumGrid, reconstruct, two_colour_temperature
from lf_flame.tomography.error_bars import bar_times
from lf_flame.tomography.frustum_grid import planes_between
from lf_flame.tomography.profiles import axial, radial

BOOTSTRAP = 20
"""Of each reconstruction, as many as `lf-flame reconstruct` makes."""

TIMES = bar_times(BOOTSTRAP)
"""Number of standard errors that a bar of 95 % reaches."""

STRIP_MM = 0.3
"""Width of the strip that a profile is averaged over: some two cells."""

BRIGHT = 0.05
"""Share of a plane's peak from which a place counts."""

KELVIN = 1800.0
"""Even temperature of the flames, seen in two colours."""

PROFILES = {"axial": axial, "radial": radial}


def gaussian(clean: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Add noise of 1 % of the peak."""
    noise = rng.standard_normal(clean.shape, dtype=np.float32)
    return clean + np.float32(0.01 * clean.max()) * noise


def photons(clean: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Count photo-electrons, 100 in the brightest pixel."""
    return expose(clean, Sensor(exposure_e=100 / float(clean.max())), {"shot_noise"}, rng)


NOISE = {"1 %": gaussian, "100 electrons": photons}


@dataclass(frozen=True)
class Held:
    """What came of one draw of the noise.

    Shares of the cells, and of the profiles' places, whose truth lies within the bar;
    root-mean-square error of profiles, the mean over them, relative to the brightest one; emission
    and its standard deviation [plane, row, column].
    """

    cells: float
    profiles: float
    error: float
    seconds: float
    emission: np.ndarray
    sigma: np.ndarray


def _small(scene: Scene) -> tuple[Scene, PlenopticCamera]:
    """Make it a quarter in size, seen by 72 x 84 lenslets, so that a draw takes little time."""
    return shrunk(scene, 1 / 4), replace(PAPER_CAMERA, lenslets=(72, 84))


def _side_by_side() -> Scene:
    """Let the paper's flames stand closer, where a small field sees them all."""
    scene, _ = paper_flames()
    places = (-7.5, -2.5, 2.5, 7.5)
    return Scene(
        [
            replace(layer, centre_mm=(layer.centre_mm[0], place))
            for layer, place in zip(scene.layers, places, strict=True)
        ]
    )


@dataclass(frozen=True)
class Flames:
    """Flames whose bars are judged; `depths_mm` are the planes' (None: the layers')."""

    make: Callable[[], Scene]
    depths_mm: tuple[float, ...] | None = None


SCENES = {
    "bars, four flames side by side": Flames(_side_by_side),
    "bars, four flames behind each other": Flames(
        lambda: overlapping_flames(DEPTHS_MM, cell_mm=0.4)
    ),
    "bars, a flame thick in depth": Flames(
        lambda: volume_flame(25.0, 4.0, slab_mm=0.5, reach_mm=12.0),
        tuple(planes_between(-3, 3, 0.5)),
    ),
}


def count_held(draws: int, rng: np.random.Generator) -> Iterator[Row]:
    """Judge the bars of flames in draw after draw of two kinds of noise."""
    with worker_pool(os.cpu_count() or 1) as pool:
        for task, flames in SCENES.items():
            scene, camera = _small(flames.make())
            grid = FrustumGrid(camera, flames.depths_mm or scene.depths_mm)
            truth = truth_on(grid, scene)
            clean = render(scene, camera, tolerance=EXACT).views
            for noise, add in NOISE.items():
                of_draw = partial(_draw, clean, grid, truth, add)
                held = list(pool.map(of_draw, rng.spawn(draws)))
                yield from _rows(task, f"{noise}, {draws} draws", held, truth)


def _rows(task: str, noise: str, held: list[Held], truth: np.ndarray) -> Iterator[Row]:
    shares = {
        "profile's error": [one.error for one in held],
        "truth within the bar of 95 % of a cell": [one.cells for one in held],
        "truth within the band of 95 % of a profile": [one.profiles for one in held],
        "truth within the bar of 95 % of a temperature": [
            _temperatures(first, second, _bright(truth))
            for first, second in zip(held[::2], held[1::2], strict=False)
        ],
    }
    seconds = float(np.mean([one.seconds for one in held]))
    for measure, values in shares.items():
        yield Row(task, noise, OURS, measure, float(np.nanmean(values)), None, seconds)


def _bright(truth: np.ndarray) -> np.ndarray:
    return truth > BRIGHT * truth.max(axis=(1, 2), keepdims=True)


def _temperatures(first: Held, second: Held, bright: np.ndarray) -> float:
    """Share of temperatures held, two draws of one light being the two colours."""
    ratio = float(emission_ratio(KELVIN))
    soot = two_colour_temperature(
        ratio * first.emission,
        second.emission,
        wavelengths_nm=WAVELENGTHS_NM,
        sigmas=(ratio * first.sigma, second.sigma),
    )
    known = bright & np.isfinite(soot.kelvin)
    warm = np.abs(soot.kelvin - KELVIN) <= TIMES * soot.sigma
    return float(warm[known].mean()) if known.any() else float("nan")


def _draw(
    clean: np.ndarray,
    grid: FrustumGrid,
    truth: np.ndarray,
    add: Callable[[np.ndarray, np.random.Generator], np.ndarray],
    rng: np.random.Generator,
) -> Held:
    """Judge one draw, on one thread, for others run beside it."""
    begin = time.perf_counter()
    with one_thread():
        found = reconstruct(LightField(add(clean, rng)), grid, bootstrap=BOOTSTRAP, rng=rng)
    seconds = time.perf_counter() - begin
    within = np.abs(found.emission - truth) <= TIMES * found.sigma
    profiles, off, true = np.array(list(_profiles(found, grid, truth))).T
    cells, error = float(within[_bright(truth)].mean()), float(off.mean() / true.max())
    return Held(cells, float(profiles.mean()), error, seconds, found.emission, found.sigma)


def _profiles(found, grid: FrustumGrid, truth: np.ndarray) -> Iterator[tuple[float, ...]]:
    """Share of places within the band, and norms of error and truth, of each profile."""
    for plane, wanted in enumerate(truth):
        cell = grid.cell_mm(grid.depths_mm[plane])
        draws, nothing = found.draws[:, plane], np.empty((0, *wanted.shape))
        for name, take in PROFILES.items():
            middle = _middle(wanted, cell, name)
            profile = take(found.emission[plane], draws, cell, middle, STRIP_MM)
            true = take(wanted, nothing, cell, middle, STRIP_MM).values
            off, lit = np.abs(profile.values - true), true > BRIGHT * float(wanted.max())
            yield (
                float(np.mean(off[lit] <= profile.band[lit])),
                float(np.linalg.norm(off)),
                float(np.linalg.norm(true)),
            )


def _middle(image: np.ndarray, cell: float, name: str) -> float:
    """Where the light's middle is, across for a profile upwards and in height for the other."""
    axis = 0 if name == "axial" else 1
    light = image.sum(axis=axis)
    places = (np.arange(light.size) - (light.size - 1) / 2) * cell
    return float(light @ places / light.sum()) * (1 if name == "axial" else -1)
