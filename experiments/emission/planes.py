"""Emission of traced flames, by planes and about an axis, and by simple methods; error bars."""

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy import stats

from experiments.emission import truth
from experiments.emission.rivals import PLANES, QUICK, round_methods
from experiments.emission.truth import Sheet, Slab, burner_sheet, volume
from experiments.report import step_bar
from lf_flame import LightField, PlenopticCamera
from lf_flame.tomography import (
    AxisymmetricGrid,
    FrustumGrid,
    find_axis,
    reconstruct,
    reconstruct_axisymmetric,
)

PAPER = truth.Lens(views=15, lenslets=(90, 180), lenslet_focal=1.2, pitch=0.336)
"""The paper's camera, whose images of 270 x 540 lenslets are averaged to 90 x 180 pixels."""

OURS = "reconstruct"
SMALL = truth.Lens(lenslets=(60, 60))
QUARTER = truth.Lens(views=15, lenslets=(72, 84))
"""A field a quarter as wide as the paper's, for flames a quarter in size."""

DEPTHS = 20.0, 10.0, 0.0, -10.0


def noisy(views: np.ndarray, noise: float, rng: np.random.Generator) -> LightField:
    """Add Gaussian noise, relative to the brightest pixel."""
    return LightField(views + noise * views.max() * rng.standard_normal(views.shape))


def four(heights, places, foot: float, size: float = 1.0) -> list[Slab]:
    """Four flames, each at a depth of its own; all lengths are multiplied by the size."""
    return [
        burner_sheet(size * depth, size * height, size * 2.4, size * foot, size * place)
        for depth, height, place in zip(DEPTHS, heights, places, strict=True)
    ]


def behind(size: float = 1.0) -> list[Slab]:
    """Four flames behind each other, so that every pixel shows several depths."""
    return four((28.0, 22.0, 18.0, 25.0), (-3.0, 2.5, -1.0, 4.0), 14.0, size)


def side_by_side(size: float = 1.0, apart: float = 17.0) -> list[Slab]:
    """Four flames about as large and as far apart as the paper's."""
    places = apart * np.arange(-1.5, 2.0)
    return four((27.4, 23.0, 21.5, 13.2), places, 14.5, size)


def grid_of(lens: truth.Lens, depths: Sequence[float]) -> FrustumGrid:
    """Make the grid on which the emission is sought."""
    return FrustumGrid(PlenopticCamera(**lens.numbers()), [float(depth) for depth in depths])


def relative_error(found: np.ndarray, wanted: np.ndarray) -> float:
    """Root-mean-square error over all cells, relative to the truth's root mean square."""
    return float(np.linalg.norm(found - wanted) / np.linalg.norm(wanted))


@dataclass(frozen=True, eq=False)
class Case:
    """A flame's views without noise, and its emission on the planes on which it is sought."""

    name: str
    views: np.ndarray
    truth: np.ndarray
    grid: FrustumGrid

    def errors(self, noises: Sequence[float], draws: int, rng, methods=PLANES) -> Iterator[dict]:
        """Give the mean error of every method over draws of each noise."""
        for noise in noises:
            errors = defaultdict(list)
            for _ in range(draws):
                light_field = noisy(self.views, noise, rng)
                ours = reconstruct(light_field, self.grid)
                errors[OURS].append(relative_error(ours.emission, self.truth))
                for method, find in methods.items():
                    found = find(light_field, self.grid, ours.noise)
                    errors[method].append(min(relative_error(one, self.truth) for one in found))
            for method, some in errors.items():
                mean = float(np.mean(some))
                yield {"flame": self.name, "noise": noise, "method": method, "error": mean}


def traced(name: str, lens: truth.Lens, slabs: Sequence[Slab], depths: Sequence[float]) -> Case:
    """Trace slabs, and lay the emission of each on the nearest plane."""
    wanted = truth.on_planes(lens, slabs, depths)
    spots = 4 if lens == PAPER else 2
    return Case(name, truth.trace(lens, slabs, spots), wanted, grid_of(lens, depths))


SHEETS, DEEP = (6.0, 2.0, -2.0, -6.0), tuple(np.arange(-4.0, 4.5))


def _sheets(name: str, lens: truth.Lens, depths: Sequence[float], aside: float = 0.0) -> Case:
    sheets = [
        Sheet(depth, (aside, place + aside), (1.5, 0.7))
        for depth, place in zip(depths, (-1.2, 1.1, -0.3, 0.6), strict=True)
    ]
    wanted = [truth.cells(SMALL, *pair) for pair in zip(sheets, SHEETS, strict=True)]
    return Case(name, truth.record(lens, sheets), np.array(wanted), grid_of(SMALL, SHEETS))


def _disc(y, x):
    return np.clip(0.5 - (np.hypot(y, x + 0.6) - 1.7) / 0.1, 0, 1), 0.0  # an edge of 0.1 mm


def _square(y, x):
    outside = np.maximum(np.abs(y), np.abs(x - 0.6)) - 1.5
    return 0.7 * np.clip(0.5 - outside / 0.1, 0, 1), 0.0


def _hollow(y, x, z):
    return np.exp(-(((np.hypot(x, z) - 1.2) / 0.35) ** 2) - (y / 1.5) ** 2)


def known_planes(rng: np.random.Generator) -> Iterator[dict]:
    """Find small flames behind each other, and flames that are thick in depth."""
    for case in (
        _sheets("sheets, on the planes", SMALL, SHEETS),
        _sheets("sheets, 0.6 mm off, moved aside", SMALL, (6.6, 1.4, -2.6, -5.4), 0.05),
        _sheets("sheets, pitch 0.5 % wrong", replace(SMALL, pitch=1.005 * SMALL.pitch), SHEETS),
        traced("disc and square", SMALL, [Slab(3.0, _disc), Slab(-4.0, _square)], (3.0, -4.0)),
        traced("hollow flame", SMALL, volume(_hollow, 2.5, 0.1), DEEP),
    ):
        yield from case.errors((0.01, 0.1), 3, rng)


def large_flames(rng: np.random.Generator) -> Iterator[dict]:
    """Find four flames of the paper's kind, by the methods that are quick at that size."""
    for name, slabs in (("side by side", side_by_side()), ("behind each other", behind())):
        case = traced(f"four flames {name}", PAPER, slabs, DEPTHS)
        yield from case.errors((0.01, 0.05), 3, rng, QUICK)


def _small(y, x, z):
    return truth.round_glow(0.5 - y / 6.25, np.hypot(x, z), 1.0)


def bars(rng: np.random.Generator) -> Iterator[dict]:
    """Count how often bars of 95 % cover the true emission of the cells of small flames.

    Electrons are those of the brightest pixel.
    """
    apart, deep = [slab.depth for slab in behind(0.25)], volume(_small, 3.0, 0.125, (-4, 4, -3, 3))
    times = float(stats.t(20).ppf(0.975))
    cases = (
        traced("four flames side by side", QUARTER, side_by_side(0.25, 5.0), apart),
        traced("four flames behind each other", QUARTER, behind(0.25), apart),
        traced("a flame thick in depth", QUARTER, deep, np.arange(-3.0, 3.25, 0.5)),
    )
    for case in step_bar(cases):
        lit = case.truth > 0.05 * case.truth.max(axis=(1, 2), keepdims=True)
        electron = case.views.max() / 100
        for noise in (0.01, "100 electrons"):
            covered, errors = [], []
            for _ in range(10):
                seen = (
                    noisy(case.views, 0.01, rng)
                    if noise == 0.01
                    else LightField(rng.poisson(case.views / electron) * electron)
                )
                found = reconstruct(seen, case.grid, bootstrap=20, rng=rng)
                inside = np.abs(found.emission - case.truth) <= times * found.sigma
                covered.append(inside[lit].mean())
                errors.append(relative_error(found.emission, case.truth))
            yield {
                "flame": case.name, "noise": noise, "what": "cells",
                "covered": float(np.mean(covered)),
                "standard_error": float(np.std(covered, ddof=1) / np.sqrt(len(covered))),
                "error": float(np.mean(errors)),
            }  # fmt: skip


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
