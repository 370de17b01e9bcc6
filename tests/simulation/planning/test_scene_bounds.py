"""Bounds that are found before rendering, against rendered images."""

from dataclasses import replace

import numpy as np
import pytest

from lf_flame import Layer, Scene, plan_effects, render
from lf_flame.optics.ray_bundle import trace_stop
from lf_flame.simulation.bundle_limits import (
    crosstalk,
    misplaced_mm,
    neighbours,
    pitch_shifts_mm,
    rotation_shifts_mm,
    round_stops,
    share_crossing,
    share_cut,
    true_pitch_mm,
)
from lf_flame.simulation.planning.scene_bounds import bound_scene


def glow(rng, depth=10.0, **matter):
    return Layer(rng.uniform(0.2, 1.0, (8, 9)), depth, (1.6, 1.8), (0.05, -0.1), **matter)


def card(depth=-10.0):
    return Layer([[0.3]], depth, (0.8, 0.9), opaque=True)


def test_the_brightest_pixel_lies_between_its_bounds(small_camera, rng):
    for layers in ([glow(rng)], [glow(rng), card()], [glow(rng, optical_thickness=0.5)]):
        bounds = bound_scene(Scene(layers), small_camera)
        brightest = render(Scene(layers), small_camera, tolerance=0.02).views.max()
        assert 0 < bounds.peak <= brightest * 1.02
        assert brightest <= bounds.radiance
        assert bounds.relative(bounds.peak) == 1
        assert bounds.relative(0.0) == 0


def test_only_matter_has_light_behind_it(small_camera, rng):
    far, front = glow(rng, 20.0), card()
    bounds = bound_scene(Scene([far, front]), small_camera)
    assert bounds.behind == {front: far.texture.max(), far: 0.0}
    aside = replace(front, centre_mm=(0.6, 2.6), size_mm=(0.05, 0.05))
    assert bound_scene(Scene([glow(rng, 0.0), aside]), small_camera).behind[aside] == 0
    steps = bounds.steps[front, 0]
    assert steps.whole == pytest.approx(0.3 + far.texture.max())


def test_stops_and_misplaced_lenslets_of_an_ideal_camera(small_camera):
    assert round_stops(small_camera) == []
    assert neighbours(small_camera) == 0
    assert misplaced_mm(small_camera) == (0, 0)
    wide = replace(small_camera, aperture_diameter_mm=90.0, rim_diameter_mm=80.0,
                   rim_distance_mm=40.0, lenslet_rotation_rad=0.01,
                   lenslet_pitch_error=0.01)  # fmt: skip
    assert round_stops(wide) == [(0.0, 45.0), (40.0, 40.0)]
    assert neighbours(wide) == 1
    together = np.add(rotation_shifts_mm(wide), pitch_shifts_mm(wide))
    np.testing.assert_array_equal(misplaced_mm(wide), together)
    assert share_cut(wide, 0.0, 1e3) == 0
    assert 0 < share_cut(wide, 0.0, 40.0) <= share_cut(wide, 0.0, 20.0) <= 1


@pytest.mark.parametrize("angle", [-0.05, 0.003, 0.1])
def test_a_turned_array_moves_its_corners(small_camera, angle):
    height, width = (0.112 * n / 2 for n in small_camera.lenslets)
    corners = np.array([width + 1j * height, width - 1j * height])
    moved = corners * np.exp(1j * angle) - corners
    found = rotation_shifts_mm(replace(small_camera, lenslet_rotation_rad=angle))
    expected = np.abs(moved.imag).max(), np.abs(moved.real).max()
    np.testing.assert_allclose(found, expected, rtol=1e-12)


@pytest.mark.parametrize("distance_mm", [0.0, 40.0])
def test_a_stop_that_the_worst_bundle_just_passes_cuts_nothing(small_camera, distance_mm):
    footprints = [trace_stop(small_camera, distance_mm, axis) for axis in (0, 1)]
    farthest = [np.abs(f.centres_mm).max() + f.half_width_mm for f in footprints]
    assert share_cut(small_camera, distance_mm, np.hypot(*farthest)) == 0
    assert share_cut(small_camera, distance_mm, 0.999 * np.hypot(*farthest)) > 0


def test_micro_images_that_move_over_a_pixel(small_camera):
    """An edge inside a pixel is at most two of its sides long; up to four discs meet in it."""
    camera, shift = small_camera, 1e-3
    on_sensor = shift * (1 + camera.lenslet_focal_mm / camera.image_distance_mm)
    for moved, axes in (((shift, 0.0), 1), ((shift, shift), 2)):
        found = share_crossing(camera, 0.0, camera.aperture_mm / 2, moved)
        assert found == pytest.approx(4 * axes * 2 * on_sensor / camera.pixel_mm, rel=1e-12)
    wide = share_crossing(camera, 0.0, 1.1 * camera.aperture_mm, (shift, shift))
    assert wide == pytest.approx(9 / 4 * found, rel=1e-12)


def test_how_far_off_lenslets_light_comes_from(small_camera):
    assert true_pitch_mm(replace(small_camera, lenslet_pitch_error=0.05)) == 0.112 * 1.05
    wide = replace(small_camera, aperture_diameter_mm=2.2 * small_camera.aperture_mm)
    assert neighbours(wide) == 1
    long = replace(wide, lenslets=(8, 200))
    assert neighbours(replace(long, lenslet_rotation_rad=0.05)) == 2
    matched = replace(small_camera, aperture_diameter_mm=small_camera.aperture_mm)
    assert crosstalk(small_camera) == crosstalk(matched) == 0
    # Lenslets that stand closer overlap by the error of their pitch, on four sides of a pixel.
    close = replace(matched, lenslet_pitch_error=-0.01)
    expected = 4 * 0.01 * camera_ratio(close) / 2
    assert crosstalk(close) == pytest.approx(expected, rel=1e-12)


def camera_ratio(camera):
    """Pixels across a matched micro-image."""
    return camera.aperture_mm / camera.view_step_mm


def farthest(holds):
    """Where, from the middle outwards, something holds last."""
    near, far = 0.0, 20.0
    for _ in range(30):
        middle = (near + far) / 2
        near, far = (middle, far) if holds(middle) else (near, middle)
    return near


@pytest.mark.parametrize("axis", [0, 1])
def test_a_card_hides_as_far_out_on_one_side_as_on_the_other(small_camera, axis):
    """The camera is symmetric: bundles reach as far beyond the outermost lenslets everywhere."""

    def hides(sign):
        def holds(place):
            centre = (sign * place, 0.0) if axis == 0 else (0.0, sign * place)
            hiding = Layer([[0.1]], -10.0, (0.5, 0.5), centre, opaque=True)
            scene = Scene([Layer([[1.0]], 15.0, (1.0, 1.0)), hiding])
            return plan_effects(scene, small_camera, 0.05)["occlusion"].bound > 0

        return holds

    assert farthest(hides(1)) == pytest.approx(farthest(hides(-1)), rel=1e-6)
    assert farthest(hides(1)) > 0.5


def test_matter_inside_a_thick_layer_counts_where_it_covers_most(small_camera):
    """A card with a hole stands inside a flame so thin that nothing else changes."""
    flame = Layer(np.ones((1, 1)), 0.0, (1.5, 1.5), thickness_mm=0.01)
    hiding = Layer(np.zeros((1, 2)), 0.0, (0.8, 0.8), opaque=True, coverage=[[1.0, 0.0]])
    scene = Scene([flame, hiding])
    images = [
        render(scene, small_camera, 0.05, effects={"thickness": on}).views.astype(float)
        for on in (False, True)
    ]
    found = np.abs(images[0] - images[1]).max() / max(image.max() for image in images)
    assert found > 0.3
    assert found <= plan_effects(scene, small_camera, 0.05)["thickness"].bound
