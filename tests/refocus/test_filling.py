"""Votes stay on their side of an edge, and the slope of most of them is taken."""

import numba
import numpy as np
import pytest

from lf_flame.refocus import filling
from lf_flame.refocus.filling import REACH, TURNS, _links, fill_slopes

SLOPES = np.linspace(-2.0, 2.0, 21)


def halves(left, right, shape=(20, 30)):
    out = np.full(shape, float(right))
    out[:, : shape[1] // 2] = left
    return out


def test_the_edges_of_the_picture_bound_what_is_filled():
    truth, picture = halves(-1.0, 1.3), halves(0.2, 0.7)
    votes = np.zeros(truth.shape)
    votes[3, 4] = votes[16, 27] = 1.0
    filled = fill_slopes(np.where(votes > 0, truth, 0.37), votes, picture, SLOPES)
    np.testing.assert_allclose(filled, truth, atol=1e-9)
    lying = fill_slopes(truth.T, votes.T, picture.T, SLOPES)  # and with the edge along the rows
    np.testing.assert_allclose(lying, truth.T, atol=1e-9)
    colour = np.stack([picture, np.zeros_like(picture), picture], axis=2)
    np.testing.assert_allclose(fill_slopes(truth, votes, colour, SLOPES), truth, atol=1e-9)


def test_without_an_edge_one_surface_ends_where_the_other_begins_and_nothing_lies_between():
    truth = halves(-1.0, 1.3, (20, 240))  # far from the ends, where votes pile up
    votes = np.zeros(truth.shape)
    votes[:, 110] = votes[:, 129] = 1.0
    filled = fill_slopes(truth, votes, np.zeros(truth.shape), SLOPES)
    assert np.all(np.isclose(filled, -1.0) | np.isclose(filled, 1.3))
    np.testing.assert_allclose(filled[:, :119], -1.0, atol=1e-9)
    np.testing.assert_allclose(filled[:, 121:], 1.3, atol=1e-9)


def test_noise_of_neighbours_averages_out(rng):
    values = 0.55 + 0.05 * rng.standard_normal((40, 40))
    filled = fill_slopes(values, np.ones(values.shape), np.zeros(values.shape), SLOPES)
    assert np.abs(filled - 0.55).max() < 0.01


def test_an_edge_ties_down_the_pixel_behind_it_and_no_other():
    """One column of a picture of two halves: links at the edge alone are weak."""
    picture = halves(0.0, 1.0, (6, 10))
    for down, across in _links(picture):
        assert np.all(across[:, 5] < 0.1 * across[:, 4])
        assert np.all(across[:, 6] == across[:, 4])
        assert np.all(down == across[0, 4])
    for down, _ in _links(picture.T):
        assert np.all(down[5] < 0.1 * down[4])


def test_smoothing_is_the_recursion_written_out(rng):
    planes, links = rng.uniform(size=(2, 7, 70)), rng.uniform(size=(7, 70))
    expected = planes.copy()
    for s in range(1, 70):
        before = expected[..., s - 1]
        expected[..., s] = (1 - links[:, s]) * expected[..., s] + links[:, s] * before
    for s in range(68, -1, -1):
        behind = expected[..., s + 1]
        expected[..., s] = (1 - links[:, s + 1]) * expected[..., s] + links[:, s + 1] * behind
    lying = np.ascontiguousarray(planes.swapaxes(1, 2))
    filling._smooth_rows(planes, links)
    np.testing.assert_allclose(planes, expected, rtol=1e-12)
    filling._smooth_columns(lying, np.ascontiguousarray(links.T))
    np.testing.assert_allclose(lying.swapaxes(1, 2), expected, rtol=1e-12)


def test_heavier_votes_win():
    values, votes = halves(-1.0, 1.3), halves(1.0, 3.0)
    at = [15 - k for k in range(1, 4)]
    filled = fill_slopes(values, votes, np.zeros(values.shape), SLOPES)
    assert np.all(filled[:, at[0]] > 0)  # beside three times its weight
    assert np.all(filled[:, :4] < 0)


def test_without_votes_the_mean_is_left():
    values = halves(0.0, 1.0)
    np.testing.assert_array_equal(fill_slopes(values, 0 * values, values, SLOPES), 0.5)


def test_a_vote_travels_as_far_as_the_reach():
    """The recursive filter's exponential has the standard deviation that the paper states."""
    links = _links(np.zeros((1, 801)))
    assert len(links) == TURNS
    line = np.zeros(801)
    line[400] = 1.0
    for _, across in links:
        link = across[0, 1]
        forth = np.convolve(line, (1 - link) * link ** np.arange(801))[:801]
        line = np.convolve(forth[::-1], (1 - link) * link ** np.arange(801))[:801][::-1]
    at = np.arange(801) - 400
    assert np.sqrt(np.sum(line * at**2) / line.sum()) == pytest.approx(REACH, rel=0.01)


def test_threads_change_nothing(rng):
    values, votes, picture = rng.uniform(size=(3, 50, 150))
    filled = fill_slopes(values, votes, picture, SLOPES)
    threads = numba.get_num_threads()
    try:
        numba.set_num_threads(1)
        np.testing.assert_array_equal(fill_slopes(values, votes, picture, SLOPES), filled)
    finally:
        numba.set_num_threads(threads)
