"""What matter does to light, against closed forms: slabs, absorption, thickness, occlusion."""

import math

import numpy as np
import pytest
from builders import OPTICS

from lf_flame import Layer, PlenopticCamera, Scene, render
from lf_flame.simulation.slabs import self_absorbed, slice_scene

F, A0, FOCAL, PITCH = OPTICS.values()
I0 = F * A0 / (A0 - F)
WIDE = (40.0, 40.0)


def small(views=3, lenslets=(10, 12)):
    return PlenopticCamera(**OPTICS, views=views, lenslets=lenslets)


def by_rays(scene, camera, rays=60, tolerance=1e-3, **options):
    return render(scene, camera, tolerance, "rays", rays, **options).views.astype(float)


@pytest.mark.parametrize("count", [1, 3])
def test_slabs_that_absorb_keep_them_too(count):
    """Each slab is as thick as its share of the optical thickness; together they are the layer."""
    layer = Layer([[0.8, 0.3]], 7.0, (1.0, 2.0), optical_thickness=[[0.6, 2.0]], thickness_mm=12.0)
    planes = slice_scene(Scene([layer]), {layer: count}, True, {"self_absorption"})
    depths = np.array([plane.depth_mm for plane in planes])
    shares = np.array([-np.log(plane.transmission[0, 0]) / 0.6 for plane in planes])
    assert np.all(np.diff(depths) > 0)
    assert shares.sum() == pytest.approx(1.0, rel=1e-12)
    assert shares @ depths == pytest.approx(7.0, abs=1e-12)
    spread = shares @ (depths - 7.0) ** 2 + np.sum(shares**3) * 12.0**2 / 12
    assert spread == pytest.approx(12.0**2 / 12, rel=1e-12)
    light, clear = 0.0, 1.0
    for plane in planes:
        light, clear = light + clear * plane.emission, clear * plane.transmission
    np.testing.assert_allclose(clear, np.exp(-layer.optical_thickness), rtol=1e-12)
    escaping = -np.expm1(-layer.optical_thickness) / layer.optical_thickness
    np.testing.assert_allclose(light, layer.texture * escaping, rtol=1e-12)


def seen_below(camera, edge_mm, depth_mm, on_pixel):
    """Share of each bundle (u, s) on the side of a straight edge where x is smaller.

    A ray crosses the main lens at ``w - d i0 / a0`` and the focal plane at ``x + d``: w from its
    place on the pixel, x from the lenslet, d from its place on the lenslet. All upright.

    on_pixel: places in [-1/2, 1/2], of which the mean is taken.
    """
    scale = (A0 + depth_mm) / A0
    views, lenslets = camera.views, camera.lenslets[1]
    step, side = I0 * camera.pixel_mm / FOCAL, PITCH * A0 / I0
    w = (np.arange(views)[:, None, None] - (views - 1) / 2 + on_pixel) * step
    x = (np.arange(lenslets)[:, None] - (lenslets - 1) / 2) * side
    middle = scale * x + (1 - scale) * w
    width = (scale - (1 - scale) * I0 / A0) * side
    return np.clip((edge_mm - middle) / width + 0.5, 0, 1).mean(axis=2)


PLACES = (np.arange(400) + 0.5) / 400 - 0.5


@pytest.mark.slow
@pytest.mark.parametrize("depth", [0.0, -18.0])
def test_a_thick_slit_stands_and_spreads_as_its_geometry_says(depth):
    """The mean over its depths, pixel by pixel; then its middle and its width in each view."""
    thick, half, camera = 8.0, 0.15, small(5, (5, 40))
    slit = Layer([[1.0]], depth, (60.0, 2 * half), thickness_mm=thick)
    image = by_rays(Scene([slit]), camera, tolerance=0.002, rays=100)[2, :, 2]
    z, weight = np.polynomial.legendre.leggauss(40)
    expected = sum(
        share
        / 2
        * (seen_below(camera, half, deep, PLACES) - seen_below(camera, -half, deep, PLACES))
        for share, deep in zip(weight, depth + z * thick / 2, strict=True)
    )
    np.testing.assert_allclose(image, expected, atol=2e-3)
    lenslet = np.arange(40) - 19.5
    for found, true in zip(image, expected, strict=True):
        middles = [light @ lenslet / light.sum() for light in (found, true)]
        widths = [
            light @ (lenslet - middle) ** 2 / light.sum()
            for light, middle in zip((found, true), middles, strict=True)
        ]
        assert middles[0] == pytest.approx(middles[1], abs=2e-3)
        assert widths[0] == pytest.approx(widths[1], rel=5e-3)


@pytest.mark.parametrize("tau", [1e-9, 0.01, 0.5, 3.0, 40.0])
def test_a_body_absorbs_its_own_light_and_that_behind_it(tau):
    """Uniform layers: ``b (1 - exp(-tau)) / tau + exp(-tau) b'``, and what is in front adds."""
    back = Layer([[0.9]], 30.0, WIDE)
    body = Layer([[0.4]], 5.0, WIDE, optical_thickness=tau)
    front = Layer([[0.25]], -20.0, WIDE)
    escaping = -math.expm1(-tau) / tau
    expected = 0.25 + 0.4 * escaping + 0.9 * math.exp(-tau)
    assert self_absorbed(np.float64(tau)) == pytest.approx(escaping, rel=1e-14)
    image = by_rays(Scene([back, front, body]), small(), rays=4, tolerance=1e-6)
    np.testing.assert_allclose(image, expected, rtol=2e-6)


@pytest.mark.parametrize("tau", [0.5, 3.0])
def test_a_thick_uniform_body_absorbs_as_a_thin_one(tau):
    back = Layer([[0.9]], 30.0, WIDE)
    body = Layer([[0.4]], 5.0, WIDE, optical_thickness=tau, thickness_mm=3.0)
    inside = Layer([[0.7]], 5.5, WIDE)  # two thirds of the body are in front of it
    before = 2 / 3 * tau
    expected = 0.4 * -math.expm1(-tau) / tau + 0.9 * math.exp(-tau) + 0.7 * math.exp(-before)
    image = by_rays(Scene([back, inside, body]), small(), rays=4, tolerance=0.1)
    np.testing.assert_allclose(image, expected, rtol=0.03)
    alone = by_rays(Scene([back, body]), small(), rays=4, tolerance=0.1)
    np.testing.assert_allclose(alone, expected - 0.7 * math.exp(-before), rtol=2e-6)


def test_a_hole_lets_through_what_a_cover_hides():
    """Uniform layers: coverages c and d in front of one another leave (1 - c)(1 - d).

    A texture is premultiplied: what a layer shines is not multiplied by its coverage.
    """
    back = Layer([[0.9]], 30.0, WIDE)
    veil = Layer([[0.3]], 10.0, WIDE, opaque=True, coverage=[[0.4]])
    glow = Layer([[0.2]], 0.0, WIDE)
    net = Layer([[0.05]], -10.0, WIDE, opaque=True, coverage=[[0.75]])
    hole = Layer([[0.11]], -15.0, WIDE, opaque=True, coverage=[[0.0]])
    image = by_rays(Scene([back, net, glow, veil, hole]), small(), rays=4)
    expected = 0.11 + 0.05 + 0.25 * (0.2 + 0.3 + 0.6 * 0.9)
    np.testing.assert_allclose(image, expected, rtol=2e-6)
    card = Layer([[0.05]], -10.0, WIDE, opaque=True)
    image = by_rays(Scene([back, card, glow, veil, hole]), small(), rays=4)
    np.testing.assert_allclose(image, 0.16, rtol=2e-6)
