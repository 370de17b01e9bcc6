import numpy as np
import pytest
import reference
from hypothesis import given, settings
from hypothesis import strategies as st

from lf_flame import InputError, Layer, LightField, PlenopticCamera, Scene, render
from lf_flame.refocus import find_sharpest_slope, fourier_refocus, shift_and_sum


@given(
    shape=st.tuples(*[st.integers(1, n) for n in (4, 4, 9, 9)]),
    slope=st.floats(-30, 30),
    seed=st.integers(0, 2**32 - 1),
)
@settings(max_examples=60, deadline=None)
def test_shift_and_sum_equals_its_plain_twin(shape, slope, seed):
    views = np.random.default_rng(seed).uniform(size=shape).astype(np.float32)
    expected = reference.shift_and_sum(views, slope)
    np.testing.assert_allclose(shift_and_sum(views, slope)[0], expected, rtol=1e-6, atol=1e-7)


def test_whole_slope_equals_shifted_copies(rng):
    views = rng.uniform(size=(3, 5, 20, 24)).astype(np.float32)
    rolled = [
        np.roll(views[v, u], (-2 * (v - 1), -2 * (u - 2)), axis=(0, 1))
        for v in range(3)
        for u in range(5)
    ]
    inside = (slice(2, -2), slice(4, -4))
    found = shift_and_sum(views, 2.0)[0]
    np.testing.assert_allclose(found[inside], np.mean(rolled, axis=0)[inside], rtol=1e-6)


def test_slope_zero_is_the_plain_mean(rng):
    views = rng.uniform(size=(4, 4, 6, 7)).astype(np.float32)
    np.testing.assert_allclose(shift_and_sum(views, 0)[0], views.mean(axis=(0, 1)), rtol=1e-6)


def test_constant_light_field_keeps_its_value():
    views = np.full((5, 5, 12, 11), 0.3, np.float32)
    np.testing.assert_allclose(shift_and_sum(views, [-1.3, 0.4, 2]), 0.3, rtol=1e-7)
    np.testing.assert_allclose(fourier_refocus(views, [-1.3, 0.4, 2]), 0.3, rtol=1e-6)


def test_flux_of_a_bounded_object_is_kept():
    views = np.zeros((5, 5, 40, 40), np.float32)
    views[:, :, 15:25, 18:22] = 1
    for refocus in (shift_and_sum, fourier_refocus):
        np.testing.assert_allclose(refocus(views, [0.7, -1.9]).sum(axis=(1, 2)), 40, rtol=1e-5)


def test_slopes_come_out_in_the_order_asked_for(rng):
    views = rng.uniform(size=(3, 3, 8, 8)).astype(np.float32)
    stack = shift_and_sum(views, [1.5, -0.5])
    assert stack.shape == (2, 8, 8)
    assert stack.dtype == np.float32
    np.testing.assert_array_equal(stack[1], shift_and_sum(views, -0.5)[0])


def test_colour_is_refocused_channel_by_channel(rng):
    views = rng.uniform(size=(3, 3, 8, 9, 3)).astype(np.float32)
    for refocus in (shift_and_sum, fourier_refocus):
        stack = refocus(LightField(views), [0.5])
        assert stack.shape == (1, 8, 9, 3)
        np.testing.assert_array_equal(stack[..., 1], refocus(views[..., 1], [0.5]))


def test_inputs_of_other_types_and_strides_are_read(rng):
    views = rng.integers(0, 255, size=(3, 3, 16, 9), dtype=np.uint8)
    plain = shift_and_sum(views.astype(np.float32), 0.6)
    np.testing.assert_array_equal(shift_and_sum(views, 0.6), plain)
    strided = np.asfortranarray(views.astype(np.float64))
    strided.flags.writeable = False
    np.testing.assert_array_equal(shift_and_sum(strided, 0.6), plain)


def test_nearest_rounds_each_shift(rng):
    views = rng.uniform(size=(3, 3, 10, 10)).astype(np.float32)
    rounded = shift_and_sum(views, 0.7, interpolation="nearest")  # shifts -0.7, 0, 0.7
    np.testing.assert_array_equal(rounded, shift_and_sum(views, 1.0))


def test_fourier_equals_space_for_whole_slopes(rng):
    views = np.zeros((5, 5, 30, 31), np.float32)
    views[:, :, 12:18, 12:18] = rng.uniform(size=(5, 5, 6, 6))
    np.testing.assert_allclose(
        fourier_refocus(views, [2.0, -1.0]), shift_and_sum(views, [2.0, -1.0]), atol=1e-6
    )


def test_fourier_shift_is_exact_for_band_limited_views():
    """Each view is the same wave, displaced: at its slope the stack is that wave again."""
    slope, n = 0.37, 32
    wave = 2 * np.pi * 3 / n

    def view(v, u):
        t, s = np.arange(n)[:, None], np.arange(n)[None, :]
        return 1 + np.cos(wave * (t - slope * (v - 2))) * np.cos(wave * (s - slope * (u - 2)))

    views = np.array([[view(v, u) for u in range(5)] for v in range(5)])
    np.testing.assert_allclose(fourier_refocus(views, slope)[0], view(2, 2), atol=1e-6)


@pytest.mark.parametrize("depth", [20.0, 10.0, 0.0, -10.0])
def test_a_layer_is_sharpest_at_its_slope(depth, rng):
    camera = PlenopticCamera(150.0, 326.0, 0.4, 0.112, 9, (80, 80))
    scene = Scene([Layer(rng.uniform(size=(9, 9)), depth, (5.0, 5.0))])
    found = find_sharpest_slope(render(scene, camera), np.arange(-100, 101) * 0.05)
    assert found.slope == pytest.approx(camera.depth_to_slope(depth), abs=0.02)


@given(slope=st.floats(-1.4, 1.4), seed=st.integers(0, 2**32 - 1))
@settings(max_examples=10, deadline=None)
def test_search_is_not_drawn_to_whole_slopes(slope, seed):
    """Smooth random pattern, displaced exactly by a planted slope."""
    n = 72
    rng = np.random.default_rng(seed)
    k = np.hypot(np.fft.fftfreq(n)[:, None], np.fft.rfftfreq(n)[None, :])
    spectrum = np.fft.rfft2(rng.normal(size=(n, n))) * np.exp(-((k / 0.12) ** 2))
    ramps = np.fft.fftfreq(n)[:, None], np.fft.rfftfreq(n)[None, :]
    views = np.empty((5, 5, n, n))
    for v in range(5):
        for u in range(5):
            turn = -2j * np.pi * slope * ((v - 2) * ramps[0] + (u - 2) * ramps[1])
            views[v, u] = np.fft.irfft2(spectrum * np.exp(turn), (n, n))
    found = find_sharpest_slope(views, np.arange(-40, 41) * 0.05, region=(16, 56, 16, 56))
    assert found.slope == pytest.approx(slope, abs=0.02)


def test_search_reports_what_it_cannot_find(rng):
    flat = np.ones((3, 3, 16, 16))
    with pytest.raises(InputError, match="No slope is sharpest"):
        find_sharpest_slope(flat * 0)
    views = render(
        Scene([Layer(rng.uniform(size=(5, 5)), 20.0, (2.0, 2.0))]),
        PlenopticCamera(150.0, 326.0, 0.4, 0.112, 5, (40, 40)),
    )
    with pytest.raises(InputError, match="still rises at the end"):
        find_sharpest_slope(views, np.arange(0, 1.01, 0.1))
    with pytest.raises(InputError, match="region must be"):
        find_sharpest_slope(views, region=(0, 50, 0, 10))
    with pytest.raises(InputError, match="equal steps"):
        find_sharpest_slope(views, [0, 1, 3])


@pytest.mark.parametrize(
    ("views", "slopes", "message"),
    [
        (np.ones((3, 3, 4)), 1.0, r"views\[v, u, t, s\]"),
        (np.full((3, 3, 4, 4), np.nan), 1.0, "must be finite, got 144"),
        (np.ones((0, 3, 4, 4)), 1.0, "at least one element"),
        (np.ones((3, 3, 4, 4)), [np.inf], "slopes must be one or more finite"),
        (np.ones((3, 3, 4, 4)), [], "slopes must be one or more finite"),
    ],
)
def test_bad_input_is_refused(views, slopes, message):
    with pytest.raises(InputError, match=message):
        shift_and_sum(views, slopes)
    with pytest.raises(InputError, match=message):
        fourier_refocus(views, slopes)


def test_unknown_interpolation_is_refused():
    with pytest.raises(InputError, match="one of linear, nearest, got 'sinc'"):
        shift_and_sum(np.ones((2, 2, 3, 3)), 0, interpolation="sinc")
