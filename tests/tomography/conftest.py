"""A small camera and phantoms that the operator did not make."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from lf_flame import PAPER_CAMERA, Layer, LightField, Scene, render
from lf_flame.scenes.flames import flame_texture
from lf_flame.tomography import FrustumGrid, reconstruct

VIEWS = 7


@pytest.fixture(scope="session")
def camera():
    return replace(PAPER_CAMERA, views=VIEWS, lenslets=(54, 60))


@pytest.fixture(scope="session")
def flames():
    """Two flames in line and one beside them, of cells that fit no grid."""
    places = ((3.0, -0.8, 4.8), (0.0, 0.15, 4.1), (-4.0, 1.9, 3.4))
    return Scene(
        [
            Layer(flame_texture(height, 0.45, cell_mm=0.03), depth, (height, 2.88), (0.2, x))
            for depth, x, height in places
        ]
    )


@pytest.fixture(scope="session")
def clean(flames, camera):
    return render(flames, camera, tolerance=1e-6)


@pytest.fixture(scope="session")
def grid(camera, flames):
    return FrustumGrid(camera, [layer.depth_mm for layer in flames.layers])


@pytest.fixture(scope="session")
def truth(grid, flames):
    return np.stack(
        [grid.crop(grid.average(layer, plane)) for plane, layer in enumerate(flames.layers)]
    )


@pytest.fixture(scope="session")
def noisy(clean):
    """Add Gaussian noise of a share of the peak."""

    @cache
    def add(share, seed=0):
        if not share:
            return clean
        rng = np.random.default_rng(seed)
        noise = rng.standard_normal(clean.views.shape, dtype=np.float32)
        return LightField(clean.views + np.float32(share * clean.views.max()) * noise)

    return add


@pytest.fixture(scope="session")
def fits(noisy, grid):
    """The reconstruction with default options of flames in noise, made once for all tests."""
    return cache(lambda share: reconstruct(noisy(share), grid))
