"""Refined slopes against pictures and equations whose solution is known.

Tests of whole maps, which come nearer to the truth by it, are in test_focus_map.py.
"""

import numpy as np
import pytest

from lf_flame.refocus.matching import ComparedViews
from lf_flame.refocus.refinement import fit_changes, refine_slopes, set_up_equations


@pytest.mark.parametrize("count", [4, 5])
def test_the_equations_lead_from_a_near_slope_to_the_right_one(count):
    """A picture that rises evenly moves by the slope: the first step of the fit is exact."""
    y, x = np.indices((24, 30))
    steps = np.arange(count) - (count - 1) / 2
    views = np.array([[0.3 * (y - 0.7 * v) + 0.2 * (x - 0.7 * u) for u in steps] for v in steps])
    compared = ComparedViews(
        views.astype(np.float32), np.linspace(-1, 1, 11), np.ones((count, count))
    )
    above, below = set_up_equations(compared, np.full((24, 30), 0.68), 0.1)
    inside = (slice(4, -4), slice(4, -4))
    np.testing.assert_allclose((above / below)[inside], 0.02, rtol=1e-3)


def test_a_change_is_the_ratio_of_the_sums_over_pixels_of_the_same_surface(rng):
    """Two surfaces that ask for changes of opposite sign keep them up to their common outline."""
    slope, change = np.zeros((20, 30)), np.full((20, 30), 0.03)
    slope[:, 15:], change[:, 15:] = 1.0, -0.02
    weight = rng.uniform(0.5, 2, slope.shape)
    found = fit_changes(slope, (change * weight, weight), np.ones(slope.shape), 0.1, 1e-9)
    np.testing.assert_allclose(found, change, rtol=1e-9)
    # A change to which nothing points is none, and one far beyond half a step is an outlier.
    nothing = fit_changes(slope, (1e-9 * change, 1e-9 * weight), np.ones(slope.shape), 0.1, 0.1)
    assert np.abs(nothing).max() < 1e-6
    assert not fit_changes(slope, (3 * change * weight, weight), slope, 0.1, 1e-9)[:, :15].any()


def test_after_a_coarse_search_a_change_moves_no_view_by_more_than_a_lenslet():
    """A ramp asks for 0.6, which moves the outermost of five views by 1.2 lenslets."""
    y = np.indices((18, 24))[0]  # with so few pixels no levels of views are looked for
    views = np.array([[0.3 * (y - 0.7 * v)] for v in range(-2, 3)], np.float32)
    compared = ComparedViews(views, np.linspace(-2, 2, 3), np.ones((5, 1)))
    inside = (slice(7, -7), slice(7, -7))
    for slope, refined in ((0.3, 0.7), (0.1, 0.1)):
        found = refine_slopes(compared, np.full((18, 24), slope), np.ones((18, 24)), 0.02)
        np.testing.assert_allclose(found[inside], refined, atol=1e-3)
