"""Axisymmetric flames by `abel`, beside other inversions."""

from collections.abc import Iterator
from functools import cache

import numpy as np

from experiments.emission import truth
from experiments.emission.rivals import round_methods
from lf_flame import LightField, PlenopticCamera
from lf_flame.tomography import AxisymmetricGrid, find_axis, reconstruct_axisymmetric

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
