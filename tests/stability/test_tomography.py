"""Emission by depth where it is hard, beside the obvious way, which fails."""

import numpy as np
import pytest

pytest.importorskip("pyproximal")

from lf_flame import Layer, LightField, PlenopticCamera, Scene, render
from lf_flame.refocus import shift_and_sum
from lf_flame.scenes.flames import flame_texture
from lf_flame.tomography import FrustumGrid, reconstruct

DEPTHS_MM = (3.0, 0.0, -4.0)
PLACES = ((-1.0, 6.5), (0.2, 5.5), (2.6, 4.5))


def camera_of(views=7, lenslets=(72, 84)):
    return PlenopticCamera(150.0, 326.0, 0.4, 0.112, views, lenslets)


@pytest.fixture(scope="module")
def camera():
    return camera_of()


@pytest.fixture(scope="module")
def flames():
    return Scene(
        [
            Layer(flame_texture(height, 0.45, cell_mm=0.03), depth, (height, 2.88), (0.2, x))
            for depth, (x, height) in zip(DEPTHS_MM, PLACES, strict=True)
        ]
    )


@pytest.fixture(scope="module")
def clean(flames, camera):
    return render(flames, camera).views


@pytest.fixture(scope="module")
def grid(camera):
    return FrustumGrid(camera, DEPTHS_MM)


@pytest.fixture(scope="module")
def truth(grid, flames):
    return np.array([grid.crop(grid.average(one, k)) for k, one in enumerate(flames.layers)])


def worst(found, truth):
    pairs = zip(found, truth, strict=True)
    return max(float(np.linalg.norm(a - b) / np.linalg.norm(b)) for a, b in pairs)


def in_noise(views, share, seed=1):
    rng = np.random.default_rng(seed)
    noise = rng.standard_normal(views.shape, dtype=np.float32)
    return LightField(views + np.float32(share * views.max()) * noise)


def test_five_electrons_in_the_brightest_pixel(clean, grid, truth):
    electrons = np.random.default_rng(2).poisson(5 * clean / clean.max())
    counted = LightField((electrons * clean.max() / 5).astype(np.float32))
    assert worst(reconstruct(counted, grid).emission, truth) < 0.12
    # Cutting negative light off afterwards is no fit without negative light.
    linear = reconstruct(counted, grid, nonnegative=False).emission
    assert worst(np.clip(linear, 0, None), truth) > 0.25
    assert worst(shift_and_sum(counted, grid.slopes), truth) > 0.5


@pytest.mark.parametrize("unit", [1e-6, 3e4])
def test_another_unit_of_light_is_the_same_picture(clean, grid, unit):
    """Nothing is held against a brightness that somebody had in mind."""
    one = in_noise(clean, 0.02)
    found = reconstruct(one, grid)
    other = reconstruct(LightField(one.views * np.float32(unit)), grid)
    assert other.strength == found.strength
    assert other.noise == pytest.approx(unit * found.noise, rel=1e-4)
    peak = found.emission.max()
    np.testing.assert_allclose(other.emission / unit, found.emission, atol=2e-3 * peak)


@pytest.mark.parametrize("offset", [-0.02, 0.02])
def test_a_black_level_that_is_wrong_is_said(clean, grid, offset):
    """Negative, too, where a dark image took too much off."""
    wrong = LightField(in_noise(clean, 0.01).views + np.float32(offset * clean.max()))
    assert any("background" in warning for warning in reconstruct(wrong, grid).warnings)
    assert not reconstruct(in_noise(clean, 0.01), grid).warnings


def test_an_opaque_burner_is_noticed(flames, camera, grid, clean):
    """Light that is hidden from some views is no sum of planes; fitted all the same it misleads."""
    burner = Layer(np.zeros((4, 4)), -8.0, (2.0, 4.0), (2.2, -0.6), opaque=True)
    hidden = render(Scene([*flames.layers, burner]), camera).views
    assert np.abs(hidden - clean).max() > 0.3 * clean.max()
    noise = 0.01 * float(clean.max())
    found = reconstruct(in_noise(hidden, 0.01), grid, noise=noise)
    assert found.warnings
    assert not reconstruct(in_noise(clean, 0.01), grid, noise=noise).warnings


def test_nine_views_are_enough_for_three_planes_that_are_known(flames):
    camera = camera_of(views=3)
    grid = FrustumGrid(camera, DEPTHS_MM)
    truth = np.array([grid.crop(grid.average(one, k)) for k, one in enumerate(flames.layers)])
    few = in_noise(render(flames, camera).views, 0.01)
    assert worst(reconstruct(few, grid).emission, truth) < 0.15
    assert worst(shift_and_sum(few, grid.slopes), truth) > 0.5


def test_a_plane_where_nothing_glows_stays_dark(clean, camera, truth):
    """It would take its share of the smooth light, as refocused images and linear fits let it."""
    grid = FrustumGrid(camera, (*DEPTHS_MM, -8.0))
    noisy = in_noise(clean, 0.02)
    assert reconstruct(noisy, grid).emission[3].sum() < 0.01 * truth.sum()
    linear = np.clip(reconstruct(noisy, grid, nonnegative=False).emission, 0, None)
    assert linear[3].sum() > 0.1 * truth.sum()


def test_slopes_above_one_lenslet_a_view_are_found(flames):
    """Where shifts go beyond a lenslet, what is sharp is seen by some of the views alone."""
    camera = camera_of()
    depths = (9.0, 0.0, -7.0)
    scene = flames.at_depths(np.array(depths), camera)
    grid = FrustumGrid(camera, depths)
    assert np.abs(grid.slopes).max() > 1.4
    truth = np.array([grid.crop(grid.average(one, k)) for k, one in enumerate(scene.layers)])
    noisy = in_noise(render(scene, camera).views, 0.01)
    assert worst(reconstruct(noisy, grid).emission, truth) < 0.03
    assert worst(shift_and_sum(noisy, grid.slopes), truth) > 0.5
