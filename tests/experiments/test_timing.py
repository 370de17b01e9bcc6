"""Times of calls in turn: their order, what counts of them, and ratios within a round."""

import numpy as np
import pytest

from experiments.timing import Times, in_turn


def test_calls_are_made_in_turn_and_the_first_round_does_not_count():
    made = []
    ticks = {"a": iter([9.0, 1.0, 2.0, 4.0]), "b": iter([9.0, 3.0, 4.0, 2.0])}

    def call(name):
        made.append(name)
        return next(ticks[name])

    times = in_turn(lambda: call("a"), lambda: call("b"), rounds=3, timed=True)
    assert "".join(made) == "abababab"
    np.testing.assert_array_equal(times.seconds, [[1, 2, 4], [3, 4, 2]])
    np.testing.assert_array_equal(times.best, [1, 2])
    assert times.ratio(1, 0) == (2.0, 1.25, 2.5)  # the median of 3, 2 and 1/2, not 2 / 1
    np.testing.assert_array_equal(times.spread, [0.5, 0.5])


def test_a_short_call_is_repeated_in_its_turn_and_its_shortest_time_counts():
    ticks = iter([0.4, 0.2, 0.5, 0.3, 0.4, 0.35])
    times = in_turn(lambda: next(ticks), rounds=2, warm_up=False, turn_s=1.0, timed=True)
    np.testing.assert_array_equal(times.seconds, [[0.2, 0.3]])
    assert times.every == [[0.4, 0.2, 0.5, 0.3, 0.4, 0.35]]


def test_results_are_those_of_the_last_round():
    calls = iter(range(10))
    assert in_turn(lambda: next(calls), rounds=2).results == [2]


def test_rounds_go_on_for_as_long_as_asked():
    times = in_turn(lambda: None, rounds=1, least_s=0.01)
    assert times.seconds.shape[1] > 10
    assert times.seconds.sum() == pytest.approx(0.01, abs=0.01)


def test_spread_is_from_the_best_to_the_lower_quartile():
    times = Times(np.array([[1.0, 1.5, 2.0, 9.0, 9.0]]), [], [])
    assert times.spread.tolist() == [0.5]
