"""Tasks of finding emission by depth, each with the simple rivals that people would try first."""

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from experiments.tomography.phantoms import (
    BLOCK,
    EXACT,
    Recorder,
    in_even_matter,
    in_own_matter,
    overlapping_flames,
    paper_flames,
    shrunk,
    thickness_on,
    truth_on,
    two_blobs,
    volume_flame,
)
from lf_flame import PAPER_CAMERA, LightField, render
from lf_flame.refocus import shift_and_sum
from lf_flame.tomography import FrustumGrid, Roughness, reconstruct
from lf_flame.tomography.frustum_grid import planes_between
from lf_flame.tomography.resolution import angular_width

DEPTHS_MM = (20.0, 10.0, 0.0, -10.0)
EXCHANGED_MM = (-10.0, 20.0, 0.0, 10.0)

SEPARATIONS = (0.5, 0.6, 0.7, 0.85, 1.0, 1.2, 1.5, 2.0)
"""Distances of two blobs that are tried, in those by the rule."""


@dataclass(frozen=True)
class Row:
    """A line of the table: a measure's value, and what the project wants to reach, at most."""

    task: str
    noise: str
    method: str
    measure: str
    value: float
    accepted: float | None
    seconds: float


def relative_errors(found: np.ndarray, truth: np.ndarray) -> list[float]:
    """Root-mean-square error of each plane relative to its root-mean-square emission."""
    return [
        float(np.linalg.norm(a - b) / np.linalg.norm(b)) for a, b in zip(found, truth, strict=True)
    ]


Method = Callable[[LightField, FrustumGrid], np.ndarray]


def by_reconstruction(
    light_field: LightField, grid: FrustumGrid, thickness: np.ndarray | None = None
) -> np.ndarray:
    """Ours, as a user calls it, noise measured."""
    return reconstruct(light_field, grid, optical_thickness=thickness).emission


def by_focal_stack(light_field: LightField, grid: FrustumGrid) -> np.ndarray:
    """Take refocused images for emission, as the paper's planes are read."""
    stack = shift_and_sum(light_field, grid.slopes)
    rows, columns = grid.pixels
    return stack.reshape(len(stack), rows, BLOCK, columns, BLOCK).mean(axis=(2, 4))


def by_clipping(light_field: LightField, grid: FrustumGrid) -> np.ndarray:
    """Fit without the bound at zero, and cut negative light off afterwards."""
    linear = reconstruct(light_field, grid, penalty=Roughness(nonnegative=False))
    return np.clip(linear.emission, 0, None)


OURS = "reconstruct"
IGNORED = "reconstruct, light taken to add"
METHODS: dict[str, Method] = {
    OURS: by_reconstruction,
    "focal stack as emission": by_focal_stack,
    "linear fit, negative light cut off": by_clipping,
}


def worst_planes(
    task: str,
    noise: str,
    light_field: LightField,
    grid: FrustumGrid,
    truth: np.ndarray,
    methods: dict[str, Method] = METHODS,
    wanted: float | None = None,
) -> Iterator[Row]:
    """Error of the worst plane by each method, and what is wanted of ours."""
    for method, find in methods.items():
        found, seconds = timed(find, light_field, grid)
        worst = max(relative_errors(found, truth))
        limit = wanted if method == OURS else None
        yield Row(task, noise, method, "worst plane's error", worst, limit, seconds)


Noise = dict[str, Callable[[Recorder, np.random.Generator], LightField]]

NOISE: Noise = {
    "none": lambda recorder, rng: recorder.clean,
    "1 %": lambda recorder, rng: recorder.with_noise(0.01, rng),
    "5 %": lambda recorder, rng: recorder.with_noise(0.05, rng),
    "100 electrons": lambda recorder, rng: recorder.with_electrons(100, rng),
}


def planes_known(rng: np.random.Generator) -> Iterator[Row]:
    """Find the paper's four flames, and four behind each other, at known depths."""
    scene, camera = paper_flames()
    wanted = {"1 %": 0.015, "5 %": 0.05, "100 electrons": 0.06}
    scenes = {
        "the paper's four flames": (scene, wanted, METHODS),
        "four flames behind each other": (overlapping_flames(DEPTHS_MM), {}, METHODS),
        "the same, exchanged": (overlapping_flames(EXCHANGED_MM), {}, {OURS: by_reconstruction}),
    }
    grid = FrustumGrid(camera, DEPTHS_MM, BLOCK)
    for task, (phantom, accepted, methods) in scenes.items():
        recorder, truth = Recorder(phantom, camera), truth_on(grid, phantom)
        for noise, record in NOISE.items():
            light_field = record(recorder, rng)
            yield from worst_planes(
                task, noise, light_field, grid, truth, methods, accepted.get(noise)
            )


NOISE_SHARES = (0.001, 0.003, 0.01, 0.03, 0.1, 0.3)

AGAINST_NOISE = "error against noise"


def against_noise(rng: np.random.Generator) -> Iterator[Row]:
    """Find the paper's four flames in ever more noise."""
    scene, camera = paper_flames()
    grid = FrustumGrid(camera, DEPTHS_MM, BLOCK)
    recorder, truth = Recorder(scene, camera), truth_on(grid, scene)
    for share in NOISE_SHARES:
        light_field = recorder.with_noise(share, rng)
        yield from worst_planes(AGAINST_NOISE, f"{share:.1%}", light_field, grid, truth)


def depth_unknown(rng: np.random.Generator) -> Iterator[Row]:
    """Find where the light of the same flames lies, at none of the depths of twenty planes."""
    scene, camera = paper_flames()
    recorder = Recorder(scene, camera)
    grid = FrustumGrid(camera, planes_between(-15, 23, 2), BLOCK)
    depths = np.array(grid.depths_mm)
    truth = truth_on(FrustumGrid(camera, DEPTHS_MM, BLOCK), scene)
    for noise, limit in (("none", 0.1), ("1 %", 0.5)):
        light_field = NOISE[noise](recorder, rng)
        for method in (OURS, "focal stack as emission"):
            found, seconds = timed(METHODS[method], light_field, grid)
            off = []
            for depth, plane in zip(DEPTHS_MM, truth, strict=True):
                light = found[:, plane > 0.05 * plane.max()].sum(axis=1, dtype=np.float64)
                off.append(abs(float(light @ depths / light.sum()) - depth))
            task, accepted = "depth unknown, 20 planes", limit if method == OURS else None
            yield Row(task, noise, method, "worst centroid, mm", max(off), accepted, seconds)


def thick_flame(rng: np.random.Generator) -> Iterator[Row]:
    """Find a flame that is round in depth too, in thirteen planes."""
    camera = PAPER_CAMERA
    flame = volume_flame(25.0, 4.0, slab_mm=0.5, reach_mm=12.0)
    grid = FrustumGrid(camera, planes_between(-12, 12, 2), BLOCK)
    recorder, truth = Recorder(flame, camera), truth_on(grid, flame)
    depths = np.array(grid.depths_mm)
    true_width = _width(truth, depths)
    for noise, limit in (("none", None), ("1 %", 0.2), ("5 %", 0.3)):
        light_field = NOISE[noise](recorder, rng)
        for method in (OURS, "focal stack as emission"):
            found, seconds = timed(METHODS[method], light_field, grid)
            error = float(np.linalg.norm(found - truth) / np.linalg.norm(truth))
            accepted = limit if method == OURS else None
            task = "thick flame, 13 planes"
            yield Row(task, noise, method, "error of the volume", error, accepted, seconds)
            bias = _width(found, depths) / true_width - 1
            yield Row(task, noise, method, "width in depth, too wide by", bias, None, seconds)


def absorption(rng: np.random.Generator) -> Iterator[Row]:
    """Find how much light four small flames have that absorb, their thickness given or ignored.

    In matter that is even over all of the field, and in matter that is where they glow. A quarter
    of the others in size, seen by 72 x 84 lenslets: through matter light is more work to render.
    """
    camera = replace(PAPER_CAMERA, lenslets=(72, 84))
    flames = shrunk(overlapping_flames(DEPTHS_MM, cell_mm=0.4), 1 / 4)
    grid = FrustumGrid(camera, flames.depths_mm)
    for total in (0.2, 0.5):
        scenes = {
            "even matter": in_even_matter(flames, total, half_mm=8.0),
            "matter of their own": in_own_matter(flames, total),
        }
        for matter, scene in scenes.items():
            truth, thickness = truth_on(grid, scene), thickness_on(grid, scene)
            clean = render(scene, camera, tolerance=EXACT).views
            noise = np.float32(0.01 * clean.max()) * rng.standard_normal(clean.shape, np.float32)
            for method, given, limit in ((OURS, thickness, 0.02), (IGNORED, None, None)):
                find = partial(by_reconstruction, thickness=given)
                found, seconds = timed(find, LightField(clean + noise), grid)
                task = f"flames in {matter}, thickness {total:g}"
                bias = abs(float(found.sum() / truth.sum()) - 1)
                yield Row(task, "1 %", method, "bias of all light", bias, limit, seconds)
                worst = max(relative_errors(found, truth))
                yield Row(task, "1 %", method, "worst plane's error", worst, None, seconds)


def separation(rng: np.random.Generator) -> Iterator[Row]:
    """Find how far apart in depth two blobs must be to be seen as two, at 1 % of noise.

    The rule is twice their radius over the angle of the aperture. They are two where the light
    between them falls to 81 % of the fainter one, as by Rayleigh's criterion.
    """
    camera = replace(PAPER_CAMERA, lenslets=(60, 60))
    for radius in (0.3, 0.6, 1.2):
        rule, begin = 2 * radius / angular_width(camera), time.perf_counter()
        tried = (
            share for share in SEPARATIONS if _are_two(camera, radius, share * rule, rule / 6, rng)
        )
        share = next(tried, math.inf)
        yield Row(
            f"two blobs, {radius:g} mm, {rule:.1f} mm by the rule", "1 %", OURS,
            "two from, times the rule", share, 1.5, time.perf_counter() - begin,
        )  # fmt: skip


def _are_two(camera, radius_mm: float, distance_mm: float, step_mm: float, rng) -> bool:
    depths = step_mm * np.arange(-9, 10)
    grid = FrustumGrid(camera, depths.tolist())
    clean = render(two_blobs(radius_mm, distance_mm), camera, tolerance=EXACT)
    noise = rng.standard_normal(clean.views.shape, dtype=np.float32)
    noisy = LightField(clean.views + np.float32(0.01 * clean.views.max()) * noise)
    found = reconstruct(noisy, grid).emission
    middle = np.arange(60) - 29.5
    inside = np.hypot(middle[:, None], middle) * grid.cell_mm(0.0) < radius_mm
    light = found[:, inside].sum(axis=1, dtype=np.float64)
    near, far, between = light[depths < 0].max(), light[depths > 0].max(), light[9]
    return bool(between <= 0.81 * min(near, far))


def disturbances(rng: np.random.Generator) -> Iterator[Row]:
    """Find four flames at 1 % of noise, with a camera that is not quite as was said."""
    scene, camera = paper_flames()
    recorder = Recorder(scene, camera)
    grid = FrustumGrid(camera, DEPTHS_MM, BLOCK)
    truth = truth_on(grid, scene)
    noisy = recorder.with_noise(0.01, rng)
    bright = np.float32(recorder.peak)
    for share in (0.005, 0.02):
        gains = 1 + share * rng.standard_normal((*noisy.views.shape[:2], 1, 1), dtype=np.float32)
        uneven = LightField(noisy.views * gains)
        yield from _disturbed(f"gains of views {share:.1%}", uneven, grid, truth)
    for share in (0.02, 0.05):
        lit = LightField(noisy.views + np.float32(share) * bright)
        yield from _disturbed(f"background {share:.0%} of the peak", lit, grid, truth)
    for shift in (0.5, 2.0):
        moved = replace(grid, depths_mm=[depth + shift for depth in DEPTHS_MM])
        yield from _disturbed(f"depths {shift:g} mm off", noisy, moved, truth)
    for share in (0.01, 0.05):
        # Slopes wrong by a share: the depths that have them.
        wrong = [float(camera.slope_to_depth(slope * (1 + share))) for slope in grid.slopes]
        moved = replace(grid, depths_mm=wrong)
        yield from _disturbed(f"slopes {share:.0%} off", noisy, moved, truth)


def _disturbed(
    what: str, light_field: LightField, grid: FrustumGrid, truth: np.ndarray
) -> Iterator[Row]:
    ours = {OURS: by_reconstruction}
    return worst_planes("disturbed", f"1 %, {what}", light_field, grid, truth, ours)


def _width(planes: np.ndarray, depths: np.ndarray) -> float:
    """Root-mean-square extent of the light along depth."""
    light = planes.sum(axis=(1, 2), dtype=np.float64)
    middle = light @ depths / light.sum()
    return float(np.sqrt(light @ (depths - middle) ** 2 / light.sum()))


def timed(find: Method, light_field: LightField, grid: FrustumGrid) -> tuple[np.ndarray, float]:
    """Call a method; also the seconds that it takes."""
    begin = time.perf_counter()
    found = find(light_field, grid)
    return found, time.perf_counter() - begin


TASKS = (
    planes_known,
    against_noise,
    depth_unknown,
    thick_flame,
    absorption,
    separation,
    disturbances,
)
