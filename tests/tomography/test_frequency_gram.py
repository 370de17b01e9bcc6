"""The Gram matrix by frequency, against the operator."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from lf_flame import LightField
from lf_flame.tomography import FrustumGrid, ProjectionOperator, reconstruct
from lf_flame.tomography.frequency_gram import COPIES, FrequencyGram, depth_roughness
from lf_flame.tomography.resolution import angular_width

DEPTHS = [18.0, 4.0, 0.0, -9.0]


@pytest.fixture(scope="module", params=[1, 2])
def grid(request, camera):
    return FrustumGrid(camera, DEPTHS, request.param)


def apply_by_frequency(gram, cells):
    spectrum = gram.transform(gram.spread(cells))
    seen = np.matmul(gram.matrices, spectrum[..., None])[..., 0]
    torus = np.fft.irfft2(np.moveaxis(seen, -1, 0), s=gram.size, axes=(1, 2))
    return gram.gather(torus)


@pytest.mark.slow
def test_it_equals_the_adjoint_of_the_operator_after_the_operator(grid):
    """Of cells whose light no view loses beyond its edge."""
    operator, gram = ProjectionOperator(grid, "float64"), FrequencyGram(grid)
    cells, far = np.zeros(grid.shape), 2 * grid.reach
    middle = (slice(None), slice(far, -far), slice(far, -far))
    cells[middle] = np.random.default_rng(0).random(cells[middle].shape)
    seen = operator.rmatvec(operator.matvec(cells.ravel())).reshape(grid.shape)
    assert apply_by_frequency(gram, cells) == pytest.approx(seen, abs=1e-9 * seen.max())


ROUND = np.hypot(*np.mgrid[-2:3, -2:3]) < 2.5
SLANTED = np.abs(np.subtract(*np.mgrid[-2:3, -2:3])) < 3  # like a pupil seen from aside


@pytest.mark.parametrize("used_views", [ROUND, SLANTED])
def test_so_it_does_for_some_of_the_views(camera, used_views):
    grid = FrustumGrid(replace(camera, views=5), DEPTHS, used_views=used_views)
    test_it_equals_the_adjoint_of_the_operator_after_the_operator(grid)
    assert FrequencyGram(grid).scale == used_views.sum()


def test_the_penalty_along_depth_counts_millimetres(camera):
    """The integral of 6^2 over depth, of an emission of z^3 per mm, however it is cut."""
    blur = 2 * camera.lenslet_in_focus_mm / angular_width(camera)  # of the finest detail
    expected = 1e-4 * (blur / 2) ** 7 * 36
    for count in (17, 33, 65):
        depths, step = np.linspace(-8, 8, count, retstep=True)
        light = step * depths**3
        form = light @ depth_roughness(FrustumGrid(camera, depths)) @ light
        assert form / (step * (count - 3)) == pytest.approx(expected, rel=1e-6)


@pytest.mark.slow
def test_as_many_copies_are_held_as_is_said(camera):
    """The peak of traced memory of a reconstruction, but for what does not grow with the planes."""
    grid = FrustumGrid(camera, np.linspace(-8, 8, 17).tolist())
    light_field = LightField(np.random.default_rng(0).random((7, 7, 54, 60), np.float32))
    tracemalloc.start()
    try:
        reconstruct(light_field, grid)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    matrices = FrequencyGram(grid).matrices.nbytes
    assert 0.6 * COPIES * matrices < peak < COPIES * matrices


def test_prior_is_drawn_with_the_covariance_of_the_penalty(camera):
    """Variance of third differences: mean of (4 sin^2 a + 4 sin^2 b)^3, 112, per cell."""
    few = FrequencyGram(FrustumGrid(camera, [3.0, -3.0]))
    drawn = few.draw_penalty(0.01, np.random.default_rng(0))
    assert np.mean(drawn**2) == pytest.approx(0.01 * camera.views**2 * 112, rel=0.1)
    many = FrequencyGram(FrustumGrid(camera, np.arange(-5.0, 6.0)))
    along = many.draw_penalty(0.0, np.random.default_rng(0)).reshape(11, -1)
    differences = np.diff(np.eye(11), 3, axis=0)
    wanted, got = differences.T @ differences, along @ along.T / along.shape[1]
    assert got / np.trace(got) == pytest.approx(wanted / np.trace(wanted), abs=0.01)
