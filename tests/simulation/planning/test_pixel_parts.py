"""Into how many parts pixels are cut for lenslet diffraction."""

from dataclasses import replace

import numpy as np
import pytest

from lf_flame import PAPER_CAMERA, InputError, Layer, Scene, render
from lf_flame.simulation.exact import integrate
from lf_flame.simulation.layouts import blank_image
from lf_flame.simulation.optical_pass import OpticalPass
from lf_flame.simulation.planning import pixel_parts
from lf_flame.simulation.planning.decisions import plan_effects
from lf_flame.simulation.planning.pixel_parts import count_pixel_parts
from lf_flame.simulation.rendering import render_plan
from lf_flame.simulation.slabs import slice_scene

CAMERA = replace(PAPER_CAMERA, views=4, lenslets=(40, 30), wavelength_nm=900.0)
ONLY = {"main_lens_diffraction": False, "lenslet_diffraction": True}


def noise(rng, depth=6.0, **place):
    return Layer(rng.random((50, 40)), depth, (2.0, 1.6), **place)


def planes_of(*layers):
    return slice_scene(Scene(list(layers)), {}, absorption=False, dimming=set())


def sharp(planes, camera, _parts=1):
    image = blank_image(camera, "views")
    integrate(planes, OpticalPass(camera), "views", image)
    return image


def test_a_window_shows_a_part_of_the_image(rng):
    """Each window, of planes moved aside, against lenslets cut out of the whole image."""
    planes = planes_of(noise(rng, centre_mm=(1.0, -0.7)), noise(rng, 30.0), noise(rng, -25.0))
    whole = sharp(planes, CAMERA)
    windows = list(pixel_parts._windows(planes, CAMERA))
    size = pixel_parts.WINDOW
    corners = pixel_parts._corners(planes, CAMERA, (size, size))
    assert len(windows) == len(corners) > pixel_parts.GRID**2
    assert {(0, 0), (32, 22)} <= corners
    small = replace(CAMERA, lenslets=(2 * size, 2 * size))
    assert list(pixel_parts._windows(planes, small)) == [(planes, small)]
    for (seen, window), (row, column) in zip(windows, corners, strict=True):
        found = sharp(seen, window)
        expected = whole[:, :, row : row + size, column : column + size]
        np.testing.assert_allclose(found, expected, atol=2e-6)


def test_windows_stand_where_something_is(rng):
    """One small bright layer, on a field on which nine windows all miss it."""
    camera = replace(CAMERA, lenslets=(120, 90))
    spot = Layer(np.ones((1, 1)), 6.0, (0.3, 0.3), (2.2, 1.3))
    images = [sharp(*window) for window in pixel_parts._windows(planes_of(spot), camera)]
    assert max(image.max() for image in images) == pytest.approx(
        sharp(planes_of(spot), camera).max()
    )


@pytest.mark.parametrize("column", [0, -1])
def test_windows_stand_where_the_steepest_step_is(column):
    """It is far from the brightest cell, and nine windows all over the field miss it."""
    camera = replace(CAMERA, lenslets=(120, 90))
    rise = 1 - np.abs(np.linspace(-1, 1, 41))
    cells = np.outer(rise, rise)
    cells[10:20, column] = np.linspace(0.3, 0.03, 10)
    planes = planes_of(Layer(cells, 0.0, (8.0, 3.0)))
    steps = [
        np.abs(np.diff(image, axis=2)).max()
        for image in (
            *(sharp(*window) for window in pixel_parts._windows(planes, camera)),
            sharp(planes, camera),
        )
    ]
    assert max(steps[:-1]) == pytest.approx(steps[-1], rel=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("pixel", [1.0, 0.8])
@pytest.mark.parametrize("tolerance", [1e-2, 2e-3])
def test_the_image_is_as_good_as_the_tolerance_asks(rng, pixel, tolerance, monkeypatch):
    """Against pixels in 32 x 32 parts, whose own error is far smaller."""
    camera = replace(CAMERA, lenslets=(12, 13), pixel_pitch_mm=pixel * CAMERA.pixel_mm)
    scene, used = Scene([noise(rng)]), []
    plan = plan_effects(scene, camera, tolerance, ONLY)

    def counted(*asked):
        used.append(count_pixel_parts(*asked))
        return used[-1]

    monkeypatch.setattr("lf_flame.simulation.rendering.count_pixel_parts", counted)
    found = render_plan(scene, camera, plan).views.astype(float)
    monkeypatch.setattr("lf_flame.simulation.rendering.count_pixel_parts", lambda *_: 32)
    fine = render_plan(scene, camera, plan).views.astype(float)
    assert used[0] <= 16
    assert np.sqrt(np.mean((found - fine) ** 2)) < tolerance * fine.max()


def test_smooth_light_takes_fewer_parts_than_rough(rng, monkeypatch):
    smooth = Layer(np.outer(*[np.hanning(40)] * 2), 6.0, (2.0, 1.6))
    counts = []
    for layer in (smooth, noise(rng)):

        def counted(*asked):
            counts.append(count_pixel_parts(*asked))
            return counts[-1]

        monkeypatch.setattr("lf_flame.simulation.rendering.count_pixel_parts", counted)
        render(Scene([layer]), replace(CAMERA, lenslets=(12, 13)), 2e-3, effects=ONLY)
    assert counts[0] < counts[1]


def test_an_image_that_does_not_settle_is_refused(rng):
    def restless(planes, camera, parts):
        return np.full((2, 2), 1 + 0.1 * (-1) ** parts.bit_length())

    with pytest.raises(InputError, match="more than 32 x 32 parts of each pixel"):
        count_pixel_parts(planes_of(noise(rng)), CAMERA, 1e-3, restless)
    dark = planes_of(Layer(np.zeros((1, 1)), 6.0, (1.0, 1.0)))
    assert count_pixel_parts(dark, CAMERA, 1e-3, lambda *_: np.zeros((2, 2))) == 1


def test_parts_are_the_fewest_whose_error_is_small_enough():
    """Of an image whose error is 0.4 over the parts, or over their square."""
    for power, allowance, expected in ((1, 0.06, 8), (1, 0.21, 2), (1, 0.11, 4), (2, 0.04, 4)):

        def image(planes, camera, parts, power=power):
            found = np.full(1000, 0.4 / parts**power)
            found[0] = 1.0
            return found

        found = count_pixel_parts([], replace(CAMERA, lenslets=(4, 4)), allowance, image)
        assert found == expected
        assert 0.4 / found**power <= allowance * 1.01
