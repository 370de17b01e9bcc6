"""Rendering at focus, at the focal length and far away, with closed stops, in cameras of any size.

Truth is the reference tracer. More cases, each beside the formula that suggests itself, are in
`experiments/hard_cases`. A warning fails any test.
"""

import math

import numpy as np
import pytest
from builders import OPTICS

from experiments.effects.tracer import flat_views
from experiments.hard_cases.light import filling as filling_at
from lf_flame import Layer, PlenopticCamera, Scene, plan_effects, render

UNIT32 = 2.0**-24
"""Unit roundoff of float32, in which light fields are stored."""

RAYS = {"integrator": "rays", "rays": 24}

METHODS = pytest.mark.parametrize(
    ("method", "allowed"), [({}, 2 * UNIT32), (RAYS, 1 / 48)], ids=["exact", "rays"]
)
"""Both integrators and their error; an edge inside a bundle is off by half the share of a ray."""


def small(unit=1.0, **changes):
    """The paper's optics with few lenslets and views, in any unit of length."""
    lengths = {name: length * unit for name, length in OPTICS.items()}
    return PlenopticCamera(**(lengths | {"views": 4, "lenslets": (10, 12)} | changes))


def cells(rows=8, columns=9, seed=5):
    return np.random.default_rng(seed).uniform(0.2, 1.0, (rows, columns))


def rendered(layers, camera, **options):
    return render(Scene(layers), camera, **options).views.astype(float)


def true_image(layer, camera):
    return flat_views(Scene([layer]), camera)


def filling(camera, depth, texture, part=1.0):
    """A layer as large as a part of all that the pixels see at a depth."""
    return filling_at(texture, depth, part, camera)


def off(image, truth):
    """Largest error, relative to the brightest pixel of the truth; NaN where that is not finite."""
    return np.abs(image - truth).max() / np.max(truth)


DEPTHS = [0.0, *(sign * 10.0**k for k in range(-9, 3, 3) for sign in (-1, 1)), -325.999, 1e3]
DEPTHS += [distance - 326.0 for distance in (1.0, 75.0, 150.0 * (1 - 1e-12), 150.0, 1e15, 1e300)]
"""Near the focal plane and the lens, inside the focal length, at it, and as far as infinity."""


@METHODS
def test_images_change_steadily_with_the_depth(method, allowed):
    camera = small(views=5)
    unit = camera.field_mm(0.0)[0] / 10
    texture = cells(7, 7)
    for depth in DEPTHS:
        layer = filling(camera, depth, texture, 0.6)
        image = rendered([layer], camera, **method)
        assert image.min() >= 0
        assert image.max() <= texture.max() * (1 + UNIT32)
        assert off(image, true_image(layer, camera)) <= allowed

    def halved(depth):
        """Cells as wide as lenslets, with their edges in the middle of lenslets."""
        return Layer(texture, depth, (7 * unit, 7 * unit), (0.0, unit / 2))

    def ours(depth):
        return rendered([halved(depth)], camera, **method)

    for depth in (-1e-9, 1e-9):
        assert off(ours(depth), ours(0.0)) <= 2 * abs(depth) + 2 * UNIT32


WEAK = {"main_lens_focal_mm": 1e8, "lenslet_focal_mm": 1e5, "lenslet_pitch_mm": 1e3}


@METHODS
@pytest.mark.parametrize("part", [1e-3, 1e-2, 1.0, 1e3])
def test_weak_main_lenses_keep_their_power(method, allowed, part):
    """Of 1e8 mm, focused at little or much more than that; in and out of focus."""
    camera = small(**WEAK, focus_distance_mm=1e8 * (1 + part))
    for depth in (0.0, 1e-3 * part * 1e8):
        layer = filling(camera, depth, cells(4, 5), 0.7)
        truth = true_image(layer, camera)
        assert off(rendered([layer], camera, **method), truth) <= allowed + 1e-6


def true_share(camera):
    """Share of a lenslet's pixels that a stop in the middle of them lights."""
    stop = math.pi / 4 * camera.aperture_diameter_mm**2
    return stop / (camera.views * camera.view_step_mm) ** 2


def lit_share(camera, **options):
    """Mean over a lenslet's pixels, of a layer of brightness 1."""
    views = rendered([filling(camera, 10.0, [[1.0]], 3.0)], camera, **options)
    return views[:, :, 5, 6].mean()


def test_a_nearly_closed_stop_can_be_rendered():
    """One ray of n x n passes, so that images by more and more rays never agree."""
    camera = small(views=5, aperture_diameter_mm=1e-9)
    assert 0 <= lit_share(camera) <= 2 * true_share(camera)


def test_a_stop_as_wide_as_the_lenslets_take_does_not_depend_on_rounding():
    matched = small().aperture_mm
    share = []
    for diameter in np.nextafter(matched, [0, matched, np.inf]):
        camera = small(views=5, aperture_diameter_mm=float(diameter))
        scene = Scene([filling(camera, 10.0, [[1.0]], 3.0)])
        assert "f_number_mismatch" not in plan_effects(scene, camera).kept
        share.append(lit_share(camera, integrator="rays", rays=40))
    np.testing.assert_allclose(share, true_share(camera), rtol=1e-4)
    np.testing.assert_allclose(share, share[0], rtol=2 * UNIT32)


@METHODS
@pytest.mark.parametrize("views", [1, 2, 3])
@pytest.mark.parametrize(("lenslets", "pixel"), [((1, 1), None), ((3, 4), 0.0203), ((1, 2), 0.001)])
def test_few_views_and_lenslets_and_pixels_that_do_not_divide_them(
    method, allowed, views, lenslets, pixel
):
    """One pixel for a sensor; even and odd numbers; gaps between micro-images."""
    camera = small(views=views, lenslets=lenslets, pixel_pitch_mm=pixel)
    plain, layer = (filling(camera, 12.0, t, 0.9) for t in ([[1.0]], cells(3, 3)))
    truth = true_image(layer, camera)
    assert off(rendered([layer], camera, **method), truth) <= allowed
    image = rendered([plain], camera, **method)
    assert off(image, image[::-1, ::-1, ::-1, ::-1]) <= 2 * UNIT32


UNITS = [2.0**20, 2.0**-30, 1e3, 1e-3]


def matter(unit=1.0, **card):
    return Scene(
        [
            Layer(cells(), 10.0 * unit, (1.6 * unit, 1.8 * unit), (0.05 * unit, -0.1 * unit)),
            Layer(cells(3, 4), -20.0 * unit, (0.8 * unit, 0.9 * unit), (0.1 * unit, 0.2 * unit),
                  **card),
        ]
    )  # fmt: skip


SETUPS = {
    "exact": (matter, small, {}),
    "rays": (matter, small, RAYS),
    "occlusion": (lambda unit: matter(unit, opaque=True), small, RAYS),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", SETUPS)
def test_images_and_plans_do_not_depend_on_the_unit_of_length(name):
    """Every bit for a power of two, else the rounding of float32."""
    make_scene, make_camera, options = SETUPS[name]
    plain = render(make_scene(1.0), make_camera(1.0), **options)
    for unit in UNITS:
        scene, camera = make_scene(unit), make_camera(unit)
        other = render(scene, camera, **options)
        allowed = 2 * UNIT32 if unit in (1e3, 1e-3) else 0
        assert off(other.views.astype(float), plain.views.astype(float)) <= allowed
        assert other.plan.kept == plain.plan.kept
        assert other.plan.slabs == plain.plan.slabs
    assert "defocus" in plain.plan.kept


@pytest.mark.parametrize("name", ["exact", "rays", "occlusion"])
def test_the_order_in_which_layers_are_named_changes_no_bit(name):
    make_scene, make_camera, options = SETUPS[name]
    layers, camera = make_scene(1.0).layers, make_camera(1.0)
    far = filling(camera, 30.0, cells(5, 5, seed=9), 0.5)
    orders = [(*layers, far), (far, *layers[::-1]), (layers[1], far, layers[0])]
    images = [rendered(order, camera, **options) for order in orders]
    for image in images[1:]:
        np.testing.assert_array_equal(image, images[0])
