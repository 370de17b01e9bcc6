"""Stops, falloff and a misplaced array by themselves, against areas and integrals in closed form.

A place q of the sensor, through the place c + d of a lenslet centred at c, sees the main lens at
``c + d - i0 (q - c) / f``: all lengths in mm, along y or x.
"""

import math

import numpy as np
import pytest
from builders import OPTICS

from lf_flame import Layer, PlenopticCamera, Scene, render
from lf_flame.formats.raw.lenslet_search import estimate_grid

WHITE = Scene([Layer([[1.0]], 0.0, (400.0, 400.0))])
F, A0, FOCAL, PITCH = OPTICS.values()
I0 = F * A0 / (A0 - F)
MATCHED = I0 * PITCH / FOCAL
"""Width of the aperture that the lenslets match, in mm."""


def small(**changes):
    optics = {"views": 5, "lenslets": (7, 9)} | changes
    return PlenopticCamera(**OPTICS, **optics)


def white_image(camera, rays=40, **options):
    """Views of a white field, by rays."""
    image = render(WHITE, camera, tolerance=1e-4, integrator="rays", rays=rays, **options)
    return image.views.astype(float)


def some_pixels(camera):
    """Some pixels (v, u, t, s), more of them in the corners of micro-images."""
    pixels = list(np.ndindex(camera.views, camera.views, *camera.lenslets))
    last = camera.views - 1
    return pixels[::61] + [p for p in pixels[::13] if p[0] in (0, last) and p[1] in (0, last)]


def places(camera, pixel):
    """Middle of a pixel on the sensor, and centre of its nominal lenslet; as stored, upright."""
    lenslet = (np.array(pixel[2:]) - (np.array(camera.lenslets) - 1) / 2) * PITCH
    view = (np.array(pixel[:2]) - (camera.views - 1) / 2) * camera.pixel_mm
    return lenslet * (1 + FOCAL / I0) + view, lenslet


def quarter_area(y, x, radius):
    """Area of a circle about the origin inside the rectangle from the origin to (y, x)."""
    sign, y, x = np.sign(y) * np.sign(x), np.minimum(np.abs(y), radius), np.minimum(abs(x), radius)

    def under(t):
        return (t * math.sqrt(radius**2 - t**2) + radius**2 * math.asin(t / radius)) / 2

    start = math.sqrt(radius**2 - y**2)
    area = y * x if x <= start else y * start + under(x) - under(start)
    return sign * area


def share_inside(middle, side, radius):
    """Share of a square that lies in a circle about the origin."""
    (y0, x0), (y1, x1) = middle - side / 2, middle + side / 2
    area = quarter_area(y1, x1, radius) - quarter_area(y0, x1, radius)
    area += quarter_area(y0, x0, radius) - quarter_area(y1, x0, radius)
    return area / side**2


def gauss(side, order=4):
    """Nodes (y, x) and weights for the mean over a square about the origin."""
    x, weight = np.polynomial.legendre.leggauss(order)
    nodes = np.stack(np.meshgrid(x, x, indexing="ij"), -1).reshape(-1, 2) * side / 2
    return nodes, np.outer(weight, weight).ravel() / 4


def share_through_aperture(camera, pixel):
    """Light of a white field through a round aperture and all lenslets, of any pitch."""
    q, nominal = places(camera, pixel)
    true_pitch = PITCH * (1 + camera.lenslet_pitch_error)
    on_lenslet, weights = gauss(true_pitch)
    light = 0.0
    for further in np.ndindex(5, 5):
        c = nominal / PITCH * true_pitch + (np.array(further) - 2) * true_pitch
        middles = c + on_lenslet - I0 * (q - c) / FOCAL
        side = I0 * camera.pixel_mm / FOCAL
        radius = camera.aperture_diameter_mm / 2
        if np.abs(middles).min(axis=0).max() < radius + side / 2:  # else in the dark
            light += weights @ [share_inside(m, side, radius) for m in middles]
    return light


def share_through_rim(camera, pixel):
    """Light of a white field that also passes a rim in front of a main lens that cuts nothing."""
    q, c = places(camera, pixel)
    distance = camera.rim_distance_mm
    on_lenslet, weights = gauss(PITCH)
    tilt = (q - c) / FOCAL
    # Through the main lens, and on to the rim: what the tilt is there goes with both.
    middles = (c + on_lenslet - I0 * tilt) * (1 - distance / F) - distance * tilt
    side = (I0 * (1 - distance / F) + distance) / FOCAL * camera.pixel_mm
    return weights @ [share_inside(m, side, camera.rim_diameter_mm / 2) for m in middles]


@pytest.mark.parametrize("width", [1.0, 0.8, 1.15])
def test_a_round_aperture_lets_the_area_of_its_circle_pass(width):
    """Matched, too narrow and too wide: f-numbers that do not match, both ways."""
    camera = small(aperture_diameter_mm=width * MATCHED)
    image = white_image(camera)
    for pixel in some_pixels(camera):
        expected = share_through_aperture(camera, pixel)
        assert image[pixel] == pytest.approx(expected, abs=4e-4), pixel


@pytest.mark.slow
@pytest.mark.parametrize(("diameter", "distance"), [(70.0, 40.0), (38.0, 150.0)])
def test_a_rim_lets_the_area_of_its_circle_pass(diameter, distance):
    camera = small(rim_diameter_mm=diameter, rim_distance_mm=distance, lenslets=(7, 30))
    image = white_image(camera)
    for pixel in some_pixels(camera):
        assert image[pixel] == pytest.approx(share_through_rim(camera, pixel), abs=4e-4), pixel


@pytest.mark.parametrize("radius", [0.56, 0.65])
def test_a_rim_at_the_lens_takes_the_views_that_it_cuts(radius):
    """Those whose squares of the aperture are not inside; it is no aperture that is too wide."""
    camera = small(rim_diameter_mm=2 * radius * MATCHED, views=9)
    weights = render(WHITE, camera, tolerance=1e-3).weights
    ends = (np.abs(np.arange(9) - 4) + 0.5) / 9
    np.testing.assert_array_equal(weights, np.hypot(*np.meshgrid(ends, ends)) <= radius)


WIDE_FIELD = {"lenslets": (12, 120), "views": 5, "falloff_corrected": False}


def wide_field(**changes):
    """Rays tilted by up to 20 degrees: a lens of 20 mm before a long array."""
    return PlenopticCamera(
        main_lens_focal_mm=20.0,
        focus_distance_mm=200.0,
        lenslet_focal_mm=FOCAL,
        lenslet_pitch_mm=PITCH,
        **WIDE_FIELD | changes,
    )


def mean_falloff(camera, pixel):
    """Mean of cos^4 over a pixel, hence over the part of the aperture that it sees."""
    i0 = 20 * 200 / 180
    lenslet = (np.array(pixel[2:]) - (np.array(camera.lenslets) - 1) / 2) * PITCH
    view = (np.array(pixel[:2]) - (camera.views - 1) / 2) * camera.pixel_mm
    on_pixel, weights = gauss(camera.pixel_mm, 8)
    tilt = (lenslet * FOCAL / i0 + view + on_pixel) / FOCAL
    return weights @ np.cos(np.arctan(np.hypot(*tilt.T))) ** 4


@pytest.mark.parametrize("integrator", ["auto", "rays"])
@pytest.mark.parametrize("views", [1, 5])
def test_falloff_is_the_mean_of_cos4_over_a_pixel(integrator, views):
    camera = wide_field(views=views)
    rays = {"rays": 30} if integrator == "rays" else {}
    image = render(WHITE, camera, 1e-4, integrator, **rays).views
    v, last = views - 1, np.array(camera.lenslets) - 1
    corner = (v, v, *last)
    assert mean_falloff(camera, corner) < 0.85
    for pixel in [corner, (0, v, 3, 7), (0, 0, *last), (v, 0, 0, 110), (v // 2, 0, 6, 60)]:
        assert image[pixel] == pytest.approx(mean_falloff(camera, pixel), abs=1e-4), pixel


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "amount"), [("lenslet_rotation_rad", 0.01), ("lenslet_pitch_error", -0.01)]
)
def test_a_white_image_reads_back_the_array(fault, amount):
    """Signs and sizes, found by a program that knows nothing of the simulator."""
    views = 11
    camera = PlenopticCamera(
        **OPTICS, views=views, lenslets=(42, 50), aperture_diameter_mm=MATCHED, **{fault: amount}
    )
    image = render(WHITE, camera, tolerance=1e-3, integrator="rays", rays=10)
    grid = estimate_grid(image.to_raw())
    found = {"lenslet_rotation_rad": grid.rotation, "lenslet_pitch_error": grid.pitch / views - 1}
    true = dict.fromkeys(found, 0.0) | {fault: amount}
    assert found == pytest.approx(true, abs=2e-5)
