"""Emission by depth in few photons, on a dark plane, and with a wrong black level."""

from dataclasses import replace
from functools import cache

import numpy as np

from experiments.hard_cases.report import Values, hard_case
from lf_flame import Layer, LightField, Scene, render
from lf_flame.optics.camera import PAPER_CAMERA
from lf_flame.refocus import shift_and_sum
from lf_flame.scenes.flames import flame_texture
from lf_flame.tomography import FrustumGrid, reconstruct

CAMERA = replace(PAPER_CAMERA, views=7, lenslets=(72, 84))
DEPTHS_MM = (3.0, 0.0, -4.0)
PLACES = ((-1.0, 6.5), (0.2, 5.5), (2.6, 4.5))


FLAMES = [
    Layer(flame_texture(height, 0.45, cell_mm=0.03), depth, (height, 2.88), (0.2, x))
    for depth, (x, height) in zip(DEPTHS_MM, PLACES, strict=True)
]


@cache
def clean() -> np.ndarray:
    """Render their views."""
    return render(Scene(FLAMES), CAMERA).views


def planted(grid: FrustumGrid) -> np.ndarray:
    """Average the flames over the grid's cells."""
    return np.array([grid.crop(grid.average(flame, k)) for k, flame in enumerate(FLAMES)])


def in_noise(views: np.ndarray, share: float) -> LightField:
    """Add noise of a share of the brightest pixel."""
    noise = np.random.default_rng(1).standard_normal(views.shape, dtype=np.float32)
    return LightField(views + np.float32(share * views.max()) * noise)


def by_plane(truth, obvious, ours) -> Values:
    """Compare planes by the norm of their difference, over that of the planted one."""
    norms = np.linalg.norm(truth, axis=(1, 2))
    off = [np.linalg.norm(found - truth, axis=(1, 2)) / norms for found in (obvious, ours)]
    return Values(np.zeros(len(truth)), *off, scale=1.0)


@hard_case(
    "five electrons in the brightest pixel", "refocused images", "planes fitted together", 0.12, 2
)
def five_electrons() -> Values:
    views, grid = clean(), FrustumGrid(CAMERA, DEPTHS_MM)
    electrons = np.random.default_rng(2).poisson(5 * views / views.max())
    counted = LightField((electrons * views.max() / 5).astype(np.float32))
    refocused = shift_and_sum(counted, grid.slopes)
    return by_plane(planted(grid), refocused, reconstruct(counted, grid).emission)


@hard_case(
    "light of a plane where nothing glows, of all light",
    "refocused images",
    "no negative light within the fit",
    0.01,
    10,
)
def dark_plane() -> Values:
    grid, noisy = FrustumGrid(CAMERA, (*DEPTHS_MM, -8.0)), in_noise(clean(), 0.02)
    total = planted(FrustumGrid(CAMERA, DEPTHS_MM)).sum()
    refocused = shift_and_sum(noisy, grid.slopes)[3].sum()
    return Values(0.0, refocused / total, reconstruct(noisy, grid).emission[3].sum() / total, 1.0)


@hard_case(
    "black level 0.02 of the peak too high",
    "fit of what the views hold",
    "background fitted too; said where it is not",
    0.02,
    5,
)
def black_level() -> Values:
    grid, peak = FrustumGrid(CAMERA, DEPTHS_MM), float(clean().max())
    wrong = LightField(in_noise(clean(), 0.01).views + np.float32(0.02 * peak))
    obvious, ours = (reconstruct(wrong, grid, background=one).emission for one in ("none", "fit"))
    return by_plane(planted(grid), obvious, ours)
