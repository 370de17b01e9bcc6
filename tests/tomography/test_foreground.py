"""Which cells glow: noise is told from light, and faint light is not lost where it is seen."""

import numpy as np
import pytest

from lf_flame import Layer, LightField, Scene, render
from lf_flame.tomography import FrustumGrid, reconstruct


def test_faint_light_that_many_pixels_see_is_kept(camera, flames):
    """An even faint disc, fainter than the noise of a pixel, but seen by thousands of them."""
    y, x = np.mgrid[-1:1:80j, -1:1:80j]
    glow = 0.03 * (np.hypot(y, x) < 0.8)
    sheet = Layer(glow, -4.0, (6.0, 6.0))
    scene = Scene([flames.layers[0], sheet])
    grid = FrustumGrid(camera, [3.0, -4.0])
    views = render(scene, camera).views
    noise = np.random.default_rng(5).standard_normal(views.shape, dtype=np.float32)
    noisy = LightField(views + np.float32(0.05 * views.max()) * noise)
    truth = grid.crop(grid.average(sheet, 1))
    found = reconstruct(noisy, grid).emission[1]
    assert found.sum() == pytest.approx(truth.sum(), rel=0.1)
