"""Searches for the strength of the penalty, on curves whose end is known."""

from types import SimpleNamespace

import numpy as np
import pytest

from lf_flame.tomography.strength_search import STRENGTHS, StrengthSearch


class Curve:
    """Problem whose misfit is a given function of the strength's index; all else is noise."""

    modes = 1.0

    def __init__(self, misfit):
        self.misfit = misfit

    def solve(self, strength, iterations, start=None):
        index = STRENGTHS.index(strength)
        cells = np.zeros((1, 4, 4), np.float32)
        return SimpleNamespace(cells=cells, state=None, misfit=self.misfit(index))

    def count_modes(self, strength):
        return 0.0


def search(misfit):
    return StrengthSearch(Curve(misfit), 1.0, np.ones((1, 1)), 1)


@pytest.mark.parametrize("best", range(len(STRENGTHS)))
def test_a_search_ends_at_the_strength_that_its_rule_names(best):
    """The strongest within the noise, a misfit of 1 here; and the least risk."""
    within = search(lambda index: 1.0 + (index - best if index > best else 1e-3 * (index - best)))
    assert within.find() == STRENGTHS[best]
    assert search(lambda index: abs(index - best)).find_by_risk() == STRENGTHS[best]


def test_a_fit_that_never_falls_to_the_noise_is_that_of_the_least_excess():
    assert search(lambda index: 2.0 + abs(index - 6)).find() == STRENGTHS[6]
