import numpy as np
import pytest

from lf_flame.projection.line_sums import split_rows, sum_lines
from lf_flame.refocus import round_aperture, sparse_aperture


@pytest.mark.parametrize("seed", range(4))
def test_products_of_weights_add_up_to_the_weights(seed):
    rng = np.random.default_rng(seed)
    weights = rng.integers(0, 2, (5, 7)) * rng.uniform(size=7)
    weights[0, 3] = 1.0
    down, across = split_rows(weights)
    np.testing.assert_allclose(down.T @ across, weights / weights.sum(), atol=1e-15)


def test_rows_of_equal_weights_share_a_product():
    assert len(split_rows(np.ones((15, 15)))[0]) == 1
    assert len(split_rows(sparse_aperture((15, 15), [(3, 4)]))[0]) == 1
    assert len(split_rows(round_aperture((15, 15)))[0]) == 8


@pytest.mark.parametrize(
    ("interpolation", "expected"),
    [
        ("nearest", [[1 / 2, 1 / 2, 0], [1 / 2, 1 / 2, 0], [1 / 2, 1 / 2, 0]]),
        ("linear", [[1 / 8, 1 / 2, 3 / 8], [1 / 2, 1 / 2, 0], [3 / 8, 1 / 2, 1 / 8]]),
    ],
)
def test_taps_and_blocks_are_one_list_of_weights(interpolation, expected):
    """Views at steps -1, 0, 1 and slope 0.25, two lenslets to a pixel."""
    sums = sum_lines(np.array([0.25]), np.ones((1, 1, 3)), 8, 2, interpolation)
    taps = len(sums.weights[0, 0, 0])
    assert taps == (3 if interpolation == "linear" else 2)
    np.testing.assert_array_equal(sums.weights[0, 0], np.array(expected)[:, :taps])
    first = [-1, 0, 0] if interpolation == "linear" else [0, 0, 0]
    np.testing.assert_array_equal(sums.first[0], first)
