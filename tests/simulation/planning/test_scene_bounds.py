"""Bounds that are found before rendering, against rendered images."""

from dataclasses import replace

import numpy as np
import pytest

from lf_flame import PAPER_CAMERA, Layer, Scene, plan_effects, render
from lf_flame.simulation.optical_pass import rotation_shifts_mm
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


SPOT = np.zeros((9, 9))
SPOT[2, 6] = 0.7
"""Dark but for one cell."""


@pytest.mark.parametrize(
    ("layer", "brightest"),
    [
        (Layer([[0.7]], 0.0, (2.0, 2.0), (3.0, 4.0)), 0.7),
        # Matter is as dense in the dark; a cell's own matter lets (1 - exp(-tau)) / tau pass.
        (Layer(SPOT, 0.0, (18.0, 18.0), optical_thickness=0.3), -0.7 * np.expm1(-0.3) / 0.3),
    ],
    ids=["stops darken outer views", "matter everywhere"],
)
def test_the_brightest_pixel_is_found(layer, brightest):
    """A patch in focus, which all views see; a round aperture darkens those in the corners."""
    camera = replace(PAPER_CAMERA, views=11, lenslets=(200, 300))
    camera = replace(camera, aperture_diameter_mm=camera.aperture_mm)
    assert 0.95 * brightest <= bound_scene(Scene([layer]), camera).peak <= brightest


def test_only_matter_has_light_behind_it(small_camera, rng):
    far, front = glow(rng, 20.0), card()
    bounds = bound_scene(Scene([far, front]), small_camera)
    assert bounds.behind == {front: far.texture.max(), far: 0.0}
    aside = replace(front, centre_mm=(0.6, 2.6), size_mm=(0.05, 0.05))
    assert bound_scene(Scene([glow(rng, 0.0), aside]), small_camera).behind[aside] == 0
    # Through a wide aperture, pixels also see steeper rays, through neighbouring lenslets.
    matched = replace(small_camera, lenslets=(4, 120))
    wide = replace(matched, aperture_diameter_mm=2 * matched.aperture_mm)
    lamp = Layer([[1.0]], 10.0, (2.0, 2.0), (0.0, -2.5))
    hiding = Layer([[0.0]], -10.0, (2.0, 2.0), (0.0, 2.5), opaque=True)
    for camera, hidden in ((matched, 0.0), (wide, 1.0)):
        assert bound_scene(Scene([lamp, hiding]), camera).behind[hiding] == hidden
    steps = bounds.steps[front, 0]
    assert steps.whole == pytest.approx(0.3 + far.texture.max())


@pytest.mark.parametrize("angle", [-0.05, 0.003, 0.1])
def test_a_turned_array_moves_its_corners(small_camera, angle):
    height, width = (0.112 * n / 2 for n in small_camera.lenslets)
    corners = np.array([width + 1j * height, width - 1j * height])
    moved = corners * np.exp(1j * angle) - corners
    found = rotation_shifts_mm(replace(small_camera, lenslet_rotation_rad=angle))
    expected = np.abs(moved.imag).max(), np.abs(moved.real).max()
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def farthest(holds):
    """Where, from the middle outwards, something holds last."""
    near, far = 0.0, 2.5
    for _ in range(30):
        middle = (near + far) / 2
        near, far = (middle, far) if holds(middle) else (near, middle)
    return near


@pytest.mark.slow
@pytest.mark.parametrize("axis", [0, 1])
def test_a_card_hides_as_far_out_on_one_side_as_on_the_other(small_camera, axis):
    """The camera is symmetric: bundles reach as far beyond the outermost lenslets everywhere."""

    def hides(sign):
        def holds(place):
            centre = (sign * place, 0.0) if axis == 0 else (0.0, sign * place)
            hiding = Layer([[0.1]], -2.0, (0.5, 0.5), centre, opaque=True)
            scene = Scene([Layer([[1.0]], 2.0, (1.0, 1.0)), hiding])
            return plan_effects(scene, small_camera, 0.05)["occlusion"].bound > 0

        return holds

    assert farthest(hides(1)) == pytest.approx(farthest(hides(-1)), rel=1e-6)
    assert 0.5 < farthest(hides(1)) < 2.4
