"""The splitting: long steps, then short ones, from one state."""

from dataclasses import replace

import numpy as np
import pytest

from lf_flame import PAPER_CAMERA, Layer, Scene, render
from lf_flame.scenes.flames import flame_texture
from lf_flame.tomography import FrustumGrid, reconstruct
from lf_flame.tomography.geometries import PARTS, cell_means, smooth_course

CAMERA = replace(PAPER_CAMERA, views=7, lenslets=(48, 48))
DEPTHS_MM = [1.2, 0.0, -1.2]
GRID = FrustumGrid(CAMERA, DEPTHS_MM)


@pytest.fixture(scope="module")
def flames():
    """Three flames behind each other, so near that the views hardly tell them apart."""
    height = 0.6 * CAMERA.field_mm(0.0)[0]
    glow = flame_texture(height, height / 5, cell_mm=height / 60)
    places = zip(DEPTHS_MM, (-0.1, 0.06, 0.1), strict=True)
    size = height, 0.64 * height
    return Scene([Layer(glow, depth, size, (0.0, place * height)) for depth, place in places])


@pytest.mark.slow
def test_flames_that_hardly_differ_in_depth_are_told_apart(flames):
    """With short steps alone 0.82 % off; with a state scaled by the inverse, 1.2 %."""
    found = reconstruct(render(flames, CAMERA), GRID).emission
    truth = [GRID.crop(GRID.average(layer, k)) for k, layer in enumerate(flames.layers)]
    for one, true in zip(found, truth, strict=True):
        assert np.linalg.norm(one - true) < 0.0065 * np.linalg.norm(true)


def test_a_smooth_course_keeps_the_light_of_each_cell():
    bend = np.outer(1 + np.sin(np.arange(8) / 3), 2 + np.cos(np.arange(11) / 3))
    bend[6:, :5] = 0  # beside darkness a spline swings below 0
    course = smooth_course(bend)
    assert np.abs(cell_means(course) - bend).max() < 2e-3
    assert np.ptp(course[:PARTS, :PARTS]) > 0.1 * np.ptp(bend[:2, :2])  # no step
