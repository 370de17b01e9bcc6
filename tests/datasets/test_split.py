import numpy as np
import pytest

from lf_flame.datasets.split import split_indices


@pytest.mark.parametrize(
    ("n", "shares", "counts"),
    [
        (10, (0.7, 0.2, 0.1), (7, 2, 1)),
        (1000, (0.5, 0.2, 0.3), (500, 200, 300)),
        (7, (0.6, 0.2, 0.2), (4, 2, 1)),  # 4.2 and 5.6, rounded
    ],
)
def test_parts_have_their_shares_and_no_sample_is_in_two(n, shares, counts):
    parts = split_indices(n, shares, seed=3)
    assert tuple(parts) == ("train", "validation", "test")
    assert tuple(map(len, parts.values())) == counts
    np.testing.assert_array_equal(np.sort(np.concatenate([*parts.values()])), np.arange(n))
    for part in parts.values():
        assert np.all(np.diff(part) > 0)


def test_samples_are_drawn_by_the_seed():
    one, same, other = (split_indices(60, (0.5, 0.25, 0.25), seed)["train"] for seed in (1, 1, 2))
    np.testing.assert_array_equal(one, same)
    assert set(one) != set(other)
    assert set(one) != set(range(30))
