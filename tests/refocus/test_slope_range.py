"""The range of slopes, beside scenes whose depths are known."""

from dataclasses import replace

import numpy as np
import pytest

from lf_flame import PAPER_CAMERA, Layer, LightField, Scene, render
from lf_flame.refocus import all_in_focus, find_slope_range
from lf_flame.refocus.focus_map import _certain
from lf_flame.scenes.dead_leaves import DeadLeaves

CAMERA = replace(PAPER_CAMERA, views=9, lenslets=(96, 160))

LEAVES = DeadLeaves(leaves=400, smallest=3.0, largest=30.0, slopes=(0.0, 0.0), contrast=0.2)


def four_cards(rng):
    """Cards with a pattern beside each other, at depths of their own."""
    layers = []
    for k, depth in enumerate(rng.uniform(-14, 18, 4)):
        pattern = LEAVES.draw((1, 1), (60, 100), rng).views[0, 0]
        centre = ((k // 2 - 0.5) * 6.4, (k % 2 - 0.5) * 10.6)
        layers.append(Layer(pattern, depth_mm=depth, size_mm=(6.0, 10.0), centre_mm=centre))
    return Scene(layers)


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "enlarged"), [(0, 1), (3, 3)])
def test_it_reaches_from_the_nearest_to_the_farthest(seed, enlarged):
    """Enlarged views, which are averaged again, have slopes as much larger."""
    scene = four_cards(np.random.default_rng(seed))
    views = render(scene, CAMERA).views.repeat(enlarged, 2).repeat(enlarged, 3)
    slopes = [enlarged * CAMERA.depth_to_slope(x.depth_mm) for x in scene.layers]
    found = find_slope_range(LightField(views))
    assert found.certain
    assert found.low == pytest.approx(min(slopes) - 0.3, abs=0.1 * enlarged)
    assert found.high == pytest.approx(max(slopes) + 0.3, abs=0.1 * enlarged)
    assert found.low < found.slope < found.high


@pytest.mark.slow
@pytest.mark.parametrize("count", [3, 5, 9])
def test_a_single_plane_is_certain_in_its_range(count):
    """Few views distinguish only slopes that lie far apart; the range must hold some."""
    pattern = LEAVES.draw((1, 1), (64, 80), np.random.default_rng(2)).views[0, 0]
    at = np.arange(count) - count // 2
    views = [[np.roll(pattern, (v, u), (0, 1)) for u in at] for v in at]
    found = find_slope_range(LightField(views))
    assert found.low < 1 < found.high
    sure = all_in_focus(views, np.linspace(found.low, found.high, 33)).confidence >= 0.2
    assert sure.mean() > 0.5


@pytest.mark.parametrize("scene", ["flat", "smooth", "noise"])
def test_where_nothing_tells_slopes_apart_it_is_not_certain(rng, scene):
    views = {
        "flat": np.full((5, 5, 40, 60), 0.5),
        "smooth": np.broadcast_to(np.linspace(0.4, 0.6, 60), (5, 5, 40, 60)),
        "noise": rng.uniform(size=(5, 5, 40, 60)),
    }[scene]
    found = find_slope_range(LightField(views))
    assert not found.certain
    assert found.low < found.slope < found.high


@pytest.mark.slow
def test_its_slope_is_one_of_the_scenes(rng):
    """As many tiles on either of two planes; nothing is sharp halfway between."""
    halves = [LEAVES.draw((9, 9), (64, 64), rng).views for _ in range(2)]
    at = np.arange(9) - 4
    views = np.empty((9, 9, 64, 128))
    for v, u in np.ndindex(9, 9):
        for half, sign in ((0, 1), (1, -1)):
            moved = np.roll(halves[half][4, 4], (sign * at[v], sign * at[u]), (0, 1))
            views[v, u, :, 64 * half : 64 * half + 64] = moved
    assert abs(find_slope_range(views).slope) == pytest.approx(1, abs=0.1)


def test_a_tile_that_nobody_agrees_with_counts_only_if_it_is_very_certain():
    slopes = np.array([[1.0, 1.2, 3.0], [1.1, -4.3, 3.0], [-2.0, 1.0, 0.0]])
    confidence = np.array([[0.6, 0.6, 0.6], [0.4, 0.7, 0.6], [0.95, 0.6, 0.1]])
    expected = [[True, True, True], [False, False, True], [True, False, False]]
    np.testing.assert_array_equal(_certain(slopes, confidence), expected)
