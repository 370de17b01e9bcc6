"""Diffraction at the lenslets on the true sensor, where pixels leave gaps between micro-images."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import special

from lf_flame import PAPER_CAMERA, Layer, Scene, render
from lf_flame.simulation.diffraction import (
    blur_on_sensor,
    tiled_sensor,
)

ONLY_LENSLETS = {"lenslet_diffraction": True, "main_lens_diffraction": False}


def sparse_camera(fill=0.8, views=4, lenslets=(5, 6), nm=650.0):
    """Pixels that leave 1 - fill of a micro-image's width open."""
    camera = replace(PAPER_CAMERA, views=views, lenslets=lenslets, wavelength_nm=nm)
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
    x, weight = special.roots_legendre(600)
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
    # Beside a gap the light falls steeply, over less than a part of a pixel.
    allowed = 2e-5 if fill == 1 else 1.5e-3
    np.testing.assert_allclose(inside, np.outer(expected, expected), rtol=3e-3, atol=allowed)
    np.testing.assert_allclose(inside[views + views // 2], inside[:, views + views // 2], rtol=1e-6)


SCENE = Scene([Layer(np.random.default_rng(1).random((40, 45)), 8.0, (0.8, 0.9), (0.02, -0.03))])
PARTS = 16


def spread_matrix(size, cell_mm, camera):
    """Line spread between cells that are lit evenly, as a matrix: over a hat two cells wide."""
    place = (np.arange(512) + 0.5) / 256 - 1
    hat = (1 - np.abs(place)) / 256
    weights = line_spread((np.arange(-size, size + 1)[:, None] + place) * cell_mm, camera) @ hat
    return weights[size + np.subtract.outer(np.arange(size), np.arange(size))] * cell_mm


@pytest.mark.slow
@pytest.mark.parametrize(("views", "fill", "fine"), [(3, 3 / 7.5, 120), (5, 1, 80)])
def test_a_picture_is_blurred_as_on_a_fine_sensor(views, fill, fine):
    """Against the same light in cells a sixteenth of a pixel wide, blurred and put together."""
    camera = sparse_camera(fill, views, (5, 5), nm=1500.0)
    found, sharp = (
        render(SCENE, camera, effects=ONLY_LENSLETS | {"lenslet_diffraction": on}).to_raw()
        for on in (True, False)
    )
    dense = replace(camera, views=fine, pixel_pitch_mm=None, wavelength_nm=None)
    cells = render(SCENE, dense).to_raw().astype(float)
    cell = camera.pixel_mm / PARTS
    assert cell * fine == pytest.approx(camera.micro_image_pitch_mm)
    around = np.pad(cells, 4 * fine, "edge")
    matrix = spread_matrix(len(around), cell, camera)
    gap = (fine - views * PARTS) // 2
    inside = (4 + np.arange(5))[:, None] * fine + gap + np.arange(views * PARTS)
    matrix = matrix[inside.ravel()].reshape(5 * views, PARTS, -1).mean(axis=1)
    inner = np.s_[views:-views, views:-views]
    error = (found - matrix @ around @ matrix.T)[inner]
    change = np.abs(found - sharp)[inner].max()
    assert change > 0.03
    assert np.abs(error).max() < 5e-3 * sharp.max()
    assert np.sqrt(np.mean(error**2)) < 1e-3 * sharp.max()


def test_pixels_that_tile_are_blurred_one_by_one(rng):
    """Against the line spread between all pixels, of an image that goes on beyond its border."""
    camera, beside = sparse_camera(1), 500
    assert tiled_sensor(camera).views == camera.views
    raw = rng.random((5 * 4, 6 * 4), np.float32)
    matrices = [
        spread_matrix(size + 2 * beside, camera.pixel_mm, camera)[beside:-beside]
        for size in raw.shape
    ]
    around = np.pad(raw, beside, "edge")
    expected = matrices[0] @ around @ matrices[1].T
    found = blur_on_sensor(raw, tiled_sensor(camera), camera)
    np.testing.assert_allclose(found, expected, atol=2e-4)
    narrow = sparse_camera(1 - 1e-6)
    assert tiled_sensor(narrow).views == 5
    scene = Scene([Layer(rng.random((20, 24)), 8.0, (0.8, 0.9))])
    images = [render(scene, c, effects=ONLY_LENSLETS).views for c in (camera, narrow)]
    np.testing.assert_allclose(*images, atol=2e-3)


@pytest.mark.parametrize("fill", [1, 0.97, 0.6])
def test_no_light_is_made_and_none_is_lost(rng, fill):
    """An even field stays even, and light that is thrown off a pixel is found on others."""
    camera = sparse_camera(fill)
    tiled = tiled_sensor(camera, 2)
    tiles = np.full([n * tiled.views for n in camera.lenslets], 0.7, np.float32)
    np.testing.assert_allclose(blur_on_sensor(tiles, tiled, camera), 0.7, rtol=2e-7)
    ideal = replace(camera, pixel_pitch_mm=None)
    dot = np.zeros([n * 2 * ideal.views for n in camera.lenslets], np.float32)
    dot[dot.shape[0] // 2, dot.shape[1] // 2] = 1
    blurred = blur_on_sensor(dot, tiled_sensor(ideal, 2), ideal)
    assert blurred.sum(dtype=float) == pytest.approx(1 / 4, rel=5e-3)
    unmoved = blur_on_sensor(dot, tiled_sensor(ideal, 2), replace(ideal, wavelength_nm=1e-30))
    assert unmoved.max() == pytest.approx(1 / 4, rel=1e-4)


@pytest.mark.parametrize("fill", [0.97, 0.4])
def test_beyond_the_border_the_outermost_tiles_go_on(rng, fill):
    camera, wide = (sparse_camera(fill, lenslets=(n, n), nm=3000.0) for n in (3, 9))
    tiled, views = tiled_sensor(camera), camera.views
    tiles = rng.random((3 * tiled.views, 3 * tiled.views), np.float32)
    around = np.pad(tiles, 3 * tiled.views, "edge")
    middle = slice(3 * views, 6 * views)
    expected = blur_on_sensor(around, tiled_sensor(wide), wide)[middle, middle]
    np.testing.assert_allclose(blur_on_sensor(tiles, tiled, camera), expected, atol=1.5e-3)
