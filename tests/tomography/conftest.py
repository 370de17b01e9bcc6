"""A small camera and phantoms that the operator did not make."""

from dataclasses import replace

import numpy as np
import pytest

from lf_flame import PAPER_CAMERA, Layer, LightField, Scene, render
from lf_flame.scenes.flames import flame_texture

VIEWS = 7


@pytest.fixture(scope="session")
def camera():
    return replace(PAPER_CAMERA, views=VIEWS, lenslets=(72, 84))


@pytest.fixture(scope="session")
def flames():
    """Two flames in line and one beside them, of cells that fit no grid."""
    places = ((3.0, -1.0, 6.5), (0.0, 0.2, 5.5), (-4.0, 2.6, 4.5))
    return Scene(
        [
            Layer(flame_texture(height, 0.45, cell_mm=0.03), depth, (height, 2.88), (0.2, x))
            for depth, x, height in places
        ]
    )


@pytest.fixture(scope="session")
def clean(flames, camera):
    return render(flames, camera, tolerance=1e-6)


@pytest.fixture
def noisy(clean):
    """Add Gaussian noise of a share of the peak."""

    def add(share, seed=0):
        rng = np.random.default_rng(seed)
        noise = rng.standard_normal(clean.views.shape, dtype=np.float32)
        return LightField(clean.views + np.float32(share * clean.views.max()) * noise)

    return add
