"""The reference tracer itself: where its answer is known, and what it says of its own error."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad

from experiments.effects.ray_tracer import (
    _airy_quantile,
    _radiance,
    _sinc2_quantile,
    draw_pixels,
    trace_pixels,
)
from lf_flame import PAPER_CAMERA, Layer, Scene

WHITE = Scene([Layer([[0.7]], 5.0, (40.0, 40.0))])
SKEWED = {"lenslet_rotation_rad": 0.02, "lenslet_pitch_error": -0.03}


@pytest.fixture
def textured(rng):
    return Scene([Layer(rng.uniform(size=(8, 9)), 12.0, (2.4, 3.0), (0.1, -0.1))])


@pytest.mark.parametrize("skew", [{}, SKEWED])
def test_a_white_field_is_white(small_camera, skew):
    camera = replace(small_camera, **skew)
    found = trace_pixels(WHITE, camera, draw_pixels(camera, 12, 1), rays=256)
    np.testing.assert_allclose(found.mean, 0.7, rtol=1e-12)


def test_a_lenslet_sees_its_own_place_of_the_focal_plane_upright(small_camera):
    """In focus a lenslet images to a square of its pitch times a0 / i0, in every view."""
    cells = np.zeros((24, 30))
    cells[20, 4] = 1.0
    side = 0.112 * 326 / (150 * 326 / 176)
    scene = Scene([Layer(cells, 0.0, (24 * side, 30 * side))])
    pixels = [(v, u, *place) for v, u in ((0, 4), (2, 1)) for place in ((20, 4), (19, 4), (20, 5))]
    found = trace_pixels(scene, small_camera, pixels, rays=256)
    np.testing.assert_allclose(found.mean, [1, 0, 0, 1, 0, 0], atol=1e-12)


@pytest.mark.slow
def test_thick_bodies_in_one_another_obey_the_equation_of_transfer(small_camera, rng):
    """Against a march of small steps along single rays."""
    bodies = [
        Layer(rng.uniform(size=(5, 4)), depth, (1.5, 1.6), (0.1, 0.0),
              optical_thickness=rng.uniform(0, 2, (5, 4)), thickness_mm=thick)
        for depth, thick in ((3.0, 40.0), (12.0, 30.0))
    ]  # fmt: skip
    sheet = Layer([[0.5, 1.0]], 7.0, (1.0, 1.2), opaque=True, coverage=[[0.25, 0.0]])
    scene = Scene([*bodies, sheet])
    on_main_lens = rng.uniform(-20, 20, (30, 2))
    tilt = (on_main_lens - rng.uniform(-0.6, 0.6, (30, 2))) / 330
    found = _radiance(scene, 326.0, on_main_lens, tilt)

    step = 8e-3
    light, clear = np.zeros(30), np.ones(30)
    for depth in np.arange(-17.0, 27.0, step) + step / 2:
        place = on_main_lens - (326.0 + depth) * tilt
        for body in bodies:
            if abs(depth - body.depth_mm) < body.thickness_mm / 2:
                emission, tau = looked_up(body, place)
                share = step / body.thickness_mm
                light += clear * emission * share
                clear *= np.exp(-tau * share)
        if abs(depth - 7.0 - step / 2) < step / 4:
            place = on_main_lens - 333.0 * tilt
            right = np.floor((place[:, 1] / 1.2 + 0.5) * 2)
            hit = (np.abs(place[:, 0]) < 0.5) & (right >= 0) & (right < 2)
            light += clear * hit * np.where(right == 0, 0.5, 1.0)
            clear *= 1 - 0.25 * (hit & (right == 0))
    np.testing.assert_allclose(found, light, atol=1e-3)


def looked_up(body, place):
    """Texture and optical thickness at each place, one by one."""
    found = np.zeros((2, len(place)))
    for k, (y, x) in enumerate(place):
        row = (y - body.centre_mm[0] + 0.75) / 1.5 * 5
        column = (x - body.centre_mm[1] + 0.8) / 1.6 * 4
        if 0 <= row < 5 and 0 <= column < 4:
            cell = int(row), int(column)
            found[:, k] = body.texture[cell], body.optical_thickness[cell]
    return found


@pytest.mark.slow
def test_the_stated_error_is_that_of_another_seed(small_camera, textured):
    camera = replace(small_camera, aperture_diameter_mm=80.0)
    pixels = draw_pixels(camera, 40, 4)
    one, other = (trace_pixels(textured, camera, pixels, rays=512, seed=s) for s in (1, 2))
    apart = np.abs(one.mean - other.mean)
    said = np.hypot(one.error, other.error)
    assert np.all(apart <= 6 * said + 1e-6)
    lit = apart > 0
    assert lit.sum() > 15
    assert np.median(apart[lit] / said[lit]) == pytest.approx(0.7, abs=0.5)


def test_the_stated_error_covers_the_true_one(small_camera):
    """A half plane in focus: the share of a lenslet's image that it covers."""
    pitch = 0.112 * 326 / (150 * 326 / 176)
    edge = (15 - 15 + 0.3) * pitch  # lenslet 15 of 30 spans 0 to 1 pitch
    scene = Scene([Layer([[1.0]], 0.0, (40.0, 40.0), (0.0, edge - 20.0))])
    found = trace_pixels(scene, small_camera, [(1, 3, 5, 15), (4, 0, 9, 15)], rays=1024)
    assert np.all(np.abs(found.mean - 0.3) <= 5 * found.error)
    assert found.error.max() < 1e-3


def test_diffraction_is_drawn_from_its_patterns():
    """Shares of light: sinc^2 by quadrature, Airy inside its first two dark rings."""
    numbers = (np.arange(200_000) + 0.5) / 200_000
    places = _sinc2_quantile(numbers)
    for width in (0.3, 1.0, 2.7):
        share, _ = quad(lambda x: np.sinc(x) ** 2, -width, width)
        assert np.mean(np.abs(places) < width) == pytest.approx(share, abs=2e-5)
    radii = _airy_quantile(numbers)
    assert np.mean(radii < 1.2197) == pytest.approx(0.838, abs=5e-4)
    assert np.mean(radii < 2.2331) == pytest.approx(0.910, abs=5e-4)


def test_pixels_are_drawn_from_the_whole_image_and_from_corners():
    camera = replace(PAPER_CAMERA, views=5, lenslets=(3, 4))
    pixels = draw_pixels(camera, 600, 0)
    assert pixels.min(axis=0).tolist() == [0, 0, 0, 0]
    assert pixels.max(axis=0).tolist() == [4, 4, 2, 3]
    assert np.isin(pixels[:200, :2], (0, 4)).all()
