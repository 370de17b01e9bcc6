"""Exit pupils, hexagonal arrays and layers that lean, against rays traced by their own geometry."""

from dataclasses import replace

import numpy as np
import pytest

from experiments.effects.tracer import trace_pixels
from lf_flame import PAPER_CAMERA, InputError, Layer, Scene, plan_effects, render
from lf_flame.refocus import shift_and_sum

BASE = replace(PAPER_CAMERA, views=5, lenslets=(12, 15))
MATCHED = BASE.image_distance_mm * 0.112 / 0.4
HEXAGONAL = {"layout": "hexagonal"}


def glow(depth=6.0, **shape):
    texture = np.random.default_rng(5).uniform(0.2, 1.0, (5, 6))
    return Layer(texture, depth, (1.4, 1.7), (0.05, -0.05), **shape)


CARD = Layer([[0.1]], -5.0, (0.6, 0.7), opaque=True)
slow = pytest.mark.slow


@pytest.mark.parametrize(
    ("layers", "changes"),
    [
        ([glow(12.0)], {"exit_pupil_mm": 180.0}),
        ([glow(-12.0)], {"exit_pupil_mm": 900.0}),
        pytest.param(
            [glow()],
            {"exit_pupil_mm": 200.0, "aperture_diameter_mm": 50.0, "falloff_corrected": False},
            marks=slow,
        ),
        ([glow()], HEXAGONAL),
        ([glow(0.0)], HEXAGONAL),
        # The tolerance is that of the root mean square: at the rim of a stop pixels miss it singly.
        pytest.param(
            [glow()], HEXAGONAL | {"exit_pupil_mm": 200.0, "aperture_diameter_mm": 50.0}, marks=slow
        ),
        pytest.param([glow()], HEXAGONAL | {"aperture_diameter_mm": 0.9 * MATCHED}, marks=slow),
        pytest.param([glow(10.0), CARD], HEXAGONAL, marks=slow),
        ([glow(2.0, tilt_deg=(30, 0))], {}),
        ([glow(2.0, tilt_deg=(0, -30))], {}),
        pytest.param([glow(2.0, tilt_deg=(30, 0), thickness_mm=1.5)], {}, marks=slow),
        pytest.param([glow(12.0), replace(CARD, tilt_deg=(30, 0))], {}, marks=slow),
        pytest.param([glow(2.0, tilt_deg=(30, 0), optical_thickness=0.5)], {}, marks=slow),
    ],
)
def test_images_are_those_of_rays(layers, changes):
    camera, scene = replace(BASE, **changes), Scene(layers)
    pixels = np.random.default_rng(1).integers(0, (5, 5, 12, 15), (28, 4))
    traced, error = trace_pixels(scene, camera, pixels, rays=1024)
    last = scene.layers[-1]
    matter = last.thickness_mm or last.optical_thickness.any()
    tolerance = 1e-3 if not last.depth_extent_mm else 1e-2 if matter else 3e-3
    image = render(scene, camera, tolerance).views
    difference, peak = image[tuple(pixels.T)] - traced, float(image.max())
    assert np.ptp(traced) > 0.5 * peak
    noise = np.sqrt(np.mean(error**2))
    assert np.sqrt(np.mean(difference**2)) <= tolerance * peak + 2 * noise
    assert np.all(np.abs(difference) <= 5 * error + 4 * tolerance * peak)


def test_a_flame_that_leans_is_sharp_at_each_height_where_it_is():
    """A slanted row of bright lines: each is sharpest at the slope of its own depth."""
    camera = replace(PAPER_CAMERA, views=9, lenslets=(60, 20))
    lines = np.zeros((41, 1))
    lines[4::16] = 1.0
    scene = Scene([Layer(lines, 0.0, (12.0, 30.0), tilt_deg=(60, 0))])
    views = render(scene, camera, 5e-3).views
    slopes = np.linspace(-1.3, 1.3, 105)
    stack = shift_and_sum(views, slopes)[:, :, 10]
    for row in (4, 20, 36):
        along = ((row + 0.5) / 41 - 0.5) * 12.0
        depth, y = -along * np.sin(np.pi / 3), along * np.cos(np.pi / 3)
        lenslet = y / (camera.field_mm(depth)[0] / 60) + 29.5
        near = slice(max(round(lenslet) - 4, 0), round(lenslet) + 5)
        sharpest = slopes[(stack[:, near] ** 2).sum(axis=1).argmax()]
        assert sharpest == pytest.approx(camera.depth_to_slope(depth), abs=0.12)


@pytest.mark.slow
@pytest.mark.parametrize(
    "changes",
    [
        {"lenslet_rotation_rad": 0.01},
        {"lenslet_pitch_error": 0.01},
        {"wavelength_nm": 2000.0},
        {"aperture_diameter_mm": 1.2 * MATCHED},
    ],
)
def test_light_that_leaves_a_hexagon_is_refused(changes):
    with pytest.raises(InputError, match="not simulated for a hexagonal array: force .* off"):
        render(Scene([glow()]), replace(BASE, **HEXAGONAL, **changes))


WHITE = Scene([Layer([[1.0]], 5.0, (80.0, 80.0))])


@pytest.mark.parametrize("views", [5, 11])
def test_views_that_a_stop_cuts_do_not_count(views):
    """At f/4 before lenslets that see f/3.6: squares that lie in the circle count."""
    camera = replace(PAPER_CAMERA, views=views, lenslets=(24, 30))
    narrow = replace(camera, aperture_diameter_mm=0.9 * camera.aperture_mm)
    light_field = render(WHITE, narrow)
    corner = np.abs(np.arange(views) - (views - 1) / 2) + 0.5
    whole = np.hypot(corner[:, None], corner) / views * (1 + 0.4 / 277.84) <= 0.45
    np.testing.assert_array_equal(light_field.weights, whole)
    np.testing.assert_allclose(shift_and_sum(light_field, [0.3]), 1.0, rtol=1e-5)
    np.testing.assert_allclose(light_field.photograph, 1.0, rtol=1e-5)
    assert render(WHITE, camera).weights is None


def test_views_with_light_of_two_lenslets_do_not_count():
    """Through an aperture a fifth too wide, neighbours light the views at the rim a second time."""
    camera = replace(PAPER_CAMERA, views=11, lenslets=(8, 9))
    wide = replace(camera, aperture_diameter_mm=1.2 * camera.aperture_mm)
    light_field = render(WHITE, wide, 0.01)
    # Square pixels, and circles of the radius of 6.6 pixels that lie 11 apart.
    places = np.arange(11) - 5
    corner = np.abs(places) + 0.5
    gap = np.maximum(np.abs(places[:, None] - 11 * np.arange(-1, 2)) - 0.5, 0)
    circles = (np.hypot(gap[:, None, :, None], gap[:, None]) < 6.6).sum(axis=(2, 3))
    own = (np.hypot(corner[:, None], corner) <= 6.6) & (circles == 1)
    np.testing.assert_array_equal(light_field.weights, own)
    lit_once = np.abs(light_field.views.mean(axis=(2, 3)) - 1) < 1e-3
    np.testing.assert_array_equal(lit_once, own)


def test_noise_sets_the_tolerance_if_none_is_stated():
    """A quarter of the noise: of 900 electrons a thirtieth of the brightest pixel."""
    from lf_flame import Sensor

    camera = replace(BASE, sensor=Sensor(900.0, read_noise_e=0.0))
    scene = Scene([Layer([[1.0]], 0.0, (80.0, 80.0))])
    plan = plan_effects(scene, camera)
    assert plan.tolerance == pytest.approx(1 / 30 / 4, rel=5e-3)
    assert "a quarter of the noise" in str(plan)
    assert plan_effects(scene, camera, 1e-3).tolerance == 1e-3
    quiet = {"shot_noise": False, "read_noise": False}
    assert plan_effects(scene, camera, effects=quiet).tolerance == 1e-3


@pytest.mark.parametrize(
    "changes",
    [{"lenslet_rotation_rad": 1e-9}, {"rim_diameter_mm": 300.0}, {"chromatic_shift": 1e-9}],
    ids=str,
)
def test_causes_without_effect_cost_nothing(changes):
    plan = plan_effects(Scene([glow()]), replace(BASE, **changes))
    assert plan.kept == {"defocus"}
    assert plan.integrator == "exact"


@pytest.mark.slow
def test_an_opaque_card_that_leans_lets_nothing_through():
    card = Layer([[0.0]], 0.0, (16.0, 1.0), opaque=True, tilt_deg=(30, 0))
    scene = Scene([Layer([[1.0]], 40.0, (30.0, 30.0)), card])
    image = render(scene, replace(BASE, lenslets=(13, 13)), 1e-2).views
    assert image[:, :, 4:9, 5:8].mean() < 5e-3
