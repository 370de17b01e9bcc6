"""Bundles cut into polygons, against strips that are counted line by line."""

from dataclasses import replace

import numba
import numpy as np
import pytest

from experiments.effects.tracer import flat_views
from lf_flame import Layer, Scene
from lf_flame._common.arrays import centred
from lf_flame.simulation.exact import integrate
from lf_flame.simulation.layouts import as_views, blank_image
from lf_flame.simulation.optical_pass import OpticalPass
from lf_flame.simulation.polygons import (
    bundles_on,
    cut_bundles,
    expected_pairs,
    expected_polygons,
    find_shaded,
    split_planes,
)
from lf_flame.simulation.slabs import slice_scene

LINES = 1000
"""Lines across a bundle; the area along them is exact, between them it errs as 1 / LINES**2."""


@pytest.fixture
def tiny_camera(small_camera):
    """So few pixels that they are soon summed with the JIT off as well."""
    return replace(small_camera, views=3, lenslets=(12, 14))


def planes_of(*layers, slabs=None):
    return slice_scene(Scene(layers), slabs or {}, True, {"occlusion", "self_absorption"})


def image_of(planes, optics, layout="views"):
    out = blank_image(optics.camera, layout, np.float64)
    integrate(planes, optics, layout, out)
    return as_views(out, optics.camera, layout)


def glow(rng, depth, cells=(7, 5), **matter):
    return Layer(rng.random(cells), depth, (2.4, 2.0), (0.3, -0.2), **matter)


def card(rng, depth, cells=(6, 8)):
    size, centre = (1.4, 1.8), (-0.1, 0.2)
    texture, coverage = rng.random(cells) * 0.1, rng.random(cells)
    return Layer(texture, depth, size, centre, opaque=True, coverage=coverage)


def similar_triangles(camera, depth, axis):
    """Middles of the bundles on a layer and both signed widths, without a matrix.

    The ray through height y of the array and h of the main lens crosses the focal plane at
    ``-y a0 / i0`` and goes on straight to the layer. A pixel at q from its lenslet's axis sees
    the height ``h = y - (q - y) i0 / f`` of the main lens.
    """
    a0, i0 = camera.focus_distance_mm, camera.image_distance_mm

    def on_layer(y, h):
        focused = -y * a0 / i0
        return focused + (focused - h) * depth / a0

    y = centred(camera.lenslets[axis]) * camera.lenslet_pitch_mm
    h = -centred(camera.views)[:, None] * camera.pixel_mm * i0 / camera.lenslet_focal_mm
    # A place on the lenslet moves the ray there and, parallel to itself, on the main lens.
    lenslet = on_layer(camera.lenslet_pitch_mm, camera.lenslet_pitch_mm)
    pixel = on_layer(0.0, -camera.pixel_mm * i0 / camera.lenslet_focal_mm)
    return -on_layer(y, h), lenslet, pixel


def strips(planes, bundles, pixel):
    """Cells of all planes, and their share of a bundle: the places b between edges, line by line.

    planes: their edges; bundles: for each the middles, the width over the lenslet, and that over
    the pixel.
    """
    a, breadth = lines_across(planes, bundles, pixel)
    crossings, heights = [np.full(a.shape, -0.5), np.full(a.shape, 0.5)], []
    for edges, (middles, lenslet, wide) in zip(planes, bundles, strict=True):
        line = middles.ravel()[pixel] + lenslet * a
        heights.append((line, wide))
        if wide:
            crossings.append(np.clip((edges - line) / wide, -0.5, 0.5))
    b = np.sort(np.concatenate(crossings, axis=1), axis=1)
    middle, length = (b[:, 1:] + b[:, :-1]) / 2, np.diff(b, axis=1) * breadth
    cells = [
        np.searchsorted(edges, line + wide * middle, side="right")
        for edges, (line, wide) in zip(planes, heights, strict=True)
    ]
    names, which = np.unique(np.reshape(cells, (len(cells), -1)), axis=1, return_inverse=True)
    return names, np.bincount(which.ravel(), length.ravel())


def lines_across(planes, bundles, pixel):
    """Places a of lines and their breadth, none across an edge along which b does not matter."""
    ends = [-0.5, 0.5]
    for edges, (middles, lenslet, wide) in zip(planes, bundles, strict=True):
        if abs(wide) < 1e-9 * abs(lenslet):
            ends += list((edges - middles.ravel()[pixel]) / lenslet)
    ends = np.unique(np.clip(ends, -0.5, 0.5))
    middles, breadth = (ends[1:] + ends[:-1]) / 2, np.diff(ends)
    a = middles[:, None] + breadth[:, None] * centred(LINES) / LINES
    return a.reshape(-1, 1), np.repeat(breadth / LINES, LINES)[:, None]


def pixel_by_lines(planes, bundles, pixel):
    """One pixel's light: strips along y by strips along x.

    bundles: from a plane and an axis to its middles and widths; pixel: (y, x).
    """
    found = [
        strips(
            [plane.layer.cell_edges_mm(axis) for plane in planes],
            [bundles(plane, axis) for plane in planes],
            pixel[axis],
        )
        for axis in (0, 1)
    ]
    (rows, tall), (columns, wide) = found
    light, clear = 0.0, 1.0
    for p, plane in enumerate(planes):
        passes = np.ones(1) if plane.transmission is None else plane.transmission
        passes = np.broadcast_to(passes, plane.emission.shape)
        at = np.ix_(rows[p], columns[p])
        light = light + clear * np.pad(plane.emission, 1)[at]
        clear = clear * np.pad(passes, 1, constant_values=1.0)[at]
    return tall @ light @ wide


def assert_sums_of_lines(planes, optics, bundles, rng, pixels=12):
    image = image_of(planes, optics)
    raw = image.transpose(0, 2, 1, 3).reshape(image.shape[0] * image.shape[2], -1)
    some = rng.integers(0, raw.shape, (400, 2))
    some = [pixel for pixel in some if raw[tuple(pixel)] > 0][:pixels]
    assert len(some) == pixels
    for y, x in some:
        expected = pixel_by_lines(planes, bundles, (y, x))
        assert raw[y, x] == pytest.approx(expected, abs=5e-6 * image.max())


@pytest.mark.parametrize(
    ("near", "far"),
    [(-10, 20), (0, 10), (-20, 0), (10, 20), (-30, -10), (5, 5), (-200, 20), (-200, -190)],
)
def test_one_card_gives_its_flat_views(small_camera, rng, near, far):
    """In focus, before and behind it, at one depth, and inside the focal length."""
    scene = Scene([glow(rng, far), card(rng, near), glow(rng, near - 3.0)])
    image = image_of(planes_of(*scene.layers), OpticalPass(small_camera))
    truth = flat_views(scene, small_camera)
    np.testing.assert_allclose(image, truth, rtol=1e-12, atol=1e-13 * truth.max())


def three_planes(rng):
    return [
        glow(rng, 20.0),
        Layer(rng.random((3, 4)), 0.0, (1.5, 1.6), opaque=True, coverage=rng.random((3, 4))),
        Layer(rng.random((5, 4)), -10.0, (2.0, 1.5), optical_thickness=rng.random((5, 4))),
        glow(rng, 30.0, (4, 4)),
    ]


@pytest.mark.slow
def test_four_planes_one_behind_the_other(tiny_camera, rng):
    """By similar triangles instead of matrices."""

    def bundles(plane, axis):
        return similar_triangles(tiny_camera, plane.depth_mm, axis)

    assert_sums_of_lines(planes_of(*three_planes(rng)), OpticalPass(tiny_camera), bundles, rng)


@pytest.mark.slow
def test_slabs_of_thick_layers_that_interleave(tiny_camera, rng):
    tau = rng.random((7, 5))
    thick = [glow(rng, d, thickness_mm=6.0, optical_thickness=tau) for d in (4.0, 7.0)]
    planes = planes_of(*thick, slabs=dict.fromkeys(thick, 3))
    assert planes[1].layer is not planes[2].layer is not planes[3].layer

    def bundles(plane, axis):
        return similar_triangles(tiny_camera, plane.depth_mm, axis)

    assert_sums_of_lines(planes, OpticalPass(tiny_camera), bundles, rng, pixels=6)


@pytest.mark.slow
@pytest.mark.parametrize(
    "changes",
    [
        {"defocus": False},
        {"lenslet_scale": 1.02, "focal_mm": 151.0},
        {"neighbour": (1, -1), "share": 0.25},
    ],
    ids=str,
)
def test_other_passes_of_light(tiny_camera, rng, changes):
    optics = OpticalPass(tiny_camera, **changes)

    def bundles(plane, axis):
        footprint = optics.footprint(plane.depth_mm, axis)
        pixel_mm = footprint.pixel_width_mm * optics.defocus
        return footprint.centres_mm, footprint.lenslet_width_mm, pixel_mm

    planes = [
        replace(plane, emission=plane.emission / optics.share)
        for plane in planes_of(*three_planes(rng))
    ]
    bare = replace(optics, share=1.0)
    np.testing.assert_allclose(
        image_of(planes, optics), optics.share * image_of(planes, bare), rtol=1e-14
    )
    assert_sums_of_lines(planes, bare, bundles, rng, pixels=6)


@pytest.mark.parametrize("depth", [-30.0, 0.0, 12.0])
def test_a_bundle_reaches_as_far_as_its_corner_rays(small_camera, rng, depth):
    layer = glow(rng, depth)
    for axis in (0, 1):
        _, lenslet, pixel = similar_triangles(small_camera, depth, axis)
        places = np.add.outer([-lenslet / 2, lenslet / 2], [-pixel / 2, pixel / 2])
        cell_mm = layer.size_mm[axis] / layer.texture.shape[axis]
        reach = bundles_on(planes_of(layer), OpticalPass(small_camera), axis).reach
        np.testing.assert_allclose(reach, [np.ptp(places) / 2 / cell_mm], rtol=1e-9)


def test_uniform_fields_dim_by_the_product_of_all_they_cross(small_camera):
    """And by cos^4, as the exact integrator has it for open light."""
    camera, size = replace(small_camera, lenslets=(3, 4), views=2), (90.0, 90.0)
    light = Layer(np.full((9, 8), 0.7), 20.0, size)
    hazes = [Layer(np.zeros((7, 5)), d, size, optical_thickness=0.2) for d in (-10.0, 0.0, 5.0)]
    for optics in (OpticalPass(camera), OpticalPass(camera, falloff=True)):
        plain = image_of(planes_of(light), optics)
        image = image_of(planes_of(light, *hazes), optics)
        np.testing.assert_allclose(image, plain * np.exp(-0.6), rtol=1e-13)


@pytest.mark.parametrize("depths", [(5.0, 15.0), (0.0, 10.0), (-200.0, -10.0)])
def test_polygons_fill_the_bundle(small_camera, depths, rng):
    layers = [Layer(rng.random((40, 40)), depth, (30.0, 30.0)) for depth in depths]
    for axis in (0, 1):
        bundles = bundles_on(planes_of(*layers), OpticalPass(small_camera), axis)
        table = cut_bundles(bundles, "views", np.ones(bundles.middles.shape[:2], bool))
        assert np.all(np.diff(table.first) > 0)
        np.testing.assert_allclose(np.add.reduceat(table.areas, table.first[:-1]), 1, rtol=1e-12)
        assert table.areas.min() > 0


def test_planes_with_the_same_edges_are_cut_once(small_camera, rng):
    """And what rounding leaves between them is dropped."""
    one = Layer(rng.random((30, 30)), 7.0, (3.0, 3.0))
    other = Layer(rng.random((30, 30)), 7.0, (3.0, 3.0))
    optics, everywhere = OpticalPass(small_camera), np.ones((5, 24), bool)
    single, double = (
        cut_bundles(bundles_on(planes_of(*layers), optics, 0), "views", everywhere)
        for layers in ([one], [one, other])
    )
    np.testing.assert_array_equal(single.first, double.first)
    np.testing.assert_array_equal(double.cells[:, 0], double.cells[:, 1])


def test_what_a_card_covers_is_dark_and_what_it_does_not_is_as_without_it(small_camera, rng):
    light = glow(rng, 20.0)
    planes = planes_of(light, Layer([[0.0]], -10.0, (30.0, 30.0), opaque=True))
    assert not image_of(planes, OpticalPass(small_camera)).any()
    optics = OpticalPass(small_camera)
    planes = planes_of(light, Layer([[0.0]], -10.0, (0.5, 0.4), opaque=True))
    image, plain = (image_of(some, optics) for some in (planes, planes[1:]))
    rows, columns = find_shaded(planes, optics, "views")
    shaded = rows[:, None, :, None] & columns[None, :, None, :]
    assert 0.02 < shaded.mean() < 0.5
    np.testing.assert_array_equal(image[~shaded], plain[~shaded])
    assert np.all(image <= plain * (1 + 1e-12))
    assert image[shaded].min() < 0.1 * plain.max() < plain[shaded].max()


def test_only_what_glows_behind_what_dims_is_cut(rng):
    glows = [glow(rng, depth) for depth in (-20.0, 30.0)]
    cards = [card(rng, depth) for depth in (0.0, 50.0)]
    black = Layer([[0.0]], 60.0, (2.0, 2.0), opaque=True)
    in_front, behind = split_planes(planes_of(*glows, *cards, black))
    assert [plane.depth_mm for plane in in_front] == [-20.0]
    assert [plane.depth_mm for plane in behind] == [0.0, 30.0, 50.0]
    assert behind[-1].transmission is None
    in_front, behind = split_planes(planes_of(cards[0], black))
    assert len(in_front) == 1
    assert behind == []
    assert split_planes(planes_of(black)) == ([], [])


def test_bits_depend_neither_on_the_layout_nor_on_threads(tiny_camera, rng):
    planes, optics = planes_of(*three_planes(rng)), OpticalPass(tiny_camera)
    views, raw = (image_of(planes, optics, layout) for layout in ("views", "raw"))
    np.testing.assert_array_equal(views, raw)
    before = numba.get_num_threads()
    try:
        for count in range(1, numba.config.NUMBA_NUM_THREADS + 1):
            numba.set_num_threads(count)
            np.testing.assert_array_equal(image_of(planes, optics), views)
    finally:
        numba.set_num_threads(before)


@pytest.mark.parametrize("depths", [(5.0, 15.0), (-30.0, 20.0), (-30.0, 0.0, 20.0)])
def test_the_number_of_polygons_is_known_in_advance(small_camera, depths, rng):
    """In the mean over bundles that lie anyhow on cells of all sizes."""
    cells = rng.integers(40, 200, len(depths))
    layers = [
        Layer(np.ones((n, n)), depth, (30.0, 30.0), (0.011 * n, 0.0))
        for n, depth in zip(cells, depths, strict=True)
    ]
    bundles = bundles_on(planes_of(*layers), OpticalPass(small_camera), 0)
    table = cut_bundles(bundles, "views", np.ones((5, 24), bool))
    found = np.diff(table.first).mean()
    assert found == pytest.approx(expected_polygons(bundles), rel=0.03)


def test_edges_that_a_small_plane_does_not_have_are_not_expected(small_camera):
    """Two edges of the card and the edges that the bundle meets; and few pixels that see them."""
    small = Layer([[0.0]], -10.0, (1e-3, 1e-3), opaque=True)
    planes = planes_of(small, Layer(np.ones((90, 90)), 20.0, (12.0, 12.0)))
    optics = OpticalPass(small_camera)
    totals = []
    for axis, wanted in enumerate(find_shaded(planes, optics, "views")):
        bundles = bundles_on(planes, optics, axis)
        found = cut_bundles(bundles, "views", wanted).first[-1]
        assert found / wanted.sum() == pytest.approx(expected_polygons(bundles), rel=0.2)
        totals.append(found)
    assert expected_pairs(planes, optics) == pytest.approx(np.prod(totals), rel=0.3)
