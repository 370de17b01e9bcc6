"""Diffraction at the lenslets on the true sensor, where pixels leave gaps between micro-images."""

from dataclasses import replace

import numpy as np
import pytest

from lf_flame import InputError, Layer, PlenopticCamera, Scene, render
from lf_flame.optics.diffraction import blur_raw
from lf_flame.simulation import diffraction_blur
from lf_flame.simulation.diffraction_blur import (
    blur_gapped,
    lenslet_kernel,
    lenslet_share_leaving,
    tiled_sensor,
)

ONLY_LENSLETS = {"lenslet_diffraction": True, "main_lens_diffraction": False}


def sparse_camera(fill=0.8, views=4, lenslets=(5, 6), nm=650.0):
    """Pixels that leave 1 - fill of a micro-image's width open."""
    camera = PlenopticCamera(150.0, 326.0, 0.4, 0.112, views, lenslets, wavelength_nm=nm)
    if fill == 1:
        return camera
    return replace(camera, pixel_pitch_mm=fill * camera.pixel_mm)


def line_spread(x_mm, camera):
    """Square lenslet's ``sinc^2``, of integral 1."""
    spread = camera.wavelength_nm * 1e-6 * camera.lenslet_focal_mm / camera.lenslet_pitch_mm
    return np.sinc(x_mm / spread) ** 2 / spread


@pytest.mark.parametrize(("fill", "views"), [(1, 5), (0.99, 5), (0.8, 5), (0.55, 4), (0.3, 1)])
def test_light_under_one_lenslet_reaches_the_neighbours_pixels(fill, views):
    """Against the spread integrated over the micro-image and over each pixel.

    The focal plane's cell that one lenslet sees lights its micro-image evenly, and no other.
    """
    camera = sparse_camera(fill, views, (7, 7))
    cell = camera.field_mm(0)[0] / 7
    scene = Scene([Layer([[1.0]], 0.0, (cell, cell))])
    found = render(scene, camera, effects=ONLY_LENSLETS).to_raw()
    x, weight = np.polynomial.legendre.leggauss(600)
    near, share = np.polynomial.legendre.leggauss(40)
    pitch = camera.micro_image_pitch_mm
    expected = []
    for lenslet in (-1, 0, 1):
        for view in np.arange(views) - (views - 1) / 2:
            on_pixel = lenslet * pitch + (view + near / 2) * camera.pixel_mm
            apart = on_pixel[:, None] - x * pitch / 2
            light = line_spread(apart, camera) @ weight * pitch / 2
            expected.append(light @ share / 2)
    inside = found[2 * views : 5 * views, 2 * views : 5 * views]
    # The kernel leaves out up to its tail, along both axes.
    np.testing.assert_allclose(inside, np.outer(expected, expected), rtol=7e-3, atol=2e-5)
    np.testing.assert_allclose(inside[views + views // 2], inside[:, views + views // 2], rtol=1e-6)


def piecewise(sharp, tiles, views, fine):
    """Cells of a fine sensor: the pixels, and in the gaps the tiles; of a square raw image."""
    parts = fine // tiles.views
    cells = np.kron(render(SCENE, tiles).to_raw(), np.ones((parts, parts)))
    count = cells.shape[0] // fine
    gap = (fine - views * PARTS) // 2
    on_pixels = slice(gap, gap + views * PARTS)
    for axis in (0, 1):
        lines = np.moveaxis(cells, axis, 0).reshape(count, fine, -1)
        pixels = lines[:, on_pixels].reshape(count, views, PARTS, -1).mean(axis=2)
        lines[:, on_pixels] = np.repeat(pixels, PARTS, axis=1)
        cells = np.moveaxis(lines.reshape(count * fine, -1), 0, axis)
    inside = (np.arange(count)[:, None] * fine + np.arange(fine)[on_pixels]).ravel()
    cells[np.ix_(inside, inside)] = np.kron(sharp, np.ones((PARTS, PARTS)))
    return cells, inside


SCENE = Scene([Layer(np.random.default_rng(1).random((40, 45)), 8.0, (0.8, 0.9), (0.02, -0.03))])
PARTS = 16


@pytest.mark.parametrize(
    ("views", "fill", "fine"), [(4, 4 / 6, 96), (3, 3 / 7.5, 120), (5, 1, 80), (4, 4 / 4.375, 70)]
)
def test_a_picture_is_blurred_as_on_a_fine_sensor(views, fill, fine):
    """Against cells a sixteenth of a pixel wide, blurred by the spread and put together."""
    camera = sparse_camera(fill, views, (5, 5), nm=1500.0)
    found = render(SCENE, camera, effects=ONLY_LENSLETS).to_raw().astype(float)
    sharp = render(SCENE, camera, effects=dict.fromkeys(ONLY_LENSLETS, False)).to_raw()
    tiles = replace(camera, views=-(-fine // PARTS), pixel_pitch_mm=None, wavelength_nm=None)
    cells, inside = piecewise(sharp, tiles, views, fine)
    cell = camera.pixel_mm / PARTS
    assert cell * fine == pytest.approx(camera.micro_image_pitch_mm)
    places = np.arange(len(cells))
    apart = (places[:, None] - places)[:, :, None] + (np.arange(4) + 0.5) / 4 - 0.5
    matrix = line_spread(apart * cell, camera).mean(axis=2)
    matrix = matrix[inside].reshape(-1, PARTS, len(cells)).mean(axis=1)
    matrix /= matrix.sum(axis=1, keepdims=True)
    inner = np.s_[views:-views, views:-views]
    error = found - matrix @ cells @ matrix.T
    assert np.abs(error[inner]).max() < 0.05 * np.abs(found - sharp)[inner].max()


def test_pixels_that_tile_are_blurred_as_ever(rng):
    camera = sparse_camera(1)
    raw = rng.random((5 * 4, 6 * 4), np.float32)
    expected = blur_raw(raw, lenslet_kernel(camera))
    np.testing.assert_allclose(blur_gapped(raw, raw, camera), expected, rtol=3e-7)
    narrow = sparse_camera(1 - 1e-6)
    assert tiled_sensor(narrow).views == 5
    scene = Scene([Layer(rng.random((20, 24)), 8.0, (0.8, 0.9))])
    images = [render(scene, c, effects=ONLY_LENSLETS).views for c in (camera, narrow)]
    inner = np.s_[:, :, 1:-1, 1:-1]  # beyond the border goes another tile, which blurs inward
    np.testing.assert_allclose(images[0][inner], images[1][inner], atol=1e-4)


@pytest.mark.parametrize("fill", [0.97, 0.6])
def test_no_light_is_made_and_none_is_lost(rng, fill):
    """An even field stays even, and a tile's light is shared out among pixels that tile."""
    camera = sparse_camera(fill)
    raw, tiles = (
        np.full([n * c.views for n in c.lenslets], 0.7, np.float32)
        for c in (camera, tiled_sensor(camera))
    )
    np.testing.assert_allclose(blur_gapped(raw, tiles, camera), 0.7, rtol=2e-7)
    sharp = replace(camera, wavelength_nm=1e-30)
    raw = rng.random(raw.shape, np.float32)
    np.testing.assert_array_equal(blur_gapped(raw, tiles, sharp), raw)


@pytest.mark.parametrize("fill", [0.97, 0.4])
def test_beyond_the_border_the_outermost_tiles_go_on(rng, fill):
    camera, wide = (sparse_camera(fill, lenslets=(n, n), nm=3000.0) for n in (3, 9))
    views, count = camera.views, tiled_sensor(camera).views
    raw = rng.random((3 * views, 3 * views), np.float32)
    tiles = rng.random((3 * count, 3 * count), np.float32)
    around = np.pad(tiles, 3 * count, "edge")
    # A pixel beyond the border is as its outermost neighbour inside, which is a gap.
    raw_around = np.zeros((9 * views, 9 * views), np.float32)
    means, edges = diffraction_blur._pieces(camera)
    own = diffraction_blur._pixel_pieces(camera, edges)
    every = np.kron(np.eye(9), means[own])
    raw_around[:] = every @ around @ every.T
    middle = slice(3 * views, 6 * views)
    raw_around[middle, middle] = raw
    rows = np.kron(np.eye(3), means[own]) @ tiles
    raw_around[middle, : 3 * views] = rows[:, :1]
    raw_around[middle, 6 * views :] = rows[:, -1:]
    columns = tiles @ np.kron(np.eye(3), means[own]).T
    raw_around[: 3 * views, middle] = columns[:1]
    raw_around[6 * views :, middle] = columns[-1:]
    found = blur_gapped(raw, tiles, camera)
    np.testing.assert_allclose(
        found, blur_gapped(raw_around, around, wide)[middle, middle], atol=3e-4
    )


@pytest.mark.parametrize("fill", [0.97, 0.5])
@pytest.mark.parametrize("nm", [30.0, 600.0, 5000.0])
@pytest.mark.parametrize("wide", [None, 1.15])
def test_no_pixel_changes_by_more_than_the_bound(rng, fill, nm, wide):
    camera = sparse_camera(fill, nm=nm)
    if wide:
        camera = replace(camera, aperture_diameter_mm=wide * camera.aperture_mm)
    bright = (rng.random((30, 30)) > 0.7).astype(float)
    scene = Scene([Layer(bright, -6.0, (0.6, 0.6))])
    options = {"integrator": "rays", "rays": 6} if wide else {}
    on, off = (
        render(scene, camera, effects={**ONLY_LENSLETS, "lenslet_diffraction": x}, **options)
        for x in (True, False)
    )
    change = np.abs(on.views.astype(float) - off.views).max()
    assert 0 < change <= on.plan["lenslet_diffraction"].bound * min(on.views.max(), off.views.max())


@pytest.mark.parametrize(("fill", "views"), [(0.97, 3), (0.97, 1), (0.5, 4)])
def test_a_dark_pixel_in_the_light_gets_the_share_that_the_bound_takes(fill, views):
    camera = sparse_camera(fill, views)
    raw = np.ones([n * views for n in camera.lenslets], np.float32)
    tiles = np.ones([n * tiled_sensor(camera).views for n in camera.lenslets], np.float32)
    given = []
    for view in range(views):
        raw[2 * views + view, 3 * views + view] = 0
        given.append(blur_gapped(raw, tiles, camera)[2 * views + view, 3 * views + view])
        raw[:] = 1
    assert max(given) == pytest.approx(lenslet_share_leaving(camera), rel=1e-6)


def test_pixels_far_too_small_for_their_lenslets_are_refused():
    camera = replace(sparse_camera(), pixel_pitch_mm=1e-6)
    with pytest.raises(InputError, match="use a larger pixel_pitch_mm, or force lenslet_diff"):
        tiled_sensor(camera)
