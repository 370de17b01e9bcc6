"""What noise leaves of a fit, against noise itself."""

from types import SimpleNamespace

import numpy as np
import pytest

from lf_flame import LightField
from lf_flame.tomography import FrustumGrid, Roughness, reconstruct
from lf_flame.tomography.strength_search import STRENGTHS, StrengthSearch, roughness


@pytest.fixture(scope="module")
def tried(camera):
    """Linear fits of all strengths to a light field of nothing but noise."""
    noise = np.random.default_rng(0).standard_normal((7, 7, 54, 60), dtype=np.float32)
    grid = FrustumGrid(camera, [3.0, 0.0, -4.0])
    penalty = Roughness(nonnegative=False, whole_curve=True)
    found = reconstruct(LightField(noise), grid, noise=1.0, strength=0.01, penalty=penalty)
    return found.tried


def test_strengths_are_half_decades(tried):
    assert [one.strength for one in tried] == list(STRENGTHS)
    assert np.log10(STRENGTHS) == pytest.approx(np.arange(-6, 3.25, 0.5))


def test_noise_leaves_what_is_expected_of_it(tried):
    """A mode that is kept by half counts half, and its noise leaves a quarter: hence the slack."""
    misfits, expected = ([getattr(one, name) for one in tried] for name in ("misfit", "expected"))
    assert expected == sorted(expected)
    assert expected[0] < 0.1
    assert expected[-1] > 0.9
    assert misfits == pytest.approx(expected, abs=0.2)
    assert misfits[0] == pytest.approx(expected[0], abs=0.2)
    assert misfits[-1] == pytest.approx(expected[-1], abs=0.05)


def test_roughness_is_of_third_differences():
    """A parabola has none; a cubic of n^3 has 6 everywhere."""
    n = np.arange(12.0)
    assert roughness(np.broadcast_to(n**2, (1, 12, 12))) == 0
    cubic = np.broadcast_to(n**3, (1, 12, 12))
    assert roughness(cubic) == pytest.approx(6 / 11**3)
    assert roughness(5 * cubic) == pytest.approx(6 / 11**3)


class Curve:
    """Problem whose misfit is a given function of the strength's index; all else is noise."""

    modes = 1.0

    def __init__(self, misfit):
        self.misfit = misfit

    def solve(self, strength, nonnegative, iterations, start=None):
        index = STRENGTHS.index(strength)
        cells = np.zeros((1, 4, 4), np.float32)
        return SimpleNamespace(cells=cells, state=None, misfit=self.misfit(index))

    def count_modes(self, strength):
        return 0.0


def search(misfit):
    return StrengthSearch(Curve(misfit), 1.0, np.ones((1, 1)), False, 1)


@pytest.mark.parametrize("best", range(len(STRENGTHS)))
def test_a_search_ends_at_the_strength_that_its_rule_names(best):
    """The strongest within the noise, a misfit of 1 here; and the least risk."""
    within = search(lambda index: 1.0 + (index - best if index > best else 1e-3 * (index - best)))
    assert within.find() == STRENGTHS[best]
    assert search(lambda index: abs(index - best)).find_by_risk() == STRENGTHS[best]


def test_a_fit_that_never_falls_to_the_noise_is_that_of_the_least_excess():
    assert search(lambda index: 2.0 + abs(index - 6)).find() == STRENGTHS[6]
