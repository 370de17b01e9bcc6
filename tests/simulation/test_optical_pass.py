"""Which lenslet lights which pixel, where on the sensor, and at what angle."""

from dataclasses import replace

import numpy as np
import pytest

from lf_flame import PAPER_CAMERA, Layer, Scene, render
from lf_flame.simulation import rays as rays_module
from lf_flame.simulation.integration import blank_image
from lf_flame.simulation.optical_pass import Lines, OpticalPass
from lf_flame.simulation.rays import ray_grid, trace
from lf_flame.simulation.slabs import slice_scene

WHITE = Scene([Layer([[0.8]], 0.0, (90.0, 90.0))])

MISPLACED = [
    {"lenslet_rotation_rad": -0.05},
    {"lenslet_pitch_error": -0.03},
    {"lenslet_rotation_rad": 0.02, "lenslet_pitch_error": -0.01},
]


@pytest.mark.parametrize("integrator", ["auto", "rays"])
@pytest.mark.parametrize("error", MISPLACED, ids=str)
def test_square_micro_images_keep_a_white_field(small_camera, error, integrator):
    camera = replace(small_camera, **error)
    image = render(WHITE, camera, tolerance=0.01, integrator=integrator)
    assert image.plan.kept & {"lenslet_rotation", "lenslet_pitch_error"}
    np.testing.assert_allclose(image.views, 0.8, rtol=1e-6)


def test_chosen_lines_traced_in_runs_are_those_of_the_whole_image(small_camera, rng, monkeypatch):
    """As where a number of rays is looked for."""
    scene = Scene([Layer(rng.uniform(size=(30, 30)), 5.0, (2.0, 2.0))])
    planes = slice_scene(scene, {}, absorption=False, attenuating=set())
    rows, columns = np.array([3, 40, 77, 100]), np.array([0, 14, 65, 149, 120])
    lines = Lines(rows, columns)
    optics = OpticalPass(small_camera, falloff=True)
    whole, some = blank_image(small_camera, "views"), blank_image(small_camera, lines)
    trace(planes, optics, "views", 2, whole)
    monkeypatch.setattr(rays_module, "CELLS_AT_ONCE", 1)
    trace(planes, optics, lines, 2, some)
    (v, t), (u, s) = np.divmod(rows, 24), np.divmod(columns, 30)
    assert np.ptp(some) > 0.1
    np.testing.assert_array_equal(some[0, 0], whole[v[:, None], u, t[:, None], s])


@pytest.mark.parametrize("rays", [1, 2, 7, 20])
@pytest.mark.parametrize("axis", [0, 1])
def test_boxes_have_the_mean_and_variance_of_the_bundle(small_camera, rays, axis):
    optics = OpticalPass(small_camera)
    layer = Layer([[1.0]], 10.0, (30.0, 30.0))
    grid = ray_grid(slice_scene(Scene([layer]), {}, True, set()), optics, "views", rays, axis)
    bundle, edges = optics.footprint(10.0, axis), grid.planes.edges_mm[0]
    cell_mm = edges[1] - edges[0]
    middles = edges[0] + cell_mm * grid.planes.positions[0]
    assert grid.rays >= rays
    np.testing.assert_allclose(middles.mean(axis=-1), bundle.centres_mm, atol=1e-12)
    found = middles.var(axis=-1) + (grid.planes.boxes[0] * cell_mm) ** 2 / 12
    expected = (bundle.lenslet_width_mm**2 + bundle.pixel_width_mm**2) / 12
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def opened(camera, rays, *stops):
    """Light of every pixel of a white field behind some round stops, (distance, diameter)."""
    planes = slice_scene(WHITE, {}, absorption=False, attenuating=set())
    image = blank_image(camera, "views")
    optics = OpticalPass(camera, stops=tuple((distance, d / 2) for distance, d in stops))
    trace(planes, optics, "views", rays, image)
    return image / 0.8


def test_two_stops_that_cut_one_side_leave_the_smaller_share():
    """Two stops at one place are the narrower one; shares that multiplied would be too dark."""
    camera = replace(PAPER_CAMERA, views=3, lenslets=(8, 9))
    alone, both = opened(camera, 3, (0.0, 60.0)), opened(camera, 3, (0.0, 60.0), (0.0, 60.5))
    assert ((alone > 0.05) & (alone < 0.95)).any()
    np.testing.assert_allclose(both, alone, atol=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize(("distance_mm", "diameter_mm"), [(200.0, 40.0), (500.0, 30.0)])
def test_two_stops_that_cut_opposite_sides_leave_what_is_between(distance_mm, diameter_mm):
    """Lenslets far off the axis look through the top of one stop and the bottom of another.

    Beyond the focal plane the bundle of a pixel is upside down.
    """
    camera = replace(PAPER_CAMERA, views=1, lenslets=(1, 801))
    stops = (0.0, 60.0), (distance_mm, diameter_mm)
    coarse, fine = opened(camera, 10, *stops), opened(camera, 150, *stops)
    assert ((fine > 0.05) & (fine < 0.5)).any()
    np.testing.assert_allclose(coarse, fine, atol=0.0075)


def test_a_rim_at_the_main_lens_that_cuts_nothing_leaves_the_square_aperture(small_camera):
    """It lets no light of neighbours in that the square aperture keeps out."""
    camera = replace(small_camera, rim_diameter_mm=300.0, lenslet_rotation_rad=0.01)
    image = render(WHITE, camera, 0.01, "rays", 8, {"vignetting": True, "lenslet_rotation": True})
    np.testing.assert_allclose(image.views, 0.8, rtol=1e-6)
