"""Refocusing what has no focus, and brightness at its extremes.

More cases, each beside the formula that suggests itself, are in `experiments/hard_cases`.
"""

import numpy as np
import pytest

from lf_flame import InputError
from lf_flame.refocus import find_sharpest_slope

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
    with pytest.raises(
        InputError, match="No slope is sharpest: (.* rounding of float32|too little texture)"
    ):
        find_sharpest_slope(views)
