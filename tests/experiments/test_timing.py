"""Times of calls in turn: their order, which of them count, and ratios within a round."""

import numpy as np
import pytest

from experiments import timing
from experiments.timing import in_turn


@pytest.fixture
def clock(monkeypatch):
    """A clock that stands still but where a call advances it."""
    now = [0.0]
    monkeypatch.setattr(timing.time, "perf_counter", lambda: now[0])

    def call(name, made, ticks):
        made.append(name)
        now[0] += next(ticks)
        return len(made)

    return call


def test_calls_are_made_in_turn_and_the_first_round_does_not_count(clock):
    made, ticks = [], {"a": iter([9.0, 1.0, 2.0, 4.0]), "b": iter([9.0, 3.0, 4.0, 2.0])}
    times = in_turn(*(lambda n=n: clock(n, made, ticks[n]) for n in "ab"), rounds=3)
    assert "".join(made) == "abababab"
    np.testing.assert_array_equal(times.seconds, [[1, 2, 4], [3, 4, 2]])
    np.testing.assert_array_equal(times.best, [1, 2])
    assert times.ratio(1, 0) == (2.0, 1.25, 2.5)  # the median of 3, 2 and 1/2, not 2 / 1
    assert times.results == [7, 8]


@pytest.mark.parametrize(
    ("seconds", "options", "rounds"),
    [(0.01, {}, 30), (1.0, {}, 3), (4.0, {}, 2), (4.0, {"rounds": 3}, 3), (1.0, {"least_s": 9}, 9)],
)
def test_rounds_go_on_for_as_long_as_asked(clock, seconds, options, rounds):
    times = in_turn(
        lambda: clock("a", [], iter([seconds])), **{"rounds": 1} | options if "least_s" in options
        else options,
    )  # fmt: skip
    assert times.seconds.shape[1] == rounds


@pytest.mark.slow
def test_the_floor_reads_every_word(rng):
    words = rng.integers(0, 2**60, 64 * 9, np.uint64)
    sums = np.empty(64, np.uint64)
    timing._sum_parts(words, sums)
    assert sums.sum() == words.sum()
    timing.read_once(np.ones((3, 5, 7), np.uint16))
