"""Phantoms hold the emission that they say, and the noise."""

from dataclasses import replace

import numpy as np
import pytest

from experiments.tomography.phantoms import (
    BLOCK,
    Recorder,
    in_even_matter,
    in_own_matter,
    overlapping_flames,
    shrunk,
    thickness_on,
    truth_on,
    two_blobs,
    volume_flame,
)
from experiments.tomography.tasks import relative_errors
from lf_flame import PAPER_CAMERA
from lf_flame.scenes.flames import HOLLOW_AT_BURNER, projected_glow, radius_profile
from lf_flame.tomography import FrustumGrid


@pytest.fixture(scope="module")
def camera():
    return replace(PAPER_CAMERA, views=5, lenslets=(90, 120))


@pytest.mark.slow
def test_a_volume_projects_as_the_closed_form_says():
    """Slabs along the line of sight add up to the Abel transform of the profile."""
    scene = volume_flame(10.0, 2.0, slab_mm=0.1, reach_mm=7.0)
    seen = sum(layer.texture for layer in scene.layers)
    rows, columns = seen.shape
    h = (1 - (np.arange(rows) + 0.5) / rows)[:, None]
    x = ((np.arange(columns) + 0.5) / columns * 2 - 1) * 7.0
    wanted = projected_glow(x, 2.0 * radius_profile(h), HOLLOW_AT_BURNER * (1 - h))
    fine = np.linspace(0, 0.999, 1000)[:, None]
    across = np.linspace(0, 4, 801)
    peak = projected_glow(across, 2.0 * radius_profile(fine), HOLLOW_AT_BURNER * (1 - fine)).max()
    assert seen == pytest.approx(wanted / peak, abs=3e-4)
    assert 0.995 < seen.max() < 1.0005


def test_blobs_stand_apart_and_each_projects_to_a_gaussian():
    scene = two_blobs(0.6, 5.0)
    light = np.array([layer.texture.sum() for layer in scene.layers])
    depths = np.array([layer.depth_mm for layer in scene.layers])
    for sign in (-1, 1):
        one = sign * depths > 0
        middle = light[one] @ depths[one] / light[one].sum()
        assert middle == pytest.approx(2.5 * sign)
        width = np.sqrt(light[one] @ (depths[one] - middle) ** 2 / light[one].sum())
        assert width == pytest.approx(0.6 / np.sqrt(2), rel=0.01)  # exp(-(z / b)^2)
    seen = sum(layer.texture for layer in scene.layers)
    x = np.linspace(-1.5, 1.5, 51)
    assert seen[25] == pytest.approx(2 * np.exp(-((x / 0.6) ** 2)))


def test_truth_stands_in_the_nearest_plane(camera):
    scene = overlapping_flames((4.0, 1.0, -1.5, -4.0))
    grid = FrustumGrid(camera, [4.2, 1.0, -1.0, -4.0], BLOCK)
    planes = truth_on(grid, scene)
    assert planes.shape == (4, 30, 40)
    for plane, layer in enumerate(scene.layers):
        alone = grid.crop(grid.average(layer, plane))
        assert np.array_equal(planes[plane], alone)


def test_matter_adds_up_to_the_thickness_and_leaves_the_emission(camera):
    flames = shrunk(overlapping_flames((16.0, 4.0, -6.0, -16.0), cell_mm=0.4), 0.25)
    assert flames.depths_mm == (4.0, 1.0, -1.5, -4.0)
    grid = FrustumGrid(camera, flames.depths_mm, BLOCK)
    truth = truth_on(grid, flames)
    even = in_even_matter(flames, 0.5, half_mm=10.0)
    assert truth_on(grid, even) == pytest.approx(truth, abs=1e-9)
    assert thickness_on(grid, even) == pytest.approx(0.125)
    own = in_own_matter(flames, 0.5)
    assert truth_on(grid, own) == pytest.approx(truth)
    peaks = [layer.texture.max() for layer in flames.layers]
    wanted = 0.125 * truth / np.reshape(peaks, (4, 1, 1))
    assert thickness_on(grid, own) == pytest.approx(wanted)


def test_noise_is_a_share_of_the_brightest_pixel_after_averaging(camera):
    recorder = Recorder(overlapping_flames((4.0, 1.0, -1.5, -4.0)), camera)
    rng = np.random.default_rng(0)

    def averaged(light_field):
        views = light_field.views.reshape(5, 5, 30, BLOCK, 40, BLOCK)
        return views.mean(axis=(3, 5), dtype=np.float64)

    clean = averaged(recorder.clean)
    assert recorder.peak == pytest.approx(clean.max())
    noise = averaged(recorder.with_noise(0.02, rng)) - clean
    assert noise.std() == pytest.approx(0.02 * clean.max(), rel=0.02)
    bright = clean > 0.5 * clean.max()
    shot = (averaged(recorder.with_electrons(100, rng)) - clean)[bright]
    wanted = np.sqrt(np.mean(clean[bright] * clean.max()) / 100)
    assert shot.std() == pytest.approx(wanted, rel=0.05)


def test_errors_are_relative_to_each_plane():
    truth = np.array([[[3.0, 4.0]], [[0.0, 1.0]]])
    found = np.array([[[3.0, 4.5]], [[0.0, 0.0]]])
    assert relative_errors(found, truth) == pytest.approx([0.1, 1.0])
