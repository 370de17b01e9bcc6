"""The rays that the ray integrator lays over planes: where they are, and how broad."""

from dataclasses import replace

import numpy as np
import pytest

from lf_flame import Layer, Scene
from lf_flame.simulation.optical_pass import OpticalPass
from lf_flame.simulation.ray_grid import LENSLET_FINER, _tile, _widths_in_cells, ray_grid
from lf_flame.simulation.slabs import slice_scene


def planes_of(*layers):
    return slice_scene(Scene(layers), {}, absorption=True, dimming={"occlusion"})


@pytest.mark.parametrize("rays", [1, 2, 7, 20])
@pytest.mark.parametrize("axis", [0, 1])
def test_boxes_have_the_mean_and_variance_of_the_bundle(small_camera, rays, axis):
    optics = OpticalPass(small_camera)
    layer = Layer([[1.0]], 10.0, (30.0, 30.0))
    grid = ray_grid(planes_of(layer), optics, "views", rays, axis)
    bundle, edges = optics.footprint(10.0, axis), grid.planes.edges_mm[0]
    cell_mm = edges[1] - edges[0]
    middles = edges[0] + cell_mm * grid.planes.positions[0]
    assert grid.count >= rays
    np.testing.assert_allclose(middles.mean(axis=-1), bundle.centres_mm, atol=1e-12)
    found = middles.var(axis=-1) + (grid.planes.boxes[0] * cell_mm) ** 2 / 12
    expected = (bundle.lenslet_width_mm**2 + bundle.pixel_width_mm**2) / 12
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_a_grid_has_the_shape_of_the_image(small_camera):
    optics = OpticalPass(
        small_camera, stops=((0.0, 30.0), (40.0, 35.0)), lenslet_skew=1e-3, every_lenslet=True
    )
    planes = planes_of(Layer([[1.0]], 5.0, (9.0, 9.0)), Layer([[0.0]], -5.0, (1.0, 1.0)))
    for layout, along, across in (("views", (5, 24), (5, 30)), ("raw", (1, 120), (1, 150))):
        grid = ray_grid(planes, optics, layout, 4, 0)
        assert grid.planes.positions.shape == (2, *along, grid.count)
        assert grid.stops.places_mm.shape == (2, *along, grid.count)
        assert grid.planes.shifts.shape == grid.stops.shifts_mm.shape == (2, *across)
        assert grid.seen.shape == along
        bare = ray_grid(planes, replace(optics, stops=()), layout, 4, 0)
        assert bare.stops.places_mm.shape[1:3] == along
        assert [len(table) for table in bare.stops] == [0] * 4


def test_cells_finer_than_a_box_are_averaged(small_camera, rng):
    fine = Layer(rng.uniform(size=(500, 500)), 10.0, (3.0, 3.0))
    grid = ray_grid(planes_of(fine), OpticalPass(small_camera), "views", 3, 0)
    assert grid.planes.cells[0] < 500
    assert grid.planes.boxes[0] == pytest.approx(1.0)


@pytest.mark.parametrize("depths", [(-10.0, 20.0), (3.0, 7.0), (-10.0, 0.0), (0.5, 1.5)])
def test_tiles_become_finer_along_pixel_and_lenslet_where_planes_dim(small_camera, depths):
    """From each count to that two further on, or they are no longer on the planes than wide."""
    card, light = (Layer(np.ones((2, 2)), depth, (3.0, 3.0), opaque=True) for depth in depths)
    optics, planes = OpticalPass(small_camera), planes_of(card, light)
    bundles = [optics.footprint(depth, 0) for depth in depths]
    edges = [layer.cell_edges_mm(0) for layer in (card, light)]
    widths = _widths_in_cells(bundles, edges, optics)
    lenslet, pixel = np.sqrt(np.prod(widths, axis=0))  # the means over the one pair
    tiles = [_tile(rays, widths, planes, optics) for rays in (8, 16, 32, 64, 128, 256) if rays > 4]
    for one, other in zip(tiles, tiles[1:], strict=False):
        long, wide = lenslet / other.on_lenslet, pixel / other.on_pixel
        assert other.along_pixel.size == other.on_pixel * other.on_lenslet
        assert other.on_lenslet > one.on_lenslet or long <= wide
        assert other.on_pixel > one.on_pixel or wide <= 1.1 * LENSLET_FINER * long
    if 0.0 in depths:
        assert tiles[-1].on_pixel == 1
    else:
        assert wide / long == pytest.approx(LENSLET_FINER, rel=0.15)
    alone = planes_of(Layer([[1.0]], 5.0, (1.0, 1.0)))
    assert _tile(40, widths[:1], alone, optics).on_lenslet == 1


def test_tiles_are_no_wider_than_cells_before_they_are_shorter(small_camera):
    """A card in focus leaves the pixel's width out of account, fine cells behind it do not."""
    optics = OpticalPass(small_camera)
    planes = planes_of(Layer([[1.0]], 0.0, (3.0, 3.0), opaque=True), Layer([[1.0]], 20.0, (3, 3)))
    widths = np.array([[0.1, 0.0], [0.5, 3.2]])
    for rays in (16, 40, 200):
        tiling = _tile(rays, widths, planes, optics)
        assert tiling.on_pixel == 4
        assert tiling.on_lenslet == rays // 4
