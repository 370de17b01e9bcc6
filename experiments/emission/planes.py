"""Emission by planes on traced flames, beside simple methods, and how often its bars are right."""

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from experiments.emission import truth
from experiments.emission.flames import PAPER, noisy
from experiments.emission.rivals import PLANES, QUICK
from experiments.emission.truth import Sheet, Slab, burner_sheet, volume
from experiments.report import step_bar
from lf_flame import LightField, PlenopticCamera
from lf_flame.tomography import FrustumGrid, reconstruct

OURS = "reconstruct"
SMALL = truth.Lens(lenslets=(60, 60))
QUARTER = truth.Lens(views=15, lenslets=(72, 84))
"""A field a quarter as wide as the paper's, for flames a quarter in size."""

DEPTHS = 20.0, 10.0, 0.0, -10.0


def four(heights, places, foot: float, size: float = 1.0) -> list[Slab]:
    """Four flames, each at a depth of its own; all lengths are multiplied by the size."""
    return [
        burner_sheet(size * depth, size * height, size * 2.4, size * foot, size * place)
        for depth, height, place in zip(DEPTHS, heights, places, strict=True)
    ]


def behind(size: float = 1.0) -> list[Slab]:
    """Four flames behind each other, so that every pixel holds several depths."""
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


def photons(views: np.ndarray, rng: np.random.Generator) -> LightField:
    """Count photo-electrons, 100 in the brightest pixel."""
    share = views.max() / 100
    return LightField(rng.poisson(views / share) * share)


def in_the_mean(judged: list[tuple[float, float]]) -> dict:
    """Mean of the shares that bars cover, its standard error, and the mean error, over draws."""
    covered, error = np.array(judged).T
    standard_error = float(covered.std(ddof=1) / np.sqrt(covered.size))
    mean = {"covered": float(covered.mean()), "standard_error": standard_error}
    return mean | {"error": float(error.mean())}


def _small(y, x, z):
    return truth.round_glow(0.5 - y / 6.25, np.hypot(x, z), 1.0)


def bars(rng: np.random.Generator) -> Iterator[dict]:
    """Count how often bars of 95 % cover the true emission of the cells of small flames."""
    apart, deep = [slab.depth for slab in behind(0.25)], volume(_small, 3.0, 0.125, (-4, 4, -3, 3))
    times = float(stats.t(20).ppf(0.975))
    cases = (
        traced("four flames side by side", QUARTER, side_by_side(0.25, 5.0), apart),
        traced("four flames behind each other", QUARTER, behind(0.25), apart),
        traced("a flame thick in depth", QUARTER, deep, np.arange(-3.0, 3.25, 0.5)),
    )
    for case in step_bar(cases):
        lit = case.truth > 0.05 * case.truth.max(axis=(1, 2), keepdims=True)
        for noise in (0.01, "100 electrons"):
            judged = []
            for _ in range(10):
                seen = photons(case.views, rng) if noise != 0.01 else noisy(case.views, noise, rng)
                found = reconstruct(seen, case.grid, bootstrap=20, rng=rng)
                covered = np.abs(found.emission - case.truth) <= times * found.sigma
                judged.append((covered[lit].mean(), relative_error(found.emission, case.truth)))
            yield {"flame": case.name, "noise": noise, "what": "cells"} | in_the_mean(judged)
