"""What noise leaves of a fit, against noise itself."""

import numpy as np
import pytest

from lf_flame import LightField
from lf_flame.tomography import FrustumGrid, Roughness, reconstruct
from lf_flame.tomography.strength_search import STRENGTHS, roughness


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
