import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lf_flame import InputError, LightField
from lf_flame.refocus import align_views, alignment, shift_and_sum

EVERY = [(v, u) for v in range(3) for u in range(4)]


@given(
    slope=st.floats(-40, 40),
    dtype=st.sampled_from(["uint8", "uint16", "float32", "float64"]),
    channels=st.sampled_from([(), (1,), (3,)]),
    seed=st.integers(0, 2**32 - 1),
)
@settings(max_examples=25, deadline=None)
def test_mean_of_aligned_views_is_shift_and_sum(slope, dtype, channels, seed):
    views = np.random.default_rng(seed).uniform(0, 200, (3, 4, 8, 18, *channels)).astype(dtype)
    aligned = align_views(views, [slope, 0.5], EVERY)
    assert aligned.dtype == np.float32
    expected = shift_and_sum(views.astype(np.float32), [slope, 0.5])
    np.testing.assert_allclose(aligned.mean(axis=1), expected, rtol=0, atol=1e-4)


@pytest.mark.parametrize("block", [(1, 1), (2, 3), (8, 18)])
def test_blocks_average_what_was_shifted(block, rng):
    views = rng.uniform(size=(3, 4, 8, 18)).astype(np.float32)
    whole = align_views(views, [1.3, -0.4], EVERY)
    cells = whole.reshape(2, 12, 8 // block[0], block[0], 18 // block[1], block[1])
    found = align_views(views, [1.3, -0.4], EVERY, block=block)
    np.testing.assert_allclose(found, cells.mean(axis=(3, 5)), atol=1e-6)


def test_a_single_view_is_moved_by_the_slope_times_its_distance_from_the_middle():
    views = np.zeros((3, 3, 9, 9), np.float32)
    views[0, 2, 4, 4] = 1
    aligned = align_views(views, 2.0, [(0, 2)])[0]
    assert aligned[6, 2] == 1
    assert aligned.sum() == 1


def test_views_that_are_not_chosen_are_neither_read_nor_copied(rng):
    views = rng.uniform(size=(3, 3, 8, 9)).astype(np.float32)
    whole = align_views(views, 0.7, [(0, 0), (2, 1)])
    views[1] = np.nan
    np.testing.assert_array_equal(align_views(views, 0.7, [(0, 0), (2, 1)]), whole)
    with pytest.raises(InputError, match="must be finite, got 72 NaN"):
        align_views(views, 0.7, [(1, 1)])


def test_float32_views_are_handed_to_the_kernel_as_they_are(rng, monkeypatch):
    seen = []
    kernel = alignment._align_in_blocks
    monkeypatch.setattr(alignment, "_align_in_blocks", lambda *a: (seen.append(a[0]), kernel(*a)))
    for dtype in (np.float32, np.float64):
        views = rng.uniform(size=(3, 3, 8, 9)).astype(dtype)
        align_views(views, 0.7, [(2, 0), (1, 1)])
        assert np.shares_memory(seen[-1], views) == (dtype == np.float32)
        assert seen[-1].dtype == np.float32


def test_layouts_in_memory_give_the_same(rng):
    views = rng.uniform(size=(3, 3, 8, 9)).astype(np.float32)
    expected = align_views(views, 0.7, [(2, 0)])
    np.testing.assert_array_equal(align_views(LightField(views), 0.7, [(2, 0)]), expected)
    turned = views.transpose(3, 2, 1, 0).copy().transpose(3, 2, 1, 0)
    np.testing.assert_array_equal(align_views(turned, 0.7, [(2, 0)]), expected)
