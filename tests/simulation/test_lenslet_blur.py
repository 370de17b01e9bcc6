"""Diffraction at the lenslets on the true sensor, where pixels leave gaps between micro-images."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import special

from lf_flame import PAPER_CAMERA, Layer, Scene, render
from lf_flame.simulation.diffraction import blur_on_sensor, tiled_sensor

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
