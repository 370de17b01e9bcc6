import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import KERNELS

from lf_flame import LightField
from lf_flame.refocus import shift_and_sum
from lf_flame.refocus.surface import refocus_surface, region_slopes


def twin(views, slopes, interpolation, weights):
    """Pixel by pixel and view by view, from the definition."""
    rows, columns, height, width = views.shape
    out = np.zeros((height, width))
    for t, s in np.ndindex(height, width):
        for v, u in np.ndindex(rows, columns):
            shift = slopes[t, s] * np.array([v - (rows - 1) / 2, u - (columns - 1) / 2])
            if interpolation == "nearest":
                near = np.array([t, s]) + np.floor(shift + 0.5)
                value = views[v, u][tuple(np.clip(near, 0, [height - 1, width - 1]).astype(int))]
            else:
                place = np.array([t, s]) + shift
                i, j = np.floor(place).astype(int)[:, None] + np.arange(-1, 3)
                near = views[v, u][
                    np.ix_(np.clip(i, 0, height - 1), np.clip(j, 0, width - 1))
                ].astype(float)
                kernel = KERNELS[interpolation]
                value = kernel(place[0] - i) @ near @ kernel(place[1] - j)
            out[t, s] += weights[v, u] * value
    return out / weights.sum()


shapes = st.tuples(*[st.integers(1, n) for n in (3, 4, 6, 7)])
interpolations = st.sampled_from(["nearest", "linear", "cubic"])
seeds = st.integers(0, 2**32 - 1)


@given(shape=shapes, interpolation=interpolations, reach=st.floats(0, 12), seed=seeds)
@settings(max_examples=40, deadline=None)
def test_a_surface_equals_its_plain_twin(shape, interpolation, reach, seed):
    rng = np.random.default_rng(seed)
    views = rng.uniform(size=shape).astype(np.float32)
    slopes = rng.uniform(-reach, reach, size=shape[2:])
    weights = rng.integers(0, 3, size=shape[:2]) + np.eye(*shape[:2])
    found = refocus_surface(views, slopes, interpolation=interpolation, weights=weights)
    expected = twin(views, slopes, interpolation, weights)
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-6)


def test_several_maps_and_colour_keep_their_order(rng):
    views = rng.uniform(size=(3, 3, 8, 9, 3)).astype(np.float32)
    slopes = rng.uniform(-2, 2, size=(2, 8, 9))
    stack = refocus_surface(LightField(views), slopes)
    assert stack.shape == (2, 8, 9, 3)
    assert stack.dtype == np.float32
    np.testing.assert_array_equal(stack[1, ..., 2], refocus_surface(views[..., 2], slopes[1]))


def test_views_without_weight_are_not_read(rng):
    views = rng.uniform(size=(3, 3, 8, 9)).astype(np.float32)
    views[0, 0] = np.nan
    weights = np.ones((3, 3))
    weights[0, 0] = 0
    assert np.isfinite(refocus_surface(views, np.zeros((8, 9)), weights=weights)).all()
    only = refocus_surface(
        views, np.full((8, 9), 1.7), weights=np.eye(3)[1] * np.eye(3)[1][:, None]
    )
    np.testing.assert_array_equal(only, views[1, 1])


def test_regions_are_refocused_at_their_slopes(rng):
    views = rng.uniform(size=(3, 3, 20, 24)).astype(np.float32)
    regions = [((2, 9, 1, 12), 1.2), ((10, 18, 13, 22), -0.7)]
    slopes = region_slopes((20, 24), regions, background=-3.0)
    found = refocus_surface(views, slopes)
    stack = shift_and_sum(views, [1.2, -0.7, -3.0])
    np.testing.assert_allclose(found[2:9, 1:12], stack[0, 2:9, 1:12], rtol=1e-6)
    np.testing.assert_allclose(found[10:18, 13:22], stack[1, 10:18, 13:22], rtol=1e-6)
    np.testing.assert_allclose(found[:2], stack[2, :2], rtol=1e-6)


def test_later_regions_lie_over_earlier_ones_and_seams_soften():
    regions = [((0, 20, 0, 10), 1.0), ((5, 15, 5, 15), 2.0)]
    hard = region_slopes((20, 40), regions, background=0.0)
    assert hard[10, 7] == 2.0
    soft = region_slopes((20, 40), regions, background=0.0, soften=2.0)
    assert np.abs(np.diff(soft, axis=1)).max() < 0.5 < np.abs(np.diff(hard, axis=1)).max()
    np.testing.assert_allclose(soft[:, -1], 0, atol=1e-6)


@pytest.mark.parametrize("side", [1, 11, 30])
def test_a_softened_region_keeps_its_slope(side):
    soft = region_slopes(
        (60, 60), [((20, 20 + side, 20, 20 + side), 1.0)], background=-2.0, soften=5.0
    )
    np.testing.assert_allclose(soft[20 : 20 + side, 20 : 20 + side], 1.0)
    assert np.abs(np.diff(soft, axis=0)).max() < 0.5
    np.testing.assert_allclose(soft[:6], -2.0)  # twice 7 away


@pytest.mark.parametrize("later", [1.0, -1.0])
def test_the_seam_of_two_regions_lies_between_them(later):
    """Half the image each, at opposite slopes: the softened map is odd about their border."""
    regions = [((0, 40, 0, 20), -later), ((0, 40, 20, 40), later)]
    soft = region_slopes((40, 40), regions, background=3.0, soften=4.0)
    np.testing.assert_allclose(soft, -soft[:, ::-1], atol=1e-12)
    assert soft[20, 30] == pytest.approx(later)
