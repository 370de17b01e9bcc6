import numpy as np
import pytest

from lf_flame.refocus import find_sharpest_slope, shift_and_sum
from lf_flame.scenes.dead_leaves import DeadLeaves

VIEWS, IMAGE = (5, 5), (40, 60)


@pytest.mark.parametrize("slope", [-1.3, 0.0, 0.8])
def test_leaves_at_one_slope_are_sharp_there(slope, rng):
    """All views are one picture moved by the slope, so refocusing there gives it back."""
    leaves = DeadLeaves(slopes=(slope, slope))
    light_field = leaves.draw(VIEWS, IMAGE, rng)
    assert find_sharpest_slope(light_field).slope == pytest.approx(slope, abs=0.05)
    inner = (slice(4, -4), slice(4, -4))
    sharp = shift_and_sum(light_field, slope)[inner]
    assert np.abs(sharp - light_field.views[2, 2][inner]).mean() < 0.02


def test_whole_slopes_move_leaves_by_whole_pixels_exactly(rng):
    views = DeadLeaves(slopes=(1, 1)).draw(VIEWS, IMAGE, rng).views
    np.testing.assert_allclose(views[3, 1, 1:, :-1], views[2, 2, :-1, 1:], atol=1e-6)
    assert 0 <= views.min() < views.max() <= 1


def test_the_nearer_leaf_hides_the_farther_one():
    """A lower slope is nearer: in front of the focal plane."""

    class TwoLeaves(DeadLeaves):
        def _draw_leaves(self, image, rng):
            leaves = super()._draw_leaves(image, rng)
            same = {"y": 20, "x": 20, "half_height": 15, "half_width": 15, "contrast": 0}
            return leaves._replace(**{name: np.full(2, float(x)) for name, x in same.items()})

    drawn = TwoLeaves(leaves=2, slopes=(-1, 1))
    leaves = drawn._draw_leaves(IMAGE, np.random.default_rng(5))
    middle = drawn.draw(VIEWS, IMAGE, np.random.default_rng(5)).views[2, 2, 20, 20]
    assert leaves.slope[0] < leaves.slope[1]
    assert middle == pytest.approx(leaves.brightness[0], abs=1e-6)


def test_lengths_are_as_frequent_as_their_inverse_cube(rng):
    lengths = DeadLeaves(leaves=200_000, smallest=4, largest=60)._draw_lengths(rng)
    assert lengths.min() >= 4
    assert lengths.max() <= 60
    expected = (4**-2 - 8**-2) / (4**-2 - 60**-2)
    assert np.mean(lengths < 8) == pytest.approx(expected, abs=0.005)
