from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from experiments.effects.tracer import flat_views
from lf_flame import (
    PAPER_CAMERA,
    InputError,
    Layer,
    Scene,
    render,
)
from lf_flame.optics.ray_bundle import trace_footprint, trapezoid_cdf
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


@given(
    depths=st.tuples(st.floats(-25, 0), st.floats(5, 30)),
    hidden=st.booleans(),
    tolerance=st.sampled_from([0.05, 0.02, 0.01]),
    seed=st.integers(0, 2**32 - 1),
)
@settings(max_examples=15, deadline=None)
def test_the_tolerance_is_met_on_random_scenes(depths, hidden, tolerance, seed):
    """Against the closed form in float64, which knows one opaque layer in front of another."""
    rng = np.random.default_rng(seed)
    card = Layer(0.2 * rng.uniform(size=(2, 3)), depths[0], (1.0, 1.2), (0.2, 0.1), opaque=hidden)
    scene = Scene([random_layer(rng, depths[1]), card])
    camera = replace(PAPER_CAMERA, views=3, lenslets=(12, 14))
    integrator = "auto" if hidden else "rays"
    image = render(scene, camera, tolerance, integrator).views
    truth = flat_views(scene, camera)
    assert np.sqrt(np.mean((image - truth) ** 2)) <= tolerance * truth.max()


def test_a_uniform_field_gives_its_brightness_everywhere(small_camera):
    wide = Scene([Layer([[0.7]], 15.0, (80.0, 80.0))])
    for options in ({}, {"integrator": "rays", "rays": 3}):
        np.testing.assert_allclose(render(wide, small_camera, **options).views, 0.7, rtol=1e-7)


def test_sinusoid_has_the_closed_form_of_its_trapezoid(small_camera):
    """The mean of sin(k x) over both boxes is damped by a sinc for each; cells far finer."""
    depth, k, cells = 12.0, 2 * np.pi / 1.5, 240_000
    edges = np.linspace(-15, 15, cells + 1)
    means = 1 + -np.diff(np.cos(k * edges)) / (k * np.diff(edges))
    views = render(Scene([Layer(means[None], depth, (80.0, 30.0))]), small_camera).views
    columns = trace_footprint(small_camera, depth, axis=1)
    damping = np.sinc(k * columns.lenslet_width_mm / (2 * np.pi))
    damping *= np.sinc(k * columns.pixel_width_mm / (2 * np.pi))
    expected = 1 + damping * np.sin(k * columns.centres_mm)
    np.testing.assert_allclose(views[1, :, 5, :], expected, rtol=2e-7)


def disc_area(left, right, top, bottom, radius):
    """Area of a disc about the origin inside a rectangle."""

    def chord(x):
        half = np.sqrt(max(radius**2 - x * x, 0.0))
        return max(min(bottom, half) - max(top, -half), 0.0)

    corners = [np.sqrt(radius**2 - y * y) for y in (top, bottom) if abs(y) < radius]
    kinks = [-radius, radius, *corners, *(-x for x in corners)]
    ends = np.unique(np.clip([left, right, *kinks], left, right))
    return sum(quad(chord, a, b)[0] for a, b in pairwise(ends))


def test_disc_in_focus_has_the_area_that_each_lenslet_sees(small_camera):
    """Cells of a third of a lenslet's image, so that lenslet edges are cell edges."""
    rows, columns = (trace_footprint(small_camera, 0.0, axis) for axis in (0, 1))
    side, radius = abs(rows.lenslet_width_mm), 0.7
    edges = (np.arange(37) - 18) * side / 3
    cells = [
        [disc_area(*x, *y, radius) / (side / 3) ** 2 for x in pairwise(edges)]
        for y in pairwise(edges)
    ]
    layer = Layer(np.clip(cells, 0, None), 0.0, (12 * side, 12 * side))
    image = render(Scene([layer]), small_camera).views[1, 3]
    for t in range(8, 16):
        for s in range(11, 19):
            x, y = columns.centres_mm[2, s], rows.centres_mm[2, t]
            half = side / 2
            expected = disc_area(x - half, x + half, y - half, y + half, radius) / side**2
            assert image[t, s] == pytest.approx(expected, rel=2e-7, abs=1e-9)


def test_trapezoid_is_the_integral_of_two_boxes():
    x = np.linspace(-2, 2, 2001)
    for a, b in [(1.0, 0.4), (0.4, 1.0), (0.5, 0.5), (1.0, 0.0), (0.0, 1.0)]:
        grid = (np.arange(1000) + 0.5) / 1000 - 0.5
        sums = np.sort(np.add.outer(a * grid, b * grid).ravel())
        counted = np.searchsorted(sums, x) / sums.size
        np.testing.assert_allclose(trapezoid_cdf(x, a, b), counted, atol=1.5e-3)
    np.testing.assert_array_equal(trapezoid_cdf(np.array([-1.0, 0.0, 2.0]), 0, 0), [0, 0.5, 1])


def test_two_images_that_agree_by_chance_do_not_do():
    """The first two counts never decide; later ones do by a quarter of their change."""
    level = {1: 1.0, 2: 1.0, 4: 1.2, 8: 1.205, 16: 1.2051, 32: 1.2051}
    tried = []

    def image(count):
        tried.append(count)
        return np.full((2, 3), level[count], np.float32)

    assert refine(image, 1, 32, 0.02, "parts") == 2  # by the first two alone
    assert refine(image, 2, 32, 0.02, "parts") == 4
    assert refine(image, 2, 32, 0.01, "parts") == 8
    with pytest.raises(InputError, match="the number of parts would exceed 4"):
        refine(image, 2, 4, 0.02, "parts")


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
