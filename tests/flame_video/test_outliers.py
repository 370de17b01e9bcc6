"""Heights far out of their neighbours', planted in series that are known."""

import numpy as np
import pytest

from lf_flame.flame_video.outliers import find_outliers

TIMES = np.arange(200) / 100


@pytest.mark.parametrize("jump", [20.0, -20.0])
def test_a_jump_of_one_or_two_frames_is_found(jump):
    heights = 30 + np.sin(2 * np.pi * 12 * TIMES) + 5 * TIMES
    heights += 0.2 * np.random.default_rng(0).standard_normal(200)
    assert not find_outliers(heights).any()
    heights[[40, 41, 150]] += jump
    heights[90] = np.nan
    assert np.flatnonzero(find_outliers(heights)).tolist() == [40, 41, 150]


def test_what_comes_often_is_no_outlier():
    heights = np.where(np.arange(200) % 8 == 0, 50.0, 30.0)
    assert not find_outliers(heights).any()


def test_small_steps_of_constant_heights_are_none():
    heights = np.full(60, 30.0)
    heights[7] += 0.5
    assert find_outliers(heights).any()
    assert not find_outliers(heights, least=1.0).any()
    assert not find_outliers([30.0, np.nan, 50.0]).any()
