"""How often bands of 95 % of a profile hold the truth."""

import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from experiments.tomography.phantoms import (
    EXACT,
    overlapping_flames,
    paper_flames,
    shrunk,
    truth_on,
)
from experiments.tomography.tasks import DEPTHS_MM, OURS, Row
from lf_flame import PAPER_CAMERA, LightField, PlenopticCamera, Scene, render
from lf_flame._common.threads import one_thread
from lf_flame._common.workers import worker_pool
from lf_flame.tomography import FrustumGrid, reconstruct
from lf_flame.tomography.profiles import Profile, axial, radial

REDRAWS = 20
"""Of each reconstruction, as many as `lf-flame reconstruct` makes."""

NOISE_SHARE = 0.01

STRIP_MM = 0.3
"""Width of the strip that a profile is averaged over: some two cells."""

BRIGHT = 0.05
"""Share of a plane's peak from which a place counts."""

PROFILES = {"axial": axial, "radial": radial}


@dataclass(frozen=True)
class Held:
    """What came of one profile.

    Attributes
    ----------
    band, noise : float
        Share of the places whose truth lies within the band, and within 1.96 standard deviations
        of noise alone.
    error : float
        Root-mean-square error relative to the profile's truth.
    """

    band: float
    noise: float
    error: float


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


SCENES: dict[str, tuple[int, Callable[[], Scene]]] = {
    "profiles, four flames side by side": (200, _side_by_side),
    "profiles, four flames behind each other": (
        40,
        lambda: overlapping_flames(DEPTHS_MM, cell_mm=0.4),
    ),
}
"""Draws of the noise, and what makes the scene."""


def profile_bands(rng: np.random.Generator) -> Iterator[Row]:
    """Take profiles of flames in draw after draw of the noise."""
    with worker_pool(os.cpu_count() or 1) as pool:
        for task, (draws, make) in SCENES.items():
            scene, camera = _small(make())
            grid = FrustumGrid(camera, scene.depths_mm)
            truth = truth_on(grid, scene)
            clean = render(scene, camera, tolerance=EXACT).views
            of_draw = partial(_draw, clean, grid, truth)
            found = list(pool.map(of_draw, rng.spawn(draws)))
            yield from _rows(task, [one for held, _ in found for one in held], found)


def _rows(task: str, held: list[Held], found: list[tuple[list[Held], float]]) -> Iterator[Row]:
    noise, wanted = f"{NOISE_SHARE:.0%}, {len(found)} draws", "side by side" in task
    seconds = float(np.mean([took for _, took in found]))
    error = float(np.mean([one.error for one in held]))
    yield Row(task, noise, OURS, "profile's error", error, 0.02 if wanted else None, seconds)
    for measure, shares in (
        ("truth within the band of 95 %", [one.band for one in held]),
        ("truth within 1.96 sigma of noise", [one.noise for one in held]),
    ):
        yield Row(task, noise, OURS, measure, float(np.mean(shares)), None, seconds)


def _draw(
    clean: np.ndarray, grid: FrustumGrid, truth: np.ndarray, rng: np.random.Generator
) -> tuple[list[Held], float]:
    """Take the profiles in one draw, on one thread, for others run beside it; and the seconds."""
    noise = rng.standard_normal(clean.shape, dtype=np.float32)
    noisy = LightField(clean + np.float32(NOISE_SHARE * clean.max()) * noise)
    begin = time.perf_counter()
    with one_thread():
        held = list(_profiles(noisy, grid, truth, rng))
    return held, time.perf_counter() - begin


def _profiles(
    light_field: LightField, grid: FrustumGrid, truth: np.ndarray, rng: np.random.Generator
) -> Iterator[Held]:
    found = reconstruct(light_field, grid, redraws=REDRAWS, rng=rng)
    for plane, wanted in enumerate(truth):
        cell = grid.cell_mm(grid.depths_mm[plane])
        draws, nothing = found.draws[:, plane], np.empty((0, *wanted.shape))
        for name, take in PROFILES.items():
            middle = _middle(wanted, cell, name)
            profile = take(
                found.emission[plane], draws, cell, middle, STRIP_MM, found.correction[plane]
            )
            true = take(wanted, nothing, cell, middle, STRIP_MM).values
            yield _compare(profile, true, BRIGHT * float(wanted.max()))


def _compare(profile: Profile, true: np.ndarray, least: float) -> Held:
    off, bright = np.abs(profile.values - true), true > least
    band = np.mean(off[bright] <= profile.band[bright])
    noise = np.mean(off[bright] <= 1.96 * profile.sigma[bright])
    error = np.linalg.norm(profile.values - true) / np.linalg.norm(true)
    return Held(float(band), float(noise), float(error))


def _middle(image: np.ndarray, cell: float, name: str) -> float:
    """Where the light's middle is, across for a profile upwards and in height for the other."""
    axis = 0 if name == "axial" else 1
    light = image.sum(axis=axis)
    places = (np.arange(light.size) - (light.size - 1) / 2) * cell
    return float(light @ places / light.sum()) * (1 if name == "axial" else -1)
