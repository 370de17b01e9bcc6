"""Bounds of second order against the changes of rendered images, from both sides."""

from dataclasses import replace
from itertools import cycle

import numpy as np
import pytest

from lf_flame import Layer, PlenopticCamera, Scene, plan_effects
from lf_flame.optics.ray_bundle import trace_footprint
from lf_flame.scenes.flames import HALF_WIDTH, draw_wrinkles, flame_texture
from lf_flame.simulation.planning.bundle_widths import BundleWidths
from lf_flame.simulation.planning.effects import EFFECTS
from lf_flame.simulation.planning.scene_bounds import bound_scene, displaced
from lf_flame.simulation.planning.spread_bounds import (
    colour_change,
    depth_change,
    lenslet_blur_change,
    main_lens_blur_change,
    patch_change,
)
from lf_flame.simulation.rendering import render_plan

SPREADS = {
    "thickness": depth_change,
    "chromatic": colour_change,
    "defocus": patch_change,
    "lenslet_diffraction": lenslet_blur_change,
    "main_lens_diffraction": main_lens_blur_change,
}
SLABS, COLOURS = 24, 12
"""Midpoints in place of integrals over depth and colour."""


def window(views=5, lenslets=(16, 20), **changes):
    """The paper's optics, with a window of its lenslets."""
    optics = {
        "main_lens_focal_mm": 150.0,
        "focus_distance_mm": 326.0,
        "lenslet_focal_mm": 0.4,
        "lenslet_pitch_mm": 0.112,
    }
    return PlenopticCamera(**optics, views=views, lenslets=lenslets, **changes)


def image(layer, camera, *effects):
    """What a camera sees by some effects alone, in the unit of the texture."""
    scene = Scene([layer])
    only = {effect: effect in effects for effect in EFFECTS}
    plan = plan_effects(scene, camera, 1.0, dict.fromkeys(EFFECTS, False))
    kept = tuple(replace(effect, kept=only[effect.name]) for effect in plan.effects)
    slabs = SLABS if "thickness" in effects else 1
    colours = COLOURS if "chromatic" in effects else 1
    plan = replace(plan, effects=kept, slabs=(slabs,), colours=colours)
    return render_plan(scene, camera, plan).views.astype(float)


def largest_change(layer, camera, name, state=("defocus",)):
    """Largest change of a pixel by one effect, beside those of a state."""
    state = set(state) - {name}
    return np.abs(image(layer, camera, name, *state) - image(layer, camera, *state)).max()


def flame(rng, thickness_mm=0.0, height=None):
    """A wrinkled flame somewhere before a window."""
    height, radius = height or rng.uniform(14, 30), rng.uniform(1.5, 3)
    texture = flame_texture(height, radius, draw_wrinkles(rng), 0.06 * radius, 0.04)
    place = rng.uniform(-0.4, 0.4) * height, rng.uniform(-2, 2)
    size = height, 2 * HALF_WIDTH * radius
    return Layer(texture, rng.uniform(-10, 20), size, place, thickness_mm=thickness_mm)


@pytest.mark.parametrize("name", [name for name in SPREADS if name != "defocus"])
def test_random_smooth_flames_change_by_a_fifth_of_the_bound_or_more(name, rng):
    ratios = []
    for _ in range(12):
        layer = flame(rng, rng.uniform(2, 10) if name == "thickness" else 0.0)
        shift = 10 ** rng.uniform(-3, -2) if name == "chromatic" else 0.0
        wavelength = rng.uniform(450, 700) if name.endswith("diffraction") else None
        camera = window(chromatic_shift=shift, wavelength_nm=wavelength)
        bounds = bound_scene(Scene([layer]), camera)
        found = largest_change(layer, camera, name)
        ratios.append(bounds.relative(found) and EFFECTS[name](bounds).bound / (
            bounds.relative(found)
        ))  # fmt: skip
    assert min(ratios) >= 1
    assert np.median(ratios) <= 5


def textures(rng):
    """Rough and smooth ones: noise, chequers, a card, a bright cell, a ramp, a bowl."""
    down, right = np.indices((24, 30))
    yield rng.uniform(size=(24, 30))
    yield (down + right) % 2.0
    yield (down // 5 + right // 7) % 2.0
    yield np.ones((1, 1))
    yield 1.0 * ((down == 12) & (right == 13))
    yield right / 30
    yield ((right - 15) ** 2 + (down - 12) ** 2) / 400


@pytest.mark.slow
@pytest.mark.parametrize("name", SPREADS)
@pytest.mark.parametrize("depth_mm", [0.0, 7.0])
def test_no_texture_changes_by_more_than_the_bound(name, depth_mm, rng):
    """Whatever else is simulated, and whether the border of the image is lit or dark."""
    camera = window(3, (9, 10), chromatic_shift=6e-3, wavelength_nm=600.0, pixel_pitch_mm=0.112 / 3)
    others = cycle([None, "thickness", "chromatic", "main_lens_diffraction"])
    for size in ((0.8, 0.9), (2.4, 2.8)):
        for texture in textures(rng):
            layer = Layer(texture, depth_mm, size, (0.03, -0.05), thickness_mm=6.0)
            bounds = bound_scene(Scene([layer]), camera)
            most = SPREADS[name](bounds, layer)
            found = largest_change(layer, camera, name, {"defocus", next(others)} - {None})
            assert found <= most + 1e-6 * texture.max()


@pytest.mark.parametrize("depth_mm", [5.0, 20.0])
def test_without_defocus_the_bound_does_not_count_on_its_blur(depth_mm):
    """A chequerboard out of focus: what defocus smooths stands out without it."""
    camera = window(3, (9, 10))
    layer = Layer(np.indices((24, 30)).sum(axis=0) % 2.0, depth_mm, (2.4, 2.8), thickness_mm=0.3)
    bounds = bound_scene(Scene([layer]), camera)
    sharp = replace(bounds, defocus=False)
    blurred, found = (largest_change(layer, camera, "thickness", s) for s in (("defocus",), ()))
    assert 10 * blurred < found <= depth_change(sharp, layer)
    assert blurred <= depth_change(bounds, layer) < depth_change(sharp, layer)


def test_a_bowl_bends_as_the_bound_says():
    """The mean of a square over a spread of M is M^2 / 12, wherever its middle is."""
    cells = (np.arange(-240, 240) + 0.5) / 4
    layer = Layer(cells[None, :] ** 2 * np.ones((40, 1)), 0.0, (12.0, 6.0), thickness_mm=6.0)
    camera = window(9, (6, 6))
    bounds = bound_scene(Scene([layer]), camera)
    step = np.diff([bounds.footprints[layer, 1].centres_mm[view, 0] for view in (0, 8)])
    assert np.isclose(step, 0)  # in focus
    ends = replace(layer, depth_mm=3.0), replace(layer, depth_mm=-3.0)
    travel = [bound_scene(Scene([end]), camera).footprints[end, 1].centres_mm for end in ends]
    truth = np.abs(travel[0] - travel[1]).max() ** 2 / 12 / (6.0 / 120) ** 2
    assert largest_change(layer, camera, "thickness") == pytest.approx(truth, rel=0.02)
    assert truth <= depth_change(bounds, layer) <= 1.6 * truth


def test_a_step_attains_the_bound_of_a_move(small_camera):
    """The border of a bright card in the middle of a bundle: nothing changes by more."""
    card = Layer([[1.0]], 10.0, (3.0, 20.0))
    bounds = bound_scene(Scene([card]), small_camera)
    footprint = bounds.footprints[card, 0]
    box = max(abs(footprint.lenslet_width_mm), abs(footprint.pixel_width_mm))
    shift = 0.1 * box
    found = 0.0
    for place in np.linspace(0, box, 24):
        ends = [replace(card, centre_mm=(place + way, 0.0)) for way in (0.0, shift)]
        one, other = (image(end, small_camera, "defocus") for end in ends)
        found = max(found, np.abs(one - other).max())
    assert found <= displaced(bounds, card, 0, shift, box) * (1 + 1e-5)
    assert found == pytest.approx(displaced(bounds, card, 0, shift, box), rel=1e-3)


def test_light_that_is_stopped_or_comes_from_neighbours_has_no_such_bound(rng):
    layer = flame(rng, 3.0)
    rounds = {"aperture_diameter_mm": 1.2 * window().aperture_mm}
    for camera, layers in (
        (window(**rounds), [layer]),
        (window(lenslet_rotation_rad=1e-3), [layer]),
        (window(lenslet_pitch_error=1e-3), [layer]),
        (window(), [layer, Layer([[0.0]], -10.0, (1.0, 1.0), opaque=True)]),
        (window(), [replace(layer, optical_thickness=0.1)]),
    ):
        assert depth_change(bound_scene(Scene(layers), camera), layers[0]) == np.inf
    stopped = window(rim_diameter_mm=60.0, rim_distance_mm=10.0, wavelength_nm=550.0)
    bounds = bound_scene(Scene([layer]), stopped)
    assert np.isfinite(depth_change(bounds, layer))
    for spread in (patch_change, lenslet_blur_change, main_lens_blur_change):
        assert spread(bounds, layer) == np.inf


def test_parts_of_a_spread_change_less_and_less(rng):
    layer = flame(rng, 8.0)
    bounds = bound_scene(Scene([layer]), window(chromatic_shift=5e-3))
    for change in (depth_change, colour_change):
        changes = [change(bounds, layer, parts) for parts in (1, 2, 4, 16)]
        assert np.all(np.diff(changes) < 0)
        assert changes[-1] < changes[0] / 16


def test_a_patch_bends_a_bowl_as_the_bound_says():
    """The mean of a square over a pixel's width b is b^2 / 12."""
    cells = (np.arange(-240, 240) + 0.5) / 4
    layer = Layer(cells[None, :] ** 2 * np.ones((40, 1)), 4.0, (12.0, 6.0))
    bounds = bound_scene(Scene([layer]), window(5, (6, 6)))
    truth = (bounds.footprints[layer, 1].pixel_width_mm / 0.05) ** 2 / 12
    assert largest_change(layer, window(5, (6, 6)), "defocus") == pytest.approx(truth, rel=0.03)
    assert truth <= patch_change(bounds, layer) <= 1.6 * truth


def test_a_saddle_twists_as_the_bound_says():
    """Of y x, which does not bend along either axis, the mean over M_y and M_x is a twelfth."""
    cells = (np.arange(-240, 240) + 0.5) / 4
    layer = Layer(np.outer(cells, cells) + 4000.0, 0.0, (6.0, 6.0), thickness_mm=6.0)
    camera = window(9, (6, 6))
    bounds = bound_scene(Scene([layer]), camera)
    ends = replace(layer, depth_mm=3.0), replace(layer, depth_mm=-3.0)
    travel = [bound_scene(Scene([end]), camera).footprints[end, 1].centres_mm for end in ends]
    truth = np.abs(travel[0] - travel[1]).max() ** 2 / 12 / (6.0 / 120) ** 2
    assert largest_change(layer, camera, "thickness") == pytest.approx(truth, rel=0.03)
    assert truth <= depth_change(bounds, layer) <= 2 * truth


def test_a_wide_band_of_colours_is_not_even():
    """Even a ramp changes: the power of the lens is no straight line over its focal lengths."""
    ramp = np.arange(1.0, 801.0) * np.ones((40, 1))
    layer = Layer(ramp, 0.0, (24.0, 24.0))
    camera = window(5, (6, 6), chromatic_shift=0.2)
    bounds = bound_scene(Scene([layer]), camera)
    here, *ends = (
        trace_footprint(camera, 0.0, 1, 150.0 * (1 + shift)).centres_mm
        for shift in (0.0, -0.1, 0.1)
    )
    # A quadratic aside: a third of what it is at the ends, on average.
    truth = np.abs((ends[0] + ends[1]) / 2 - here).max() / 3 / (24.0 / 800)
    assert largest_change(layer, camera, "chromatic") == pytest.approx(truth, rel=0.05)
    assert truth <= colour_change(bounds, layer)


@pytest.mark.parametrize("depth_mm", [-4.0, 0.5, 12.0])
def test_widths_between_two_depths_and_colours_are_those_of_rays(small_camera, depth_mm):
    """Against bundles traced at places all over both spreads, which may pass the focal plane."""
    camera = replace(small_camera, chromatic_shift=0.03)
    layer = Layer([[1.0]], depth_mm, (1.0, 1.0), thickness_mm=4.0)
    widths = BundleWidths(bound_scene(Scene([layer]), camera), layer, 0)
    for depths, colours in (((-1, 1), (-1, 1)), ((-0.5, 0.2), (0.3, 0.9)), ((0, 0), (-1, 0.5))):
        footprints = [
            trace_footprint(camera, depth_mm + 2.0 * depth, 0, 150.0 * (1 + 0.015 * colour))
            for depth in np.linspace(*depths, 41)
            for colour in np.linspace(*colours, 41)
        ]
        box = widths.box(depths, colours)
        for found, name in ((box.lenslet, "lenslet_width_mm"), (box.pixel, "pixel_width_mm")):
            traced = [getattr(footprint, name) for footprint in footprints]
            narrowest = 0.0 if min(traced) <= 0 <= max(traced) else np.abs(traced).min()
            np.testing.assert_allclose(found, (narrowest, np.abs(traced).max()), rtol=1e-9)


@pytest.mark.parametrize("focus_mm", [1e7, 2.0**62])
def test_bundles_that_reach_over_any_number_of_cells_have_a_bound(small_camera, focus_mm):
    """That of how far rays move: the change of a whole texture at most."""
    scene = Scene([Layer(np.eye(5), 5.0, (3.0, 3.0))])
    camera = replace(small_camera, focus_distance_mm=focus_mm)
    assert plan_effects(scene, camera, 0.05)["defocus"].kept
