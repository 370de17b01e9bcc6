"""The Fourier methods of refocusing, against the spatial one and against what they must do."""

import numpy as np
import pytest

from lf_flame.refocus import fourier_refocus, fourier_slice, refocus, shift_and_sum

SLOPES = [0.7, -2.2, 1.0, 0.0, 1e-300]


def sinc_shift(shift, length):
    """Matrix that shifts a periodic line by the interpolation between its samples.

    Of an odd length the kernel is sin(pi x) / (n sin(pi x / n)). Of an even one the wave of the
    Nyquist frequency is taken half as positive and half as negative: a tangent for the sine.
    """
    x = np.arange(length)[:, None] + shift - np.arange(length)
    x = np.where(np.abs(x / length - np.rint(x / length)) < 1e-12, 1e-9, x)
    divisor = np.tan(np.pi * x / length) if length % 2 == 0 else np.sin(np.pi * x / length)
    return np.sin(np.pi * x) / (length * divisor)


@pytest.mark.parametrize("size", [(8, 10), (8, 9), (7, 10), (7, 9)])
@pytest.mark.parametrize("slope", [0.37, 0.5, 1.0, -2.25])
def test_fourier_equals_the_sinc_kernel_in_space(slope, size, rng):
    """On noise, which has all waves, those of the Nyquist rows and columns of even sizes too."""
    views = rng.uniform(size=(3, 4, *size)).astype(np.float32)
    expected = np.mean(
        [
            sinc_shift(slope * (v - 1), size[0])
            @ views[v, u]
            @ sinc_shift(slope * (u - 1.5), size[1]).T
            for v, u in np.ndindex(3, 4)
        ],
        axis=0,
    )
    np.testing.assert_allclose(fourier_refocus(views, slope), expected, atol=1e-6)
    np.testing.assert_allclose(fourier_slice(views, slope, width=8), expected, atol=2e-6)


@pytest.mark.parametrize("interpolation", ["nearest", "linear", "cubic"])
@pytest.mark.parametrize("shape", [(3, 4, 21, 18), (1, 5, 8, 40), (2, 3, 6, 7, 3)])
def test_fourier_equals_space_for_every_interpolation(interpolation, shape, rng):
    """Edges as well, up to slopes that shift the views out of the image."""
    views = rng.uniform(size=shape).astype(np.float32)
    weights = rng.uniform(size=shape[:2])
    slopes = [*SLOPES, 8.5, -60.0]
    expected = shift_and_sum(views, slopes, interpolation=interpolation, weights=weights)
    found = fourier_refocus(
        views, slopes, interpolation=interpolation, edges="clamp", weights=weights
    )
    assert np.abs(found - expected).max() <= 1e-6


@pytest.mark.parametrize(("width", "error"), [(2, 3e-1), (4, 1e-3), (6, 2e-5), (8, 1e-6)])
@pytest.mark.parametrize("shape", [(5, 5, 32, 40), (4, 7, 31, 32), (6, 3, 20, 27, 2), (1, 1, 9, 8)])
def test_slices_are_off_by_no_more_than_stated(width, error, shape, rng):
    """Even and odd numbers of views, lines and columns: each has a Nyquist case of its own."""
    views = rng.uniform(size=shape).astype(np.float32)
    weights = rng.uniform(size=shape[:2])
    for edges in ("wrap", "clamp"):
        exact = fourier_refocus(views, SLOPES, edges=edges, weights=weights)
        found = fourier_slice(views, SLOPES, width=width, edges=edges, weights=weights)
        assert np.abs(found - exact).max() <= error
    if min(shape[:2]) > 1 and width < 6:
        assert np.abs(found - exact).max() > error / 100  # the statement is not idle


def test_refocus_gives_the_same_picture_by_every_method(rng):
    views = rng.uniform(size=(4, 3, 20, 24)).astype(np.float32)
    for interpolation in ("nearest", "linear", "cubic"):
        plain = refocus(views, SLOPES, interpolation=interpolation)
        np.testing.assert_array_equal(
            plain, shift_and_sum(views, SLOPES, interpolation=interpolation)
        )
        other = refocus(views, SLOPES, interpolation=interpolation, method="fourier")
        np.testing.assert_allclose(other, plain, atol=1e-6)
    exact = refocus(views, SLOPES, interpolation="sinc")
    np.testing.assert_allclose(
        refocus(views, SLOPES, interpolation="sinc", method="slice"), exact, atol=1e-6
    )
