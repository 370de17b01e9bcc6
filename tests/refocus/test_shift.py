import numpy as np
import pytest
import reference
from hypothesis import given, settings
from hypothesis import strategies as st

from lf_flame import InputError, LightField
from lf_flame._common.threads import one_thread
from lf_flame.refocus import (
    _kernels,
    align_views,
    fourier_refocus,
    refocus_surface,
    shift,
    shift_and_sum,
)

SHAPES = st.tuples(*[st.integers(1, n) for n in (4, 9, 9, 24)])
TYPES = st.sampled_from(["uint8", "float32", "float64", ">f4"])


@st.composite
def light_fields(draw, shapes=SHAPES, types=TYPES):
    """Views of some types, and of any layout in memory: transposed, sliced, reversed."""
    shape, dtype = draw(shapes), np.dtype(draw(types))
    stride = draw(st.tuples(*[st.sampled_from([1, 2, -1])] * 4))
    order = draw(st.permutations(range(4)))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    whole = np.empty([shape[i] * abs(stride[i]) for i in order])
    values = rng.uniform(size=whole.shape) * (1 if dtype.kind == "f" else 250)
    return values.astype(dtype).transpose(np.argsort(order))[
        tuple(slice(None, None, k) for k in stride)
    ]


@pytest.mark.slow
@given(
    views=light_fields(),
    slope=st.one_of(st.floats(-30, 30), st.integers(-8, 8).map(lambda k: k / 4)),
    interpolation=st.sampled_from(["nearest", "linear", "cubic"]),
    seed=st.none() | st.integers(0, 2**32 - 1),
)
@settings(max_examples=30, deadline=None)
def test_shift_and_sum_equals_its_plain_twin(views, slope, interpolation, seed):
    """Type, strides, shape, weights, slope and interpolation at random."""
    weights = None
    if seed is not None:
        weights = np.random.default_rng(seed).uniform(size=views.shape[:2])
        weights[weights < 0.3] = 0
        weights[-1, -1] = 1
    slope = np.rint(slope * 2**20) / 2**20  # so that both round halves alike
    expected = reference.shift_and_sum(views, slope, interpolation, weights)
    found = shift_and_sum(views, [0.3, slope], interpolation=interpolation, weights=weights)[1]
    assert found.dtype == np.float32
    assert np.abs(found - expected).max() <= 1e-6 * np.abs(views.astype(float)).max()


def test_more_slopes_than_share_a_reading(rng):
    views = rng.uniform(size=(3, 4, 7, 50)).astype(np.float32)
    slopes = np.linspace(-2, 2, 19)
    stack = shift_and_sum(views, slopes)
    for image, slope in zip(stack, slopes, strict=True):
        np.testing.assert_array_equal(image, shift_and_sum(views, slope))


def test_views_of_8_and_16_bits_are_not_copied(rng, monkeypatch):
    """The kernel is handed the very array, also that of a raw lenslet image."""
    seen = []
    monkeypatch.setattr(_kernels, "sum_bands", lambda views, *others: seen.append(views))
    monkeypatch.setattr(shift, "refuse_infinite", lambda *images: None)  # the image stays empty
    for dtype in ("uint8", "uint16", "float32", "float64"):
        views = rng.integers(0, 200, size=(2, 3, 8, 9)).astype(dtype)
        for some in (views, views.transpose(2, 0, 3, 1).copy().transpose(1, 3, 0, 2)):
            shift_and_sum(some, 0.5)
            assert np.shares_memory(seen.pop(), some)


@pytest.mark.slow
def test_a_raw_image_gives_the_bits_of_its_views_on_any_number_of_threads(rng):
    """Read-only, 4 x 3 pixels under a lenslet; the last slopes shift views out of the image."""
    raw = rng.integers(0, 4000, size=(11 * 4, 7 * 3)).astype(np.uint16)
    raw.flags.writeable = False
    views = raw.reshape(11, 4, 7, 3).transpose(1, 3, 0, 2)
    slopes = [0.0, 1.3, -2.28, 5.5, -40.0]
    expected = [reference.shift_and_sum(views, slope) for slope in slopes]
    found = [shift_and_sum(views, slopes), shift_and_sum(views.copy(), slopes)]
    with one_thread():
        found += [shift_and_sum(views, slopes), shift_and_sum(views.copy(), slopes)]
    np.testing.assert_allclose(found[0], expected, rtol=3e-7)
    for image in found[1:]:
        np.testing.assert_array_equal(image, found[0])


def test_views_of_weight_0_are_not_read(rng):
    """Not even where they are not finite."""
    views = rng.uniform(size=(3, 3, 8, 9)).astype(np.float32)
    weights = np.ones((3, 3))
    weights[0, 1] = 0
    whole = shift_and_sum(views, 0.7, weights=weights)
    views[0, 1] = np.nan
    np.testing.assert_array_equal(shift_and_sum(views, 0.7, weights=weights), whole)
    with pytest.raises(InputError, match="must be finite, got 72 NaN"):
        shift_and_sum(views, 0.7)


def test_colour_is_refocused_channel_by_channel(rng):
    views = rng.uniform(size=(3, 3, 8, 9, 3)).astype(np.float32)
    for refocus in (shift_and_sum, fourier_refocus):
        stack = refocus(LightField(views), [0.5])
        assert stack.shape == (1, 8, 9, 3)
        np.testing.assert_array_equal(stack[..., 1], refocus(views[..., 1], [0.5]))


@pytest.mark.parametrize("slope", [1.0, -1.0, 3.0])
def test_nearest_rounds_halves_up(slope, rng):
    """Two views a side stand half a view step off the centre: at -1/2 and 1/2, read 0 and 1."""
    views = rng.uniform(size=(2, 2, 9, 10)).astype(np.float32)
    first, second = (int((slope * sign + 1) // 2) for sign in (-1, 1))
    expected = np.mean(
        [
            views[v, u][3 + t : 6 + t, 3 + s : 7 + s]
            for v, t in ((0, first), (1, second))
            for u, s in ((0, first), (1, second))
        ],
        axis=0,
    )
    inside = (slice(3, 6), slice(3, 7))
    for found in (
        shift_and_sum(views, slope, interpolation="nearest"),
        fourier_refocus(views, slope, interpolation="nearest", edges="clamp"),
        refocus_surface(views, np.full((9, 10), slope), interpolation="nearest"),
    ):
        np.testing.assert_allclose(found[inside], expected, atol=1e-6)


def test_aligned_views_have_shift_and_sum_as_their_mean_and_are_averaged_over_blocks(rng):
    views = rng.uniform(0, 200, (3, 4, 8, 18, 3)).astype(np.uint8)
    every, slopes = list(np.ndindex(3, 4)), [1.3, -9.4]
    aligned = align_views(views, slopes, every)
    assert aligned.dtype == np.float32
    np.testing.assert_allclose(aligned.mean(axis=1), shift_and_sum(views, slopes), atol=1e-4)
    cells = aligned.reshape(2, 12, 4, 2, 6, 3, 3).mean(axis=(3, 5))
    found = align_views(views, slopes, every[:3], block=(2, 3))
    np.testing.assert_allclose(found, cells[:, :3], rtol=1e-5)


def test_a_view_is_moved_by_the_slope_times_its_distance_from_the_middle():
    """Views that are not chosen are not read."""
    views = np.full((3, 3, 9, 9), np.nan, np.float32)
    views[0, 2], views[0, 2, 4, 4] = 0, 1
    aligned = align_views(views, 2.0, [(0, 2)])[0]
    assert aligned[6, 2] == aligned.sum() == 1
    with pytest.raises(InputError, match="must be finite"):
        align_views(views, 2.0, [(1, 1)])


def test_the_package_refocuses_when_called(rng):
    import lf_flame

    views = rng.uniform(size=(3, 3, 10, 12)).astype(np.float32)
    image = lf_flame.refocus(views, 1.0)
    np.testing.assert_array_equal(image, lf_flame.refocus.refocus(views, 1.0))
    assert repr(lf_flame.all_in_focus(views, [-1, 0, 1])).startswith("FocusMap(slopes ")
