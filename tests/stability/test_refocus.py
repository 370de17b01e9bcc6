"""Refocusing what has no focus, and slopes, brightness and thread counts at their extremes.

More cases, each beside the formula that suggests itself, are in `experiments/hard_cases`.
"""

import os
import subprocess
import sys

import numpy as np
import pytest

from lf_flame import InputError
from lf_flame.refocus import (
    all_in_focus,
    find_sharpest_slope,
    find_slope_range,
)

UNIT32 = 2.0**-24
"""Unit roundoff of float32, in which light fields are stored."""


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
    views = without_a_focus()[name]
    with pytest.raises(InputError, match="No slope is sharpest: .* rounding of float32 pixels"):
        find_sharpest_slope(views)


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


def test_slopes_to_search_are_equal_steps_whatever_their_size():
    """Not to within 1e-8, NumPy's default, however small they are."""
    uneven = np.array([0.0, 1e-9, 5e-9])
    with pytest.raises(InputError, match="equal steps"):
        find_sharpest_slope(np.ones((3, 3, 16, 16)), uneven)


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
def test_bits_are_the_same_for_one_to_eight_threads():
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
