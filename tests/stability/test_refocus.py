"""Refocusing what has no focus, and slopes, brightness and thread counts at their extremes.

Each test also runs a formula that suggests itself, `naive` here, and shows that it fails what
ours passes.
"""

import os
import subprocess
import sys

import numpy as np
import pytest

from lf_flame import InputError
from lf_flame._common.arrays import centred
from lf_flame.refocus import (
    all_in_focus,
    find_sharpest_slope,
    find_slope_range,
    fourier_refocus,
    shift_and_sum,
)

UNIT32 = 2.0**-24
"""Unit roundoff of float32, in which light fields are stored."""

SLOPES = np.linspace(-2, 2, 81)

MIDDLE = (12, 36, 12, 36)
"""Region of a planted pattern that the edges do not reach."""


def planted(slope, views=(3, 3), n=48):
    """A smooth pattern between 0 and 1 about 1/2, displaced from view to view by the slope."""
    v, u = (centred(k) for k in views)
    t, s = (np.arange(n) - slope * k[:, None] for k in (v, u))
    waves = [(1, 2, 0.3), (3, -2, 1.1), (4, 1, 2.0), (2, 5, 0.7), (-5, 3, 2.6)]
    total = sum(
        np.cos(2 * np.pi * (a * t[:, None, :, None] + b * s[None, :, None, :]) / n + phase)
        for a, b, phase in waves
    )
    return 0.5 + total / (2 * len(waves))


def naive_sharpest_slope(views):
    """Variance ``E[x^2] - E[x]^2`` of the stack in float32, and the slope of its maximum."""
    with np.errstate(over="ignore", invalid="ignore"):
        stack = fourier_refocus(views, SLOPES).reshape(len(SLOPES), -1)
        curve = np.mean(stack**2, axis=1) - np.mean(stack, axis=1) ** 2
        return SLOPES[curve.argmax()], curve


def without_a_focus():
    """Light fields that are as sharp at one slope as at any other."""
    rng = np.random.default_rng(1)
    stripes = np.broadcast_to(rng.uniform(size=(30, 1)), (1, 5, 30, 30))
    last_digit = 0.75 + UNIT32 * rng.integers(-1, 2, size=(5, 5, 20, 20))
    return {
        "black": np.zeros((3, 3, 16, 16)),
        "constant 0.3": np.full((3, 3, 16, 16), 0.3),
        "constant 1/3": np.full((15, 15, 33, 31), 1 / 3),
        "constant 1": np.full((5, 5, 17, 23), 1.0),
        "constant 1e37": np.full((5, 5, 17, 23), 1e37),
        "one lenslet": rng.uniform(size=(5, 5, 1, 1)),
        "one view": rng.uniform(size=(1, 1, 20, 20)),
        "views of different brightness": np.ones((5, 5, 20, 20)) * rng.uniform(size=(5, 5, 1, 1)),
        "stripes along the only shift": stripes,
        "last digit of float32": last_digit,
        "white, saturated": np.full((3, 3, 16, 16, 3), 255, np.uint8),
    }


@pytest.mark.parametrize("name", without_a_focus())
def test_search_says_where_nothing_is_in_focus(name):
    """Naive: the highest point of the curve, whatever the curve; it always gives a slope."""
    views = without_a_focus()[name]
    with pytest.raises(InputError, match="No slope is sharpest: .* rounding of float32 pixels"):
        find_sharpest_slope(views)
    naive, _ = naive_sharpest_slope(views)
    assert naive in SLOPES


@pytest.mark.parametrize("exponent", [-100, -90, 90, 127])
def test_search_does_not_depend_on_the_brightness(exponent):
    """The same bits for any power of two. Naive: a float32 sum of squares is 0 or infinite."""
    views = planted(0.63).astype(np.float32)
    plain = find_sharpest_slope(views, SLOPES, region=MIDDLE)
    bright = find_sharpest_slope(np.ldexp(views, exponent), SLOPES, region=MIDDLE)
    assert bright.slope == plain.slope
    np.testing.assert_array_equal(bright.sharpness, plain.sharpness * 2.0 ** (2 * exponent))
    assert naive_sharpest_slope(views)[0] == pytest.approx(0.63, abs=0.05)
    naive, curve = naive_sharpest_slope(np.ldexp(views, exponent))
    assert abs(naive - 0.63) > 1
    assert not np.any(curve > 0)


@pytest.mark.parametrize("channels", [(), (3,)])
def test_slope_maps_do_not_depend_on_the_brightness(rng, channels):
    """Squares of 5e36 are beyond float32; a map that takes them finds no edges, with a warning."""
    texture = rng.uniform(size=(24, 30, *channels)).astype(np.float32)
    views = np.array([[np.roll(texture, (-v, -u), (0, 1)) for u in range(3)] for v in range(3)])
    slopes = np.linspace(-2, 2, 9)
    brighter = np.ldexp(views, 122)
    plain, bright = (all_in_focus(one, slopes) for one in (views, brighter))
    np.testing.assert_allclose(bright.slope, plain.slope, atol=1e-4)
    plain, bright = (find_slope_range(one) for one in (views, brighter))
    assert (bright.low, bright.high) == pytest.approx((plain.low, plain.high), abs=1e-4)


def test_refocusing_scales_with_the_brightness(rng):
    """Up to the largest float32. Naive: a float32 sum of the views, divided at the end."""
    views = rng.uniform(0.1, 1, size=(15, 15, 10, 9)).astype(np.float32)
    for brightness in (1e-30, 1e30, 3e38):
        scaled = (views.astype(float) * brightness).astype(np.float32)
        for refocus in (shift_and_sum, fourier_refocus):
            expected = refocus(views, [0.7, -1.0]).astype(float)
            found = refocus(scaled, [0.7, -1.0]) / brightness
            np.testing.assert_allclose(found, expected, rtol=4 * UNIT32)
    with np.errstate(over="ignore"):
        naive = scaled.sum(axis=(0, 1), dtype=np.float32) / 225
    assert np.all(np.isinf(naive))


@pytest.mark.slow
def test_means_over_many_views_keep_their_digits():
    """Naive: a running sum in float32 over 10,000 views."""
    value = np.float32(0.1)
    views = np.full((100, 100, 3, 3), value)
    for refocus in (shift_and_sum, fourier_refocus):
        assert np.abs(refocus(views, 0.5).astype(float) / value - 1).max() <= 2 * UNIT32
    naive = np.cumsum(views[..., 0, 0].ravel(), dtype=np.float32)[-1] / np.float32(10_000)
    assert abs(naive / value - 1) > 100 * 2 * UNIT32


@pytest.mark.parametrize("slope", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("refocus", [shift_and_sum, fourier_refocus])
def test_a_slope_that_is_no_number_is_refused(refocus, slope):
    """Naive: shift by it as an integer; the views come out moved by whatever that gives."""
    views = np.arange(3 * 20.0).reshape(1, 3, 1, 20)
    with pytest.raises(InputError, match="slopes must be one or more finite numbers"):
        refocus(views, [0.5, slope])
    with np.errstate(invalid="ignore"):
        shift = (slope * centred(3)).astype(np.int64)
    naive = [np.take(views[0, u, 0], np.arange(20) + k, mode="clip") for u, k in enumerate(shift)]
    assert np.all(np.isfinite(naive))


def test_slopes_to_search_are_equal_steps_whatever_their_size():
    """Naive: steps that are equal to within 1e-8, NumPy's default, however small they are."""
    uneven = np.array([0.0, 1e-9, 5e-9])
    with pytest.raises(InputError, match="equal steps"):
        find_sharpest_slope(planted(0.63), uneven)
    naive = np.allclose(np.diff(uneven), np.diff(uneven)[0])
    assert naive


THREADS = """
import hashlib, numba, numpy as np
from lf_flame.refocus import shift_and_sum
views = np.random.default_rng(5).uniform(size=(9, 9, 40, 37)).astype(np.float32)
for threads in range(1, numba.config.NUMBA_NUM_THREADS + 1):
    numba.set_num_threads(threads)
    images = [shift_and_sum(views, [1.3, -0.2], interpolation=how) for how in ("linear", "nearest")]
    print(threads, hashlib.sha256(np.array(images).tobytes()).hexdigest())
"""


@pytest.mark.slow
@pytest.mark.jit
def test_bits_are_the_same_for_one_to_eight_threads(rng):
    """Naive: one float32 image a thread, added at the end; its bits tell the thread count."""
    run = subprocess.run(
        [sys.executable, "-c", THREADS],
        env={**os.environ, "NUMBA_NUM_THREADS": "8"},
        capture_output=True,
        text=True,
        check=True,
    )
    lines = [line.split() for line in run.stdout.splitlines()]
    assert [int(threads) for threads, _ in lines] == list(range(1, 9))
    assert len({digest for _, digest in lines}) == 1
    views = rng.uniform(size=(81, 40 * 37)).astype(np.float32)
    naive = {
        sum(part.sum(axis=0) for part in np.array_split(views, n)).tobytes() for n in range(1, 9)
    }
    assert len(naive) > 1
