from dataclasses import replace

import numpy as np
import pytest

from experiments.effects.tracer import flat_views
from lf_flame import PAPER_CAMERA, InputError, Layer, Scene, render
from lf_flame.optics.ray_bundle import trace_footprint
from lf_flame.simulation.planning.chosen_pixels import refine


def random_layer(rng, depth, cells=(7, 5)):
    return Layer(rng.uniform(size=cells), depth, (2.4, 2.0), (0.3, -0.2))


@pytest.mark.parametrize("depth", [20.0, 10.0, 0.0, -10.0])
def test_both_integrators_equal_the_reference(small_camera, rng, depth):
    """A lenslet pitch wrong by 1 % changes some of these pixels by 0.008 to 0.09."""
    layer = random_layer(rng, depth)
    truth = flat_views(Scene([layer]), small_camera)
    exact = render(Scene([layer]), small_camera, effects={"defocus": True}).views
    np.testing.assert_allclose(exact, truth, rtol=3e-7, atol=1e-9)
    rays = render(Scene([layer]), small_camera, integrator="rays", rays=89).views
    np.testing.assert_allclose(rays, truth, atol=3e-4 if depth else 6e-3)


@pytest.mark.parametrize("seed", [1, 2, 4, 5, 19, 47])
def test_the_tolerance_is_met_on_random_scenes(seed):
    """Against the closed form in float64, which knows one opaque layer in front of another.

    Of such a layer's edge, 4 and 8 rays see the same: two equal images are no evidence.
    """
    rng, hidden = np.random.default_rng(seed), seed % 2 == 1
    tolerance = (0.05, 0.02, 0.01)[seed % 3]
    near, far = rng.uniform(-25, 0), rng.uniform(5, 30)
    card = Layer(0.2 * rng.uniform(size=(2, 3)), near, (1.0, 1.2), (0.2, 0.1), opaque=hidden)
    scene = Scene([random_layer(rng, far), card])
    camera = replace(PAPER_CAMERA, views=3, lenslets=(12, 14))
    integrator = "auto" if hidden else "rays"
    image = render(scene, camera, tolerance, integrator).views
    truth = flat_views(scene, camera)
    error = np.sqrt(np.mean((image - truth) ** 2)) / truth.max()
    assert error <= tolerance


def test_a_uniform_field_gives_its_brightness_everywhere(small_camera):
    wide = Scene([Layer([[0.7]], 15.0, (80.0, 80.0))])
    for options in ({}, {"integrator": "rays", "rays": 3}):
        np.testing.assert_allclose(render(wide, small_camera, **options).views, 0.7, rtol=1e-7)


LEVELS = {1: 1.0, 2: 1.0, 4: 1.2, 8: 1.205, 16: 1.2051}
FALLING = {n: 1 + n**-2 for n in (1, 2, 4, 8, 16)}


@pytest.mark.parametrize(
    ("levels", "first", "allowance", "fewest", "count", "last"),
    [
        (LEVELS, 1, 0.02, 2, 2, 2),  # the first two agree by chance
        (LEVELS, 1, 0.02, 3, 4, 8),
        (LEVELS, 2, 0.02, 3, 4, 8),
        (LEVELS, 2, 0.01, 3, 8, 8),
        (FALLING, 1, 0.07, 3, 8, 4),  # images change by 0.60, 0.18, 0.05 and 0.01
        (FALLING, 1, 0.03, 3, 16, 4),
    ],
)
def test_a_number_is_doubled_until_images_agree(levels, first, allowance, fewest, count, last):
    """The last images, with twice and four times the number, need not be rendered."""
    tried = []

    def image(count):
        tried.append(count)
        return np.full((2, 3), levels[count], np.float32)

    assert refine("slabs", image, first, allowance, fewest=fewest) == count
    assert tried[-1] == last


def test_a_number_that_is_never_enough_is_refused():
    with pytest.raises(InputError, match="the number of colours would exceed 1024"):
        refine("colours", lambda count: np.full(1, float(count)), 1, 0.02)


@pytest.mark.parametrize("axis", [0, 1])
def test_the_field_ends_where_no_bundle_reaches_on_every_side(small_camera, axis):
    """The outermost lenslet's rays from the edge of the outermost pixel, traced backward."""
    depth, size = 15.0, 0.2
    footprint = trace_footprint(small_camera, depth, axis)
    reach = np.abs(footprint.centres_mm).max() + footprint.half_width_mm + size / 2
    for place, seen in ((0.999 * reach, True), (1.001 * reach, False)):
        for sign in (1, -1):
            centre = (sign * place, 0.0) if axis == 0 else (0.0, sign * place)
            scene = Scene([Layer([[1.0]], depth, (size, size), centre)])
            if seen:
                assert render(scene, small_camera, 0.05).views.max() > 0
            else:
                with pytest.raises(InputError, match="outside the field"):
                    render(scene, small_camera, 0.05)
