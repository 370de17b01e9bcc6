from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage, special

from lf_flame.optics import diffraction
from lf_flame.optics.aperture_response import blur_cells, blur_lines
from lf_flame.optics.diffraction import (
    MOST_ROUND_SAMPLES,
    MOST_SAMPLES,
    blur_raw,
    blur_views,
    round_kernel,
    share_leaving_square,
    square_kernel,
)

KERNELS = {"square": cache(square_kernel), "round": cache(round_kernel)}
any_aperture = pytest.mark.parametrize("kernel", KERNELS.values(), ids=KERNELS)


def square_by_frequency(spread, n):
    """Weights 0 to n - 1 from the transfer function of the square aperture, sample 1."""
    x, weight = special.roots_legendre(1500)
    nu = (1 + x) / 2 / spread
    seen = (1 - nu * spread) * np.sinc(nu) ** 2 * weight / spread
    return seen @ np.cos(2 * np.pi * nu[:, None] * np.arange(n))


def round_by_frequency(spread, n):
    """Weights (0 to n - 1)^2 from the transfer function of the round aperture, sample 1."""
    x, weight = special.roots_legendre(300)
    phi = (1 + x) * np.pi / 4
    q = np.cos(phi)
    transfer = 2 / np.pi * (np.arccos(q) - q * np.sqrt(1 - q**2))
    radial = 4 * (weight * np.pi / 4) ** 2 * np.sin(phi) * q / spread**2 * transfer
    y, x = (np.outer(q, f(phi)).ravel() / spread for f in (np.sin, np.cos))
    waves = [
        np.cos(2 * np.pi * nu[:, None] * np.arange(n)) * np.sinc(nu)[:, None] ** 2 for nu in (y, x)
    ]
    angular = np.outer(radial / weight, weight).ravel()
    return (waves[0] * angular[:, None]).T @ waves[1]


@pytest.mark.parametrize("spread", [0.05, 0.3, 1.0, 7.0, 300.0])
def test_square_kernel_has_the_transfer_function_of_a_square_pupil(spread):
    expected = square_by_frequency(spread, 20)
    kernel = square_kernel(spread, 1.0, tail=0)[MOST_SAMPLES:]
    # what the kernel leaves out beyond its end is shared out, hence relative to the centre
    np.testing.assert_allclose(kernel[:20] / kernel[0], expected / expected[0], atol=1e-10)


@pytest.mark.parametrize("spread", [0.3, 1.0, 7.0])
def test_round_kernel_has_the_transfer_function_of_a_round_pupil(spread):
    expected = round_by_frequency(spread, 6)
    middle = MOST_ROUND_SAMPLES
    kernel = round_kernel(spread, 1.0, tail=0)[middle:, middle:]
    assert len(kernel) == middle + 1
    np.testing.assert_allclose(kernel[:6, :6] / kernel[0, 0], expected / expected[0, 0], atol=3e-8)


@pytest.mark.parametrize("spread", [1e-6, 1e-3, 0.02])
def test_round_kernel_of_a_small_spread_follows_the_light_outside(spread):
    """Far from the centre the pattern falls as spread / (pi^3 r^3) about its rings."""
    kernel = round_kernel(spread, 1.0, tail=0)
    step = np.linspace(-1, 1, 401)
    hat = 1 - np.abs(step)
    far = spread / np.pi**3 / np.hypot(6 + step[:, None], 8 + step) ** 3
    expected = hat @ far @ hat / hat.sum() ** 2
    assert kernel[32 + 6, 32 + 8] == pytest.approx(expected, rel=1e-3, abs=0)


@pytest.mark.slow
@any_aperture
@given(spread=st.floats(0, 32), tail=st.floats(0, 1))
@settings(max_examples=6, deadline=None)
def test_kernels_are_weights(kernel, spread, tail):
    weights = kernel(spread * 0.007, 0.007, tail)
    assert np.sum(weights) == pytest.approx(1, abs=1e-12)
    assert np.all(weights >= 0)
    assert all(n % 2 == 1 for n in weights.shape)
    np.testing.assert_array_equal(weights, np.flip(weights))
    if weights.ndim == 2:
        np.testing.assert_allclose(weights, weights.T, atol=1e-12)
        np.testing.assert_array_equal(weights, weights[::-1])


@pytest.mark.parametrize("spread", [0.05, 0.1, 0.3, 1.0, 7.0])
@pytest.mark.parametrize("round_aperture", [False, True])
def test_a_cell_is_blurred_by_the_transfer_function(spread, round_aperture):
    """A lone cell among dark ones, against weights from the transfer function by quadrature."""
    place = ((-6, 7), (-4, 9))
    cell = np.ones((1, 1))
    found = blur_cells(cell, spread, (1.0, 1.0), round_aperture, place, (1500, 1500))
    if round_aperture:
        quadrant = round_by_frequency(spread, 9)
    else:
        quadrant = np.multiply.outer(*[square_by_frequency(spread, 9)] * 2)
    rows, columns = (np.abs(np.arange(*ends)) for ends in place)
    expected = quadrant[np.ix_(rows, columns)]
    # Airy patterns far smaller than cells are taken along each axis by itself: of what leaves a
    # lone cell that is up to a seventh too much.
    separate = round_aperture and spread < 0.06
    allowed = (1 - quadrant[0, 0]) / 7 if separate else 2e-6 * (1 + spread)
    np.testing.assert_allclose(found, expected, atol=allowed)


@pytest.mark.parametrize("round_aperture", [False, True])
def test_cells_need_not_be_square(rng, round_aperture):
    """Cells of 1 x 2, against the same light on cells of 1 x 1."""
    cells = rng.random((5, 3))
    seen = ((-2, 9), (-1, 5))
    found = blur_cells(cells, 1.3, (1.0, 2.0), round_aperture, seen, (500, 250))
    even = np.repeat(cells, 2, axis=1)
    fine = blur_cells(even, 1.3, (1.0, 1.0), round_aperture, ((-2, 9), (-2, 10)), (500, 500))
    np.testing.assert_allclose(found, fine.reshape(11, 6, 2).mean(axis=2), atol=2e-6)


@pytest.mark.parametrize("spread", [0.05, 1.0, 7.0])
@pytest.mark.parametrize("axis", [0, 1])
def test_lines_go_on_beyond_their_border(rng, spread, axis):
    image = rng.random((6, 7))
    weights = square_by_frequency(spread, 40 if spread < 1 else 400)
    kernel = np.concatenate([weights[:0:-1], weights])
    expected = ndimage.convolve1d(image, kernel, axis, mode="nearest")
    found = blur_lines(image, axis, spread, 1.0)
    np.testing.assert_allclose(found, expected, atol=3e-4 * spread + 2e-4)
    np.testing.assert_allclose(blur_lines(image, axis, 0, 1.0), image, atol=1e-12)


@pytest.mark.parametrize("spread", [0.05, 0.3, 2.0])
def test_share_that_leaves_a_square(spread):
    square = 1 - square_by_frequency(spread, 1)[0] ** 2
    assert share_leaving_square(spread, 1.0, False) == pytest.approx(square, rel=1e-6)
    round_ = 1 - round_by_frequency(spread, 1)[0, 0]
    assert share_leaving_square(2 * spread, 2.0, True) == pytest.approx(round_, rel=1e-4)
    assert share_leaving_square(0.0, 1.0, False) == share_leaving_square(0.0, 1.0, True) == 0


@pytest.mark.parametrize(("spread", "tail"), [(0.3, 1e-2), (0.3, 1e-3), (5.0, 2e-2)])
def test_square_kernel_is_as_short_as_the_tail_allows(spread, tail):
    whole = square_by_frequency(spread, 260)
    left_out = 1 - 2 * np.cumsum(whole) + whole[0]
    half = len(square_kernel(spread, 1.0, tail)) // 2
    assert left_out[half] <= tail < left_out[half - 1]


@pytest.mark.slow
@pytest.mark.parametrize(("spread", "tail"), [(0.3, 3e-2), (1.0, 5e-2)])
def test_round_kernel_is_as_small_as_the_tail_allows(spread, tail):
    whole = round_by_frequency(spread, 9)
    half = len(round_kernel(spread, 1.0, tail)) // 2
    inside = [
        4 * whole[:n, :n].sum() - 4 * whole[0, :n].sum() + whole[0, 0] for n in (half, half + 1)
    ]
    assert inside[0] < 1 - tail <= inside[1]


@any_aperture
@pytest.mark.parametrize("spread", [0.0, 5e-324, 1e-17])
def test_without_spread_nothing_changes(rng, kernel, spread):
    weights = kernel(spread, 0.1, 1e-3)
    np.testing.assert_array_equal(weights, np.ones(weights.shape))
    assert weights.size == 1
    image = rng.random((7, 9), np.float32)
    np.testing.assert_array_equal(blur_raw(image, weights), image)


@any_aperture
@pytest.mark.parametrize("level", [0.0, 0.1, 1e30, -3.0])
def test_uniform_image_stays_uniform(kernel, level):
    image = np.full((21, 33), level, np.float32)
    np.testing.assert_array_equal(blur_raw(image, kernel(0.4, 1.0, 1e-3)), image)


def test_blur_does_not_mirror_or_shift(rng):
    """Against a plain sum, with a kernel that has no symmetry."""
    image, weights = rng.random((12, 10), np.float32), rng.random((3, 5))
    weights /= weights.sum()
    expected = np.zeros(image.shape)
    for y, x in np.ndindex(image.shape):
        for j, k in np.ndindex(weights.shape):
            from_row, from_column = np.clip([y + 1 - j, x + 2 - k], 0, [11, 9])
            expected[y, x] += weights[j, k] * image[from_row, from_column]
    before = image.copy()
    blurred = blur_raw(image, weights)
    assert blurred.dtype == np.float32
    np.testing.assert_allclose(blurred, expected, rtol=1e-6)
    np.testing.assert_array_equal(image, before)


def test_one_axis_stands_for_both(rng):
    image, weights = rng.random((40, 30), np.float32), square_kernel(0.4, 1.0, 1e-2)
    both = blur_raw(image, np.outer(weights, weights))
    np.testing.assert_allclose(blur_raw(image, weights), both, rtol=1e-6)


@pytest.mark.slow
@any_aperture
def test_views_are_blurred_one_by_one(rng, kernel):
    views, weights = rng.random((2, 3, 20, 30), np.float32), kernel(0.3, 1.0, 1e-2)
    blurred = blur_views(views, weights)
    assert blurred.dtype == np.float32
    for view in np.ndindex(2, 3):
        np.testing.assert_array_equal(blurred[view], blur_raw(views[view], weights))


def test_slabs_leave_no_seam(rng, monkeypatch):
    image, weights = rng.random((50, 20), np.float32), round_kernel(0.5, 1.0, 1e-2)
    whole = blur_raw(image, weights)
    monkeypatch.setattr(diffraction, "ROWS_AT_ONCE", 7)
    np.testing.assert_allclose(blur_raw(image, weights), whole, rtol=1e-6)


@any_aperture
def test_dark_pixels_do_not_become_negative(kernel):
    image = np.zeros((80, 80), np.float32)
    image[3, 3] = 1e6
    assert blur_raw(image, kernel(0.3, 1.0, 1e-2)).min() >= 0
