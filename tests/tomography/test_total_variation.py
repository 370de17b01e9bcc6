"""Total variation, against what it is good for."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from lf_flame import Layer, LightField, Scene, render
from lf_flame.tomography import (
    FrequencyGram,
    FrustumGrid,
    ProjectionOperator,
    reconstruct,
)
from lf_flame.tomography.penalised_fit import RangeFit
from lf_flame.tomography.total_variation import fit_total_variation


@pytest.fixture(scope="module")
def sharp():
    """A disc and a square in line, even within their edges."""
    y, x = np.mgrid[-1:1:120j, -1:1:120j]
    disc = (np.hypot(y, x) < 0.8).astype(float)
    square = 0.7 * (np.maximum(np.abs(y), np.abs(x)) < 0.6)
    return Scene(
        [Layer(disc, 3.0, (5.0, 5.0), (0.0, -0.6)), Layer(square, -4.0, (5.0, 5.0), (0.4, 0.8))]
    )


def in_noise(views, share):
    noise = np.random.default_rng(0).standard_normal(views.shape, dtype=np.float32)
    return LightField(views + np.float32(share * views.max()) * noise)


def worst(found, scene, grid):
    truth = [grid.crop(grid.average(layer, k)) for k, layer in enumerate(scene.layers)]
    return max(np.linalg.norm(a - b) / np.linalg.norm(b) for a, b in zip(found, truth, strict=True))


@pytest.mark.slow
def test_sharp_edges_want_total_variation_and_flames_do_not(camera, sharp, flames, clean):
    grid = FrustumGrid(camera, sharp.depths_mm)
    noisy = in_noise(render(sharp, camera).views, 0.1)
    smooth, varying = (reconstruct(noisy, grid, penalty=one) for one in ("roughness", "variation"))
    assert worst(varying.emission, sharp, grid) < 0.8 * worst(smooth.emission, sharp, grid)
    assert varying.emission.min() >= 0
    assert varying.tried == ()
    assert varying.strength == 2
    grid = FrustumGrid(camera, flames.depths_mm)
    noisy = in_noise(clean.views, 0.1)
    smooth, varying = (reconstruct(noisy, grid, penalty=one) for one in ("roughness", "variation"))
    assert worst(varying.emission, flames, grid) > 1.5 * worst(smooth.emission, flames, grid)


@pytest.mark.slow
def test_no_cell_alone_makes_the_sum_smaller(camera, sharp):
    """The optimum of the whole sum, by small changes of its own and by other fits."""
    camera = replace(camera, lenslets=(36, 42))
    grid = FrustumGrid(camera, sharp.depths_mm)
    views = in_noise(render(sharp, camera).views, 0.1).views
    operator, gram = ProjectionOperator(grid), FrequencyGram(grid)
    stack, weight = operator.rmatvec(views.ravel()).reshape(grid.shape), 1.4
    problem = RangeFit(gram, stack, 0.0, 0)

    def total(cells):
        seen = operator.matvec(cells.astype(np.float32).ravel()) - views.ravel()
        steps = [np.diff(cells, axis=k, append=0) for k in (1, 2)]
        return np.sum(seen.astype(np.float64) ** 2) / 2 + weight * np.hypot(*steps).sum()

    dark = np.zeros(grid.shape, np.float32)
    found = fit_total_variation(problem, weight, 300, dark)
    least = total(found)
    for other in (0.98 * found, 1.02 * found, ndimage.uniform_filter(found, (1, 3, 3))):
        assert total(other) > least
    for wrong in (0.5, 2.0):
        assert total(fit_total_variation(problem, wrong * weight, 300, dark)) > least
