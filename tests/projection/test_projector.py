"""Images straight from a scene: equal to those of its light field, and to closed forms."""

from dataclasses import replace
from unittest.mock import patch

import numpy as np
import pytest
from builders import OPTICS
from hypothesis import given, settings
from hypothesis import strategies as st
from sentences import refusals

from lf_flame import InputError, Layer, PlenopticCamera, Scene, Sensor, plan_effects, projection
from lf_flame.projection import Projector
from lf_flame.refocus import align_views, aperture_weights, round_aperture, shift_and_sum
from lf_flame.simulation.planning.effects import EFFECTS, NOT_SEPARABLE
from lf_flame.simulation.rendering import render_plan


def small(views=5, lenslets=(12, 18), **changes):
    return PlenopticCamera(**{**OPTICS, "views": views, "lenslets": lenslets, **changes})


ASIDE = dict.fromkeys(("round_aperture", "f_number_mismatch", "thickness", "chromatic"), False)


def both_ways(scene, camera):
    """Make a projector of the scene, and its light field, in few slabs and colours."""
    plan = plan_effects(scene, camera, effects=ASIDE)
    slabs = tuple(3 if layer.thickness_mm else 1 for layer in scene.layers)
    plan = replace(plan, slabs=slabs, colours=2 if camera.chromatic_shift else 1)
    return Projector(scene, camera, plan), render_plan(scene, camera, plan)


def binned(images, block):
    """Means over blocks of the last two axes."""
    *others, height, width = images.shape
    down, across = block
    cut = images.reshape(*others, height // down, down, width // across, across)
    return cut.mean(axis=(-3, -1), dtype=float)


def assert_close(found, expected, brightest):
    assert found.dtype == np.float32
    assert found.shape == expected.shape
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6 * brightest)


@st.composite
def scenes(draw):
    layers = []
    for _ in range(draw(st.integers(1, 3))):
        rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
        cells = rng.uniform(0, draw(st.sampled_from([1.0, 300.0])), rng.integers(1, 20, 2))
        layers.append(
            Layer(
                cells * (rng.uniform(size=cells.shape) < 0.8),
                draw(st.integers(-600, 600)) / 10,
                rng.uniform(0.05, 4, 2),
                rng.uniform(-0.5, 0.5, 2),
                thickness_mm=draw(st.sampled_from([0.0, 0.0, 15.0])),
            )
        )
    return Scene(layers)


@st.composite
def cameras(draw):
    return small(
        draw(st.integers(1, 6)),
        (12, draw(st.sampled_from([6, 18, 30]))),
        pixel_pitch_mm=draw(st.sampled_from([None, 0.015])),
        lenslet_pitch_error=draw(st.sampled_from([0.0, 0.0, 0.02, -0.01])),
        chromatic_shift=draw(st.sampled_from([0.0, 0.0, 0.02])),
    )


SLOPES = st.floats(-4, 4) | st.sampled_from([0.0, 1.0, 0.5, 40.0])


def apertures(views):
    """Weights of all kinds: none, round, a ring, one view, any."""
    rng = np.random.default_rng(views)
    shape = (views, views)
    one, ring = np.fliplr(np.diag(np.arange(views) == 0)), aperture_weights(shape, 1.0, 0.5)
    return [None, round_aperture(shape), ring, one, rng.uniform(size=shape)]


@pytest.mark.slow
@given(
    scene=scenes(),
    camera=cameras(),
    slopes=st.lists(SLOPES, min_size=1, max_size=3),
    interpolation=st.sampled_from(["linear", "nearest", "cubic"]),
    block=st.sampled_from([(1, 1), (3, 3), (4, 2), (12, 6)]),
    aperture=st.integers(0, 4),
)
@settings(max_examples=15, deadline=None)
def test_refocused_images_are_those_of_the_light_field(
    scene, camera, slopes, interpolation, block, aperture
):
    """Edges, blocks, apertures, slabs, colours and misplaced lenslets at random."""
    slopes = np.rint(np.array(slopes) * 2**20) / 2**20  # so that both round halves alike
    weights = apertures(camera.views)[aperture]
    projected, light_field = both_ways(scene, camera)
    found = projected.refocus(slopes, interpolation, block, weights)
    expected = binned(
        shift_and_sum(light_field, slopes, interpolation=interpolation, weights=weights), block
    )
    assert_close(found, expected, light_field.views.max())


@pytest.mark.slow
@given(
    scene=scenes(),
    camera=cameras(),
    slopes=st.lists(SLOPES, min_size=1, max_size=2),
    block=st.sampled_from([(1, 1), (3, 3), (4, 2)]),
)
@settings(max_examples=12, deadline=None)
def test_aligned_views_are_those_of_the_light_field(scene, camera, slopes, block):
    last = camera.views - 1
    indices = [(0, last), (last // 2, last), (last, 0)]
    projected, light_field = both_ways(scene, camera)
    found = projected.align_views(slopes, indices, block)
    assert_close(
        found, align_views(light_field, slopes, indices, block=block), light_field.views.max()
    )
    still = projected.align_views(0.0, indices, block)[0]
    views = np.stack([light_field.views[index] for index in indices])
    assert_close(still, binned(views, block), light_field.views.max())


@pytest.mark.parametrize("slope", [0.0, -1.7, 30.0])
def test_a_layer_that_fills_the_field_keeps_its_brightness(slope):
    """However it is refocused: images are true means, and edges are repeated."""
    scene, camera = Scene([Layer(np.full((3, 5), 0.7), 10.0, (60.0, 60.0))]), small()
    projected = Projector(scene, camera, plan_effects(scene, camera))
    for weights in apertures(camera.views):
        images = projected.refocus(slope, "linear", (3, 3), weights)
        np.testing.assert_allclose(images, 0.7, rtol=1e-6)


@pytest.mark.parametrize("depth", [5.0, -6.0, 0.0])
@pytest.mark.parametrize("slope", [0.0, 0.8, -1.3])
def test_a_spot_has_the_light_the_place_and_the_width_of_the_geometry(depth, slope):
    """Its moments along x, in closed form, in lenslets of the central view.

    Light: that of the spot, whatever the slope. Place: as in the central view, for apertures that
    are symmetric; through a single view it moves by the error of the slope. Variance: of the spot,
    of the boxes of the lenslet (wider, as its rays are parallel) and of the pixel, the spread of
    the views, and that of linear interpolation, f (1 - f) each. The spot is smooth, three boxes of
    a lenslet folded, so that sums over lenslets are integrals.
    """
    views, camera, cells = 5, small(5, (40, 60)), 32
    lenslet_mm = camera.field_mm(depth)[1] / 60
    box = np.ones(cells)
    profile = np.convolve(np.convolve(box, box), box) / cells**2
    size = len(profile) * lenslet_mm / cells
    scene = Scene([Layer(2 * np.outer(profile, profile), depth, (size, size), (0.1, 0.3))])
    projected = Projector(scene, camera, plan_effects(scene, camera, effects={"defocus": True}))
    error, steps = camera.depth_to_slope(depth) - slope, np.arange(views) - 2
    image = projected.refocus(slope)[0].astype(float)
    light = 2 * (profile.sum() / cells) ** 2
    assert image.sum() == pytest.approx(light, rel=1e-6)
    at = np.arange(60) - 29.5
    place = image.sum(axis=0) @ at / light
    assert place == pytest.approx(0.3 / lenslet_mm, abs=1e-5)
    parallel = 1 + camera.depth_to_slope(depth) * camera.lenslet_pitch_mm / camera.view_step_mm
    spot = (3 * (1 - 1 / cells**2) + 1 / cells**2) / 12
    boxes = (parallel**2 + camera.depth_to_slope(depth) ** 2) / 12
    split = np.mod(slope * steps, 1)
    expected = spot + boxes + error**2 * np.mean(steps**2) + np.mean(split * (1 - split))
    variance = image.sum(axis=0) @ (at - place) ** 2 / light
    assert variance == pytest.approx(expected, abs=2e-4)
    seen = projected.refocus(slope, weights=np.outer(steps == 0, steps == 2))[0]
    moved = seen.sum(axis=0) @ at / light - place
    assert moved == pytest.approx(error * 2, abs=1e-5)


GLOW = Layer(np.random.default_rng(5).uniform(0.2, 1.0, (8, 9)), 10.0, (1.0, 1.2), (0.05, -0.1))
CALLING = {
    "occlusion": (Scene([GLOW, Layer([[0.3]], -10.0, (0.8, 0.9), opaque=True)]), small()),
    "lenslet_diffraction": (Scene([GLOW]), small(wavelength_nm=550.0)),
    "shot_noise": (Scene([GLOW]), small(sensor=Sensor(1000.0))),
    "layout": (Scene([GLOW]), small(layout="hexagonal")),
}
"""Scenes and cameras that call for a light field."""


@pytest.mark.parametrize("name", CALLING)
def test_what_needs_a_light_field_is_named_with_its_reason(name):
    scene, camera = CALLING[name]
    plan = plan_effects(scene, camera)
    words = f"{name} {NOT_SEPARABLE[name]}"
    assert name in plan.not_separable
    assert f"  {words}" in str(plan).split("refocused images: through the light field, because")[1]
    assert plan.to_json()["not_separable"] == plan.not_separable
    with pytest.raises(InputError, match=f"These images need a light field, as .*{words}"):
        Projector(scene, camera, plan)


SEPARABLE = {
    "defocus": (Scene([GLOW]), small(), {}),
    "thickness": (Scene([Layer(GLOW.texture, 0.0, (1.6, 1.8), thickness_mm=8.0)]), small(), {}),
    "main_lens_diffraction": (
        Scene([GLOW]),
        small(wavelength_nm=2000.0),
        {"lenslet_diffraction": False},
    ),
    "lenslet_pitch_error": (Scene([GLOW]), small(lenslet_pitch_error=0.01), {}),
    "chromatic": (Scene([GLOW]), small(chromatic_shift=0.02), {}),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", SEPARABLE)
def test_effects_that_keep_light_separable_are_in_the_images(name):
    assert set(SEPARABLE) == set(EFFECTS) - set(NOT_SEPARABLE)
    scene, camera, effects = SEPARABLE[name]
    plan = plan_effects(scene, camera, effects=effects)
    assert name in plan.kept
    assert plan.not_separable == {}
    assert "refocused images: directly from the scene, because light only adds up" in str(plan)
    images = [
        Projector(scene, camera, plan_effects(scene, camera, effects=effects | {name: kept}))
        for kept in (True, False)
    ]
    on, off = (projected.refocus(0.7)[0] for projected in images)
    assert_close(on, shift_and_sum(render_plan(scene, camera, plan), 0.7), 1.0)
    assert np.abs(on - off).max() > 1e-4


def test_many_passes_are_traced_anew_for_each_image():
    scene, camera, _ = SEPARABLE["chromatic"]
    kept, light_field = both_ways(scene, camera)
    with patch.object(projection, "MOST_KEPT", 1):
        anew, _ = both_ways(scene, camera)
    for _ in range(2):
        np.testing.assert_array_equal(kept.refocus(0.7), anew.refocus(0.7))
    assert_close(anew.refocus(0.7), shift_and_sum(light_field, [0.7]), 1.0)


def test_a_flame_that_dims_but_its_own_light_is_projected():
    scene = Scene([Layer(GLOW.texture, 10.0, (1.0, 1.0), optical_thickness=0.5)])
    projected, light_field = both_ways(scene, small())
    assert "self_absorption" in light_field.plan.kept
    assert_close(projected.refocus(0.4), shift_and_sum(light_field, [0.4]), 1.0)


FAR = Layer([[1.0]], 0.0, (1.0, 1.0), (90.0, 0.0))


def projected():
    return Projector(Scene([GLOW]), small(), plan_effects(Scene([GLOW]), small()))


test_it_is_refused_in_a_sentence = refusals(
    [
        (lambda: projected().refocus(0.0, "sinc"), "interpolation must be one of linear, "),
        (lambda: projected().refocus(0.0, block=(5, 3)), "Blocks of 5 x 3 lenslets do not divide"),
        (lambda: projected().refocus(0.0, weights=np.ones((3, 3))), "shape of the views, 5 x 5"),
        (lambda: projected().refocus([np.nan]), "slopes must be one or more finite numbers"),
        (lambda: projected().align_views(0.0, [(5, 0)]), r"There is no view \(5, 0\)"),
        (
            lambda: Projector(Scene([FAR]), small(), plan_effects(Scene([GLOW]), small())),
            "lies outside the field",
        ),
    ]
)
