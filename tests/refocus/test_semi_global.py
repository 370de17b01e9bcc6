"""Slopes from costs, beside the recursion of semi-global matching and votes written out."""

from itertools import product

import numpy as np
import pytest

from lf_flame.refocus import semi_global
from lf_flame.refocus.semi_global import choose_slopes

SLOPES = np.linspace(-1, 1, 9)


def path_sums(costs, guide):
    """Hirschmueller's recursion, pixel by pixel from the one before on each of eight paths."""
    height, width, count = costs.shape
    sums = np.zeros(costs.shape)
    far = np.abs(np.subtract.outer(np.arange(count), np.arange(count)))
    for down, across in product((-1, 0, 1), repeat=2):
        if not (down or across):
            continue
        best = {}
        for t in range(height)[:: -1 if down < 0 else 1]:
            for s in range(width)[:: -1 if across < 0 else 1]:
                before = best.get((t - down, s - across))
                here = costs[t, s].astype(float)
                if before is not None:
                    change = abs(guide[t, s] - guide[t - down, s - across])
                    jump = max(semi_global.JUMP / (1 + semi_global.EDGE * change), semi_global.STEP)
                    price = np.choose(np.minimum(far, 2), (0, semi_global.STEP, jump))
                    here = here + (before + np.minimum(price, jump)).min(axis=1) - before.min()
                best[t, s] = here
                sums[t, s] += here
    return sums


def test_sums_over_paths_are_the_recursion_written_out(rng):
    costs = rng.uniform(size=(5, 7, 6)).astype(np.float32)
    guide = rng.uniform(0, 0.5, size=(5, 7)).astype(np.float32)
    found = semi_global.sum_paths(costs, guide)
    np.testing.assert_allclose(found, path_sums(costs, guide), rtol=1e-5)


def parabolas(truth):
    """Costs with their minimum at the true slopes."""
    return np.minimum((SLOPES - truth[..., None]) ** 2, 1).astype(np.float32)


def test_a_lone_wrong_slope_loses_and_bare_pixels_take_their_side_of_an_edge():
    """Two halves at two slopes, with an edge between them in the guide and nothing to match."""
    left = np.broadcast_to(np.arange(24) < 12, (20, 24))
    truth = np.where(left, -0.37, 0.41)
    costs = parabolas(truth)
    costs[9, 5] = parabolas(np.array(0.75))
    costs[:, 9:15] = 0.5  # bare beside the edge
    slope, confidence = choose_slopes(costs, SLOPES, left * 1.0, 2.0, 0.25)
    assert np.abs(slope - truth).max() < 0.05
    assert confidence[:, 9:15].max() == 0
    assert min(confidence[9, 5], confidence[4, 3]) > 0.8


def test_the_mean_of_votes_is_of_one_surface(rng):
    truth = 0.3 + 0.05 * rng.standard_normal((30, 30))  # noise of less than a step
    slope, _ = choose_slopes(parabolas(truth), SLOPES, np.zeros((30, 30)), 2.5, 0.25)
    assert np.std(slope) < 0.4 * np.std(truth)
    assert slope.mean() == pytest.approx(truth.mean(), abs=0.02)


def test_the_first_and_last_slope_are_never_certain():
    costs = parabolas(np.where(np.arange(20) < 10, -1.0, 1.0) + np.zeros((12, 20)))
    assert choose_slopes(costs, SLOPES, np.zeros((12, 20)), 2.0, 0.25)[1].max() == 0


def test_slopes_that_cannot_be_distinguished_are_never_certain():
    costs = parabolas(np.full((12, 20), 0.1))
    slope, confidence = choose_slopes(costs, SLOPES, np.zeros((12, 20)), 2.0, width=3.0)
    assert confidence.max() == 0
    assert np.abs(slope - 0.1).max() < 0.01
