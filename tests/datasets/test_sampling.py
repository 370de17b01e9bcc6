"""Scenes are drawn, simulated and refocused: by rays, in closed form, or directly."""

from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest

from lf_flame import Scene, Sensor, render
from lf_flame.datasets.config import read_config
from lf_flame.datasets.encodings import InputEncoding
from lf_flame.datasets.making import make_dataset
from lf_flame.datasets.sampling import (
    draw_sample,
    render_drawn,
    render_sample,
    search_slopes,
    simulate_sample,
)
from lf_flame.datasets.store import Dataset
from lf_flame.refocus import shift_and_sum
from lf_flame.simulation import rendering

DATA_GEN = Path(__file__).parents[2] / "data_gen"


@pytest.mark.slow
def test_slopes_found_are_the_geometrys():
    """As through the paper's camera, with fewer views: pixels as large, and the same aperture."""
    config = read_config(DATA_GEN / "flames.toml")
    config = replace(config, camera=replace(config.camera, views=3))
    found = [search.slope for search in search_slopes(config)]
    np.testing.assert_allclose(found, config.camera.depth_to_slope(config.depths_mm), atol=0.003)


@pytest.mark.slow
def test_each_object_is_searched_where_it_is(tiny):
    """All lenslets that it lights in the central view, and a few around them, up to the edges."""
    scene, _ = tiny.draw(None)
    for layer, search, whole in zip(
        scene.layers, search_slopes(tiny), search_slopes(tiny, whole_range=True), strict=True
    ):
        assert search.slope == pytest.approx(whole.slope, abs=5e-5)
        lit = render(Scene([layer]), tiny.camera).views[2, 2] > 0
        for axis, length in enumerate(tiny.camera.lenslets):
            places = np.flatnonzero(lit.any(axis=1 - axis))
            first, end = search.region[2 * axis : 2 * axis + 2]
            assert first == 0 or 3 <= places[0] - first <= 9
            assert end == length or 3 <= end - 1 - places[-1] <= 9


@pytest.mark.parametrize("kind", ["raw", "central", "views", "grid"])
def test_direct_images_are_those_of_the_light_field(tiny, kind):
    config = replace(tiny, input=InputEncoding(kind), shuffled_depths=True)
    with patch.object(rendering, "render_plan", wraps=rendering.render_plan) as rendered:
        direct = simulate_sample(config, [-0.7, 0.7], 1)
        assert rendered.call_count == 0
    exact = simulate_sample(replace(config, route="exact"), [-0.7, 0.7], 1)
    for name in ("input", "target"):
        np.testing.assert_allclose(direct[name], exact[name], rtol=0, atol=1e-6)


def test_shuffled_depths_are_those_of_the_scene(tiny):
    config, orders = replace(tiny, shuffled_depths=True), set()
    for index in range(8):
        scene, parameters = draw_sample(config, index)
        depths = tuple(parameters["depth_mm"])
        assert depths == tuple(layer.depth_mm for layer in scene.layers)
        orders.add(depths)
    assert orders == {(10.0, -10.0), (-10.0, 10.0)}


def test_targets_are_means_of_the_refocused_light_field(tiny):
    """Also with noise, which is drawn for every pixel of the raw image and needs a light field."""
    for sensor in (None, Sensor(100.0)):
        config = replace(tiny, camera=replace(tiny.camera, sensor=sensor))
        sample, (light_field, _) = simulate_sample(config, [0.3], 1), render_sample(config, 1)
        assert ("shot_noise" in config.plan.not_separable) == (sensor is not None)
        np.testing.assert_allclose(sample["input"], config.encode(light_field), atol=1e-6)
        blocks = shift_and_sum(light_field, 0.3).reshape(1, 8, 3, 12, 3).mean(axis=(2, 4))
        np.testing.assert_allclose(sample["target"], np.clip(blocks, 0, 1), atol=1e-6)
    scene, _ = config.draw(None)
    one, other = (render_drawn(scene, config, config.plan, index).views for index in (0, 1))
    assert np.abs(one - other).mean() > 1e-3


@pytest.mark.slow
def test_traced_rays_give_the_direct_images(tiny, tmp_path):
    """As many rays as the mean scene needs are traced for every sample."""
    with patch.object(rendering, "render_plan", wraps=rendering.render_plan) as rendered:
        make_dataset(replace(tiny, route="rays"), 3, tmp_path / "rays.zarr")
    make_dataset(tiny, 3, tmp_path / "direct.zarr")
    traced, direct = (Dataset(tmp_path / f"{name}.zarr") for name in ("rays", "direct"))
    rays = traced.attrs["rays"]
    assert rays >= 2
    assert direct.attrs["rays"] is None
    plans = [call.args[2] for call in rendered.call_args_list]
    assert [plan.rays for plan in plans[-3:]] == [rays] * 3
    error = np.square(traced.targets - direct.targets).mean(axis=(2, 3))
    assert 0 < np.sqrt(error.max()) < 3e-3  # 50 dB below white
    np.testing.assert_allclose(traced.attrs["slopes"], direct.attrs["slopes"], atol=0.01)


@pytest.fixture
def opaque(tiny):
    """Opaque shapes at two depths, of which one hides the other in some samples only."""
    objects = [
        replace(one, size_mm=(4.0, 4.0), centre_mm=(0.0, np.sign(one.centre_mm[1]) * 4.75))
        for one in tiny.template.objects
    ]
    coarse = {"views": 3, "lenslets": (16, 24), "lenslet_pitch_mm": 0.84}
    template = replace(tiny.template, opaque=True, position_mm=3.0, size=0.3, objects=objects)
    return replace(tiny, camera=replace(tiny.camera, **coarse), template=template)


def overlap(scene, camera):
    """Whether a ray meets both shapes' boxes, and whether none does, by similar triangles."""
    boxes = []
    for layer in scene.layers:
        distance = camera.focus_distance_mm + layer.depth_mm
        spread = camera.aperture_mm / 2 * abs(layer.depth_mm) / camera.focus_distance_mm + 0.5
        middle, half = np.array(layer.centre_mm), np.array(layer.size_mm) / 2
        boxes.append(((middle - half) / distance, (middle + half) / distance, spread / distance))
    (low, high, blur), (other_low, other_high, other_blur) = boxes
    gap = np.max([low - other_high, other_low - high])
    return gap < 0, gap > blur + other_blur


@pytest.mark.slow
def test_occlusion_is_simulated_in_the_samples_that_have_it(opaque, tiny):
    assert tiny.plan_of(tiny.draw(np.random.default_rng(1))[0]) is tiny.plan
    occluded = []
    for index in range(8):
        scene, _ = opaque.draw(np.random.default_rng([opaque.seed, index]))
        occluded.append("occlusion" in opaque.plan_of(scene).kept)
        certainly, certainly_not = overlap(scene, opaque.camera)
        assert certainly <= occluded[-1] <= (not certainly_not)
    for index in (occluded.index(False), occluded.index(True)):
        scene, _ = opaque.draw(np.random.default_rng([opaque.seed, index]))
        expected = opaque.encode(render(scene, opaque.camera))
        shown = simulate_sample(opaque, [0.0], index)["input"]
        np.testing.assert_allclose(shown, expected, atol=1e-6)
