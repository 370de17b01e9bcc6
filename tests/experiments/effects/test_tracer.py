"""The reference tracer itself: where its answer is known, and where its two methods must agree."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad

from experiments.effects.tracer import _sinc2_quantile, _thrown_on_array, flat_views, trace_pixels
from lf_flame import InputError, Layer, Scene

PIXELS = [(0, 4, 8, 14), (2, 2, 12, 12), (4, 1, 14, 16), (4, 4, 0, 29), (0, 0, 11, 13)]
SIDE = 0.112 * 326 / (150 * 326 / 176)
"""Side of the square of the focal plane that a lenslet sees: its pitch times a0 / i0."""


@pytest.mark.parametrize("skew", [{}, {"lenslet_rotation_rad": 0.02, "lenslet_pitch_error": -0.03}])
def test_a_white_field_is_white(small_camera, skew):
    white = Scene([Layer([[0.7]], 5.0, (40.0, 40.0))])
    mean, _ = trace_pixels(white, replace(small_camera, **skew), PIXELS, rays=256)
    np.testing.assert_allclose(mean, 0.7, rtol=1e-12)
    np.testing.assert_allclose(flat_views(white, small_camera), 0.7, rtol=1e-12)


def test_a_lenslet_sees_its_own_place_of_the_focal_plane_upright(small_camera):
    cells = np.zeros((24, 30))
    cells[20, 4] = 1.0
    scene = Scene([Layer(cells, 0.0, (24 * SIDE, 30 * SIDE))])
    pixels = [(v, u, *place) for v, u in ((0, 4), (2, 1)) for place in ((20, 4), (19, 4), (20, 5))]
    mean, _ = trace_pixels(scene, small_camera, pixels, rays=256)
    np.testing.assert_allclose(mean, [1, 0, 0, 1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(flat_views(scene, small_camera)[:, :, 20, 4], 1, atol=1e-12)


@pytest.mark.parametrize(("near", "far"), [(-10.0, 20.0), (0.0, 10.0), (-20.0, 0.0)])
def test_random_rays_meet_the_image_that_is_multiplied_out(small_camera, rng, near, far):
    glow = Layer(rng.random((7, 5)), far, (2.4, 2.0), (0.3, -0.2))
    texture, coverage = 0.1 * rng.random((6, 8)), rng.random((6, 8))
    card = Layer(texture, near, (1.4, 1.8), (-0.1, 0.2), opaque=True, coverage=coverage)
    views = flat_views(Scene([glow, card]), small_camera)
    lit = rng.permutation(np.argwhere(views > 0.1))[:15]
    mean, error = trace_pixels(Scene([glow, card]), small_camera, lit, rays=2**10)
    assert np.all(np.abs(mean - views[tuple(lit.T)]) < 5 * error + 1e-12)
    assert error.max() < 4e-3
    assert np.abs(views - flat_views(Scene([glow]), small_camera)).max() > 0.1


def test_the_stated_error_covers_the_true_one(small_camera):
    """A half plane in focus: the share of a lenslet's image that it covers."""
    scene = Scene([Layer([[1.0]], 0.0, (40.0, 40.0), (0.0, 0.3 * SIDE - 20.0))])
    mean, error = trace_pixels(scene, small_camera, [(1, 3, 5, 15), (4, 0, 9, 15)], rays=1024)
    assert np.all(np.abs(mean - 0.3) <= 5 * error)
    assert error.max() < 1e-3


@pytest.mark.slow
def test_bodies_in_one_another_obey_the_equation_of_transfer(small_camera):
    """Even emission and absorption, b (1 - exp(-tau)) / tau, behind a veil and before a ground."""
    size, b, tau = (40.0, 40.0), (0.7, 0.2), (1.3, 0.4)
    bodies = [
        Layer([[x]], 5.0, size, optical_thickness=t, thickness_mm=8.0)
        for x, t in zip(b, tau, strict=True)
    ]
    veil = Layer([[0.1]], -2.0, size, opaque=True, coverage=[[0.25]])
    ground = Layer([[0.5]], 20.0, size)
    mean, _ = trace_pixels(Scene([ground, *bodies, veil]), small_camera, PIXELS, rays=64)
    passed = np.exp(-sum(tau))
    expected = 0.1 + 0.75 * (sum(b) * (1 - passed) / sum(tau) + 0.5 * passed)
    np.testing.assert_allclose(mean, expected, rtol=3e-3)


def test_diffraction_is_drawn_from_its_patterns(small_camera):
    """Shares of light: sinc^2 by quadrature, Airy inside its first two dark rings."""
    numbers = (np.arange(200_000) + 0.5) / 200_000
    places, lens = _sinc2_quantile(numbers), replace(small_camera, wavelength_nm=550.0)
    thrown = _thrown_on_array(replace(lens, aperture_diameter_mm=40.0), np.tile(numbers, (2, 1)).T)
    radii = np.hypot(*thrown.T) * 40.0 / (550e-6 * lens.image_distance_mm)
    for width in (0.3, 1.0, 2.7):
        share, _ = quad(lambda x: np.sinc(x) ** 2, -width, width)
        assert np.mean(np.abs(places) < width) == pytest.approx(share, abs=2e-5)
    for ring, share in ((1.2197, 0.838), (2.2331, 0.910)):
        assert np.mean(radii < ring) == pytest.approx(share, abs=5e-4)


def test_a_card_over_half_the_field_hides_half_the_light(small_camera):
    """Rows near its edge see it out of focus; by symmetry they lose half of their light, too."""
    glow = Layer(np.ones((1, 1)), 0.0, small_camera.field_mm(0.0))
    np.testing.assert_allclose(flat_views(Scene([glow]), small_camera), 1.0, rtol=1e-9)
    y, x = small_camera.field_mm(-2.0)
    card = Layer([[0.0]], -2.0, (4 * y, 4 * x), (2 * y, 0.0), opaque=True)
    lit = flat_views(Scene([glow, card]), small_camera).mean(axis=(0, 1, 3))
    np.testing.assert_allclose((lit[0], lit[-1]), (1.0, 0.0), atol=1e-9)
    np.testing.assert_allclose(lit + lit[::-1], 1.0, atol=1e-9)


def test_scenes_that_cannot_be_multiplied_out_are_refused(small_camera):
    card, glow = Layer([[0.0]], 0.0, (1, 1), opaque=True), Layer([[1.0]], 9.0, (1, 1))
    for layers, words in (
        ([replace(glow, thickness_mm=1.0)], "flat and do not absorb"),
        ([card, replace(card, depth_mm=5.0), glow], "one card before a glow, got 2"),
    ):
        with pytest.raises(InputError, match=words):
            flat_views(Scene(layers), small_camera)
