"""What is measured on some pixels against the changes of whole images, and against closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from builders import OPTICS

from lf_flame import Layer, PlenopticCamera, Scene, plan_effects
from lf_flame.optics.ray_bundle import trace_footprint
from lf_flame.scenes.flames import HALF_WIDTH, draw_wrinkles, flame_texture
from lf_flame.simulation.planning.effects import EFFECTS
from lf_flame.simulation.planning.part_counts import SLICING_SHARE
from lf_flame.simulation.planning.probes import Probes, find_probes
from lf_flame.simulation.planning.scene_bounds import bound_scene
from lf_flame.simulation.rendering import render_plan

SLABS, COLOURS = 24, 12
"""Midpoints in place of integrals over depth and colour."""

SPREADS = ("thickness", "chromatic")


def window(views=5, lenslets=(16, 20), **changes):
    """The paper's optics, with a window of its lenslets."""
    return PlenopticCamera(**OPTICS, views=views, lenslets=lenslets, **changes)


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
    return np.abs(image(layer, camera, name, *state) - image(layer, camera, *state)).max()


def measured(layer, camera, name, **changes):
    """Change by one effect as some pixels show it."""
    bounds = replace(bound_scene(Scene([layer]), camera), **changes)
    (probes,) = find_probes(bounds, [layer], name)
    return probes.error(1)


def flame(rng, thickness_mm=0.0):
    """A wrinkled flame somewhere before a window."""
    height, radius = rng.uniform(14, 30), rng.uniform(1.5, 3)
    texture = flame_texture(height, radius, draw_wrinkles(rng), 0.06 * radius, 0.04)
    place = rng.uniform(-0.4, 0.4) * height, rng.uniform(-2, 2)
    size = height, 2 * HALF_WIDTH * radius
    return Layer(texture, rng.uniform(-10, 20), size, place, thickness_mm=thickness_mm)


@pytest.mark.parametrize("name", SPREADS)
def test_flames_change_by_what_is_measured_or_up_to_three_times_less(name, rng):
    for _ in range(4):
        layer = flame(rng, rng.uniform(2, 10) if name == "thickness" else 0.0)
        shift = 10 ** rng.uniform(-3, -2) if name == "chromatic" else 0.0
        camera = window(chromatic_shift=shift)
        found = largest_change(layer, camera, name)
        assert found <= measured(layer, camera, name) <= 3 * found


def draw(seed):
    """A texture before a window, the effect that spreads its light, and the state of others."""
    rng = np.random.default_rng(seed)
    kind = rng.choice(["few", "sparse", "noise", "edge"])
    shape = tuple(rng.integers(1, 6, 2) if kind in ("few", "edge") else rng.integers(8, 60, 2))
    texture = rng.uniform(size=shape)
    if kind == "few":
        texture = np.rint(texture)
    elif kind == "sparse":
        texture *= rng.uniform(size=shape) > 0.95
    elif kind == "edge":
        texture = np.ones(shape)
        texture[: rng.integers(shape[0])] = texture[:, : rng.integers(shape[1])] = 0
    texture[-1, -1] = 1
    name = str(rng.choice(SPREADS))
    shift, thickness_mm = 10 ** rng.uniform(-4, -2), 10 ** rng.uniform(-2, 1)
    camera = window(
        int(rng.integers(1, 6)), rng.integers(1, 30, 2).tolist(),
        chromatic_shift=shift * (name == "chromatic"),
    )  # fmt: skip
    layer = Layer(
        texture, rng.uniform(-20, 20), 10 ** rng.uniform(-0.5, 2, 2), rng.normal(0, 1, 2),
        thickness_mm=thickness_mm * (name == "thickness"),
    )  # fmt: skip
    return layer, camera, name, bool(rng.integers(2))


@pytest.mark.slow
def test_no_texture_changes_by_more_than_is_measured():
    """Wide cells, of which few lines see an edge, and edges that only one end of a spread shows."""
    ratios = []
    for seed in (80, 149, *range(260, 274), *range(275, 300), 374, 384, 475, 719):
        layer, camera, name, defocus = draw(seed)
        found = largest_change(layer, camera, name, ("defocus",) * defocus)
        largest = measured(layer, camera, name, defocus=defocus)
        assert found <= largest, seed
        if found > 1e-5:
            ratios.append(largest / found)
    assert np.median(ratios) < 2.4
    assert len(ratios) > 25


def test_without_defocus_nothing_is_counted_on_its_blur():
    """A chequerboard out of focus: what defocus smooths stands out without it."""
    camera = window(3, (9, 10))
    layer = Layer(np.indices((24, 30)).sum(axis=0) % 2.0, 20.0, (2.4, 2.8), thickness_mm=0.3)
    blurred, found = (largest_change(layer, camera, "thickness", s) for s in (("defocus",), ()))
    assert 10 * blurred < found <= measured(layer, camera, "thickness", defocus=False)
    assert blurred <= measured(layer, camera, "thickness") < found


def travel_cells(layer, camera, cell_mm):
    """How far the central rays of the outermost pixels move over a thick layer, in cells."""
    ends = (
        trace_footprint(camera, layer.depth_mm + side * layer.thickness_mm / 2, 1).centres_mm
        for side in (-1, 1)
    )
    return np.abs(next(ends) - next(ends)).max() / cell_mm


@pytest.mark.parametrize("kind", ["bowl", "saddle"])
def test_bent_textures_change_by_a_twelfth_of_the_squared_travel(kind):
    """The mean of x^2 over a spread of M is M^2 / 12, wherever its middle is; of y x likewise."""
    cells = (np.arange(-240, 240) + 0.5) / 4
    texture = np.outer(cells, cells) + 4000.0 if kind == "saddle" else np.outer(cells**0, cells**2)
    layer = Layer(texture, 0.0, (12.0, 12.0), thickness_mm=6.0)
    camera = window(9, (6, 6))
    # Cells are 12 / 480 mm wide, and a step of 1 is 4 of them.
    truth = travel_cells(layer, camera, 4 * 12.0 / 480) ** 2 / 12
    # Twice as safe, and the ends of four parts count an eighth more.
    expected = 2 * truth * 9 / 8
    assert measured(layer, camera, "thickness") == pytest.approx(expected, rel=0.03)


def test_a_wide_band_of_colours_is_not_even():
    """Even a ramp changes: the power of the lens is no straight line over its focal lengths."""
    ramp = np.arange(1.0, 801.0) * np.ones((40, 1))
    layer = Layer(ramp, 0.0, (24.0, 24.0))
    camera = window(5, (6, 6), chromatic_shift=0.2)
    here, *ends = (
        trace_footprint(camera, 0.0, 1, 150.0 * (1 + shift)).centres_mm
        for shift in (0.0, -0.1, 0.1)
    )
    # A quadratic aside: a third of what it is at the ends, on average.
    truth = np.abs((ends[0] + ends[1]) / 2 - here).max() / 3 / (24.0 / 800)
    assert measured(layer, camera, "chromatic") == pytest.approx(2 * truth * 9 / 8, rel=0.05)


def test_where_light_is_stopped_or_comes_from_neighbours_nothing_is_measured(rng):
    layer = flame(rng, 3.0)
    for camera, layers in (
        (window(aperture_diameter_mm=1.2 * window().aperture_mm), [layer]),
        (window(lenslet_rotation_rad=1e-3), [layer]),
        (window(lenslet_pitch_error=1e-3), [layer]),
        (window(), [layer, Layer([[0.0]], -10.0, (1.0, 1.0), opaque=True)]),
        (window(), [replace(layer, optical_thickness=0.1)]),
    ):
        assert find_probes(bound_scene(Scene(layers), camera), layers, "thickness") == []


@pytest.mark.parametrize(("seed", "larger"), [(30, "blurred"), (63, "sharp")])
def test_behind_a_stop_a_pixel_may_be_whole_or_a_point(seed, larger):
    layer, camera, name, _ = draw(seed)
    kinds = {
        "blurred": measured(layer, camera, name, defocus=True),
        "sharp": measured(layer, camera, name, defocus=False),
    }
    assert kinds[larger] > 1.2 * min(kinds.values())
    stopped = replace(camera, rim_diameter_mm=60.0, rim_distance_mm=10.0)
    assert measured(layer, stopped, name) == pytest.approx(max(kinds.values()), rel=1e-9)


def test_lines_that_change_where_they_cross_others_are_measured_too(monkeypatch):
    """Of four slabs against many; lines that change most by themselves miss half of it."""
    layer, camera, name, defocus = draw(86)
    images = []
    for slabs in (4, 64):
        monkeypatch.setitem(globals(), "SLABS", slabs)
        images.append(image(layer, camera, name, *("defocus",) * defocus))
    bounds = replace(bound_scene(Scene([layer]), camera), defocus=defocus)
    (probes,) = find_probes(bounds, [layer], name)
    assert name == "thickness"
    assert np.abs(images[0] - images[1]).max() <= probes.error(4)


def test_a_far_corner_of_a_large_field_decides():
    """There light moves farthest, and there is little of it."""
    camera = window(3, (120, 160))
    texture = np.zeros((160, 210))
    texture[2:4, 2:5] = texture[80, 100] = 1.0
    layer = Layer(texture, 4.0, (15.0, 20.0), thickness_mm=4.0)
    found = largest_change(layer, camera, "thickness")
    assert found <= measured(layer, camera, "thickness") <= 4 * found


@pytest.mark.parametrize("tolerance", [0.05, 5e-3])
def test_planned_slabs_keep_within_their_share(rng, tolerance):
    layer = Layer(rng.uniform(size=(40, 50)), 3.0, (2.0, 2.4), thickness_mm=8.0)
    scene, camera = Scene([layer]), window(3, (16, 20))
    plan = plan_effects(scene, camera, tolerance)
    (slabs,) = plan.slabs
    one, other = (
        render_plan(scene, camera, replace(plan, slabs=(count,))).views.astype(float)
        for count in (slabs, 8 * slabs)
    )
    assert slabs > 1
    assert np.abs(one - other).max() <= SLICING_SHARE * tolerance * other.max()


def test_more_parts_err_less(rng):
    layer = flame(rng, 8.0)
    bounds = bound_scene(Scene([layer]), window(chromatic_shift=5e-3))
    for band in (False, True):
        probes = Probes(bounds, layer, band)
        errors = [probes.error(parts) for parts in (1, 2, 4, 16)]
        assert np.all(np.diff(errors) < 0)
        assert errors[-1] < errors[0] / 16
