"""Emission by depth in few photons, from few views, in any unit, and where it misleads."""

from dataclasses import replace
from functools import cache

import numpy as np

from experiments.hard_cases.case import Values, hard_case
from lf_flame import Layer, LightField, Scene, render
from lf_flame.optics.camera import PAPER_CAMERA
from lf_flame.refocus import shift_and_sum
from lf_flame.scenes.flames import flame_texture
from lf_flame.tomography import FrustumGrid, Roughness, reconstruct

CAMERA = replace(PAPER_CAMERA, views=7, lenslets=(72, 84))
DEPTHS_MM = (3.0, 0.0, -4.0)
PLACES = ((-1.0, 6.5), (0.2, 5.5), (2.6, 4.5))
LINEAR = Roughness(nonnegative=False)


@cache
def flames(depths=DEPTHS_MM) -> Scene:
    """Place three flames, each at its place and of its height."""
    return Scene(
        [
            Layer(flame_texture(height, 0.45, cell_mm=0.03), depth, (height, 2.88), (0.2, x))
            for depth, (x, height) in zip(depths, PLACES, strict=True)
        ]
    )


@cache
def clean(depths=DEPTHS_MM, views: int = 7) -> np.ndarray:
    """Render their views."""
    return render(flames(depths), replace(CAMERA, views=views)).views


def planted(grid: FrustumGrid, depths=DEPTHS_MM) -> np.ndarray:
    """Average the flames over the grid's cells."""
    layers = flames(depths).layers
    return np.array([grid.crop(grid.average(one, k)) for k, one in enumerate(layers)])


def in_noise(views: np.ndarray, share: float) -> LightField:
    """Add noise of a share of the brightest pixel."""
    noise = np.random.default_rng(1).standard_normal(views.shape, dtype=np.float32)
    return LightField(views + np.float32(share * views.max()) * noise)


def by_plane(truth, obvious, ours) -> Values:
    """Compare planes by the norm of their difference, over that of the planted one."""
    norms = np.linalg.norm(truth, axis=(1, 2))

    def off(found):
        return np.linalg.norm(found - truth, axis=(1, 2)) / norms

    return Values(np.zeros(len(truth)), off(obvious), off(ours), scale=1.0)


@hard_case(
    "error of the emission by five electrons in the brightest pixel",
    "linear fit, negative light cut off",
    "no negative light within the fit",
    0.12,
    2,
)
def five_electrons() -> Values:
    views, grid = clean(), FrustumGrid(CAMERA, DEPTHS_MM)
    electrons = np.random.default_rng(2).poisson(5 * views / views.max())
    counted = LightField((electrons * views.max() / 5).astype(np.float32))
    obvious = reconstruct(counted, grid, penalty=LINEAR).emission.clip(0)
    return by_plane(planted(grid), obvious, reconstruct(counted, grid).emission)


@hard_case(
    "light of a plane where nothing glows, of all light",
    "linear fit, negative light cut off",
    "no negative light within the fit",
    0.01,
    10,
)
def dark_plane() -> Values:
    grid, noisy = FrustumGrid(CAMERA, (*DEPTHS_MM, -8.0)), in_noise(clean(), 0.02)
    total = planted(FrustumGrid(CAMERA, DEPTHS_MM)).sum()
    linear = reconstruct(noisy, grid, penalty=LINEAR).emission.clip(0)[3].sum()
    return Values(0.0, linear / total, reconstruct(noisy, grid).emission[3].sum() / total, 1.0)


@hard_case(
    "error of the emission by nine views",
    "refocused images",
    "planes that are known, fitted together",
    0.15,
    3,
)
def nine_views() -> Values:
    grid, few = FrustumGrid(replace(CAMERA, views=3), DEPTHS_MM), in_noise(clean(views=3), 0.01)
    ours = reconstruct(few, grid).emission
    return by_plane(planted(grid), shift_and_sum(few, grid.slopes), ours)


@hard_case(
    "error of the emission at slopes above one lenslet a view",
    "refocused images",
    "planes that are known, fitted together",
    0.03,
    15,
)
def large_slopes() -> Values:
    depths = (9.0, 0.0, -7.0)
    grid, noisy = FrustumGrid(CAMERA, depths), in_noise(clean(depths), 0.01)
    ours = reconstruct(noisy, grid).emission
    return by_plane(planted(grid, depths), shift_and_sum(noisy, grid.slopes), ours)


@hard_case(
    "error of the emission in a unit 20 times smaller",
    "noise level of the unit before",
    "noise measured in the light field",
    0.1,
    5,
)
def another_unit() -> Values:
    grid, noisy = FrustumGrid(CAMERA, DEPTHS_MM), in_noise(clean(), 0.02)
    dim = LightField(noisy.views / np.float32(20))
    noise = 0.02 * float(clean().max())
    obvious, ours = (reconstruct(dim, grid, **x).emission * 20 for x in ({"noise": noise}, {}))
    return by_plane(planted(grid), obvious, ours)


@hard_case(
    "error of the emission under a black level that is 0.02 of the peak too high",
    "fit of what the views hold",
    "background fitted too; said where it is not",
    0.02,
    5,
)
def black_level() -> Values:
    grid, peak = FrustumGrid(CAMERA, DEPTHS_MM), float(clean().max())
    wrong = LightField(in_noise(clean(), 0.01).views + np.float32(0.02 * peak))
    obvious, ours = (reconstruct(wrong, grid, **x).emission for x in ({}, {"background": "fit"}))
    return by_plane(planted(grid), obvious, ours)


@hard_case(
    "three flames behind an opaque burner",
    "does their sum look like the central view?",
    "misfit over the noise, in all views",
    0.0,
)
def opaque_burner() -> Values:
    grid, peak = FrustumGrid(CAMERA, DEPTHS_MM), float(clean().max())
    burner = Layer(np.zeros((4, 4)), -8.0, (2.0, 4.0), (2.2, -0.6), opaque=True)
    noisy = in_noise(render(Scene([*flames().layers, burner]), CAMERA).views, 0.01)
    found = reconstruct(noisy, grid, noise=0.01 * peak)

    off = np.sqrt(np.mean((found.emission.sum(axis=0) - noisy.views[3, 3]) ** 2)) / peak
    return Values("misfit", "fits" if off < 0.05 else "misfit",
                  "misfit" if found.warnings else "fits")  # fmt: skip
