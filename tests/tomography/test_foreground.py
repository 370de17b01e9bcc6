"""Which cells glow: noise is told from light, and faint light is not lost where it is seen."""

import numpy as np
import pytest

from lf_flame import Layer, LightField, Scene, render
from lf_flame.tomography import FrustumGrid, Roughness, reconstruct


def errors(found, truth):
    return np.array([np.linalg.norm(a - b) / np.linalg.norm(b) for a, b in zip(found, truth)])  # noqa: B905


@pytest.mark.slow
def test_light_that_noise_makes_is_taken_from_no_flame(grid, truth, noisy, fits):
    """The naive fit gives dark cells light, and takes it from bright ones at other depths."""
    plain = Roughness(dark_cells=False, corrected=False)
    naive = reconstruct(noisy(0.05), grid, penalty=plain).emission
    found = fits(0.05).emission
    dark = truth < 1e-6 * truth.max()
    assert (found[dark] > 0).mean() < 0.3 * (naive[dark] > 0).mean()
    assert errors(found, truth).max() < 0.6 * errors(naive, truth).max()
    # Bright cells have lost light in the naive fit, and hardly any in ours.
    bright = truth > 0.3 * truth.max()
    lost, kept = (1 - image[bright].sum() / truth[bright].sum() for image in (naive, found))
    assert lost > 0.005
    assert abs(kept) < 0.4 * lost


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


@pytest.mark.slow
def test_without_noise_nothing_is_taken_for_dark(grid, clean, fits):
    plain = reconstruct(clean, grid, penalty=Roughness(dark_cells=False)).emission
    assert np.abs(fits(0.0).emission - plain).max() < 2e-3 * plain.max()


@pytest.mark.slow
def test_it_is_the_same_each_time(grid, noisy, fits):
    again = reconstruct(noisy(0.05), grid)
    np.testing.assert_array_equal(again.emission, fits(0.05).emission)


@pytest.mark.slow
def test_a_correction_takes_the_cells_error_off(grid, truth, noisy):
    """Cells glow evenly and flames do not: with hardly any noise that is the error that is left."""
    plain = reconstruct(noisy(0.002), grid, penalty=Roughness(corrected=False), strength=1e-4)
    found = reconstruct(noisy(0.002), grid, strength=1e-4)
    assert not plain.correction.any()
    np.testing.assert_allclose(found.emission - found.correction, plain.emission, atol=1e-6)
    assert found.emission.min() >= 0
    uneven = [0, 2]  # the plane in focus has no error to correct
    before, after = errors(plain.emission, truth)[uneven], errors(found.emission, truth)[uneven]
    assert (after < 0.6 * before).all()
