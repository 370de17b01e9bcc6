"""Warnings come where something is wrong, and only there."""

import numpy as np
import pytest

from lf_flame.tomography.data_checks import check_data


def quiet_views():
    """A bump on darkness, with noise of 0.01."""
    rows, columns = np.mgrid[-10:11, -12:13]
    views = np.broadcast_to(np.exp(-(rows**2 + columns**2) / 16.0), (5, 5, 21, 25))
    noise = np.random.default_rng(0).standard_normal(views.shape)
    return (views + 0.01 * noise).astype(np.float32)


EVEN = np.ones((5, 5))


def test_nothing_is_said_where_nothing_is_wrong():
    assert check_data(quiet_views(), EVEN, 0.01, 0.01, stated=True) == ()
    assert check_data(np.zeros((5, 5, 8, 8), np.float32), EVEN, 0.0, 0.0, stated=False) == ()


def test_noise_is_questioned_only_where_it_was_stated():
    assert check_data(quiet_views(), EVEN, 0.01, 0.02, stated=False) == ()
    (said,) = check_data(quiet_views(), EVEN, 0.01, 0.02, stated=True)
    assert "2 times the stated noise" in said


def test_a_view_is_odd_beside_the_others_and_not_by_itself():
    chi_squared = 4 * EVEN
    assert check_data(quiet_views(), chi_squared, 0.01, 0.01, stated=False) == ()
    chi_squared = EVEN.copy()
    chi_squared[3, 1] = 2.0
    (said,) = check_data(quiet_views(), chi_squared, 0.01, 0.01, stated=False)
    assert "View 3, 1 is explained 2 times worse" in said
    # Below the model's own error it is no news.
    assert check_data(quiet_views(), chi_squared, 0.001, 0.001, stated=False) == ()


@pytest.mark.parametrize(("background", "warned"), [(0.0, False), (0.006, False), (0.02, True)])
def test_a_background_is_seen_from_some_errors_of_the_mean_on(background, warned):
    """25 views of noise 0.01 leave an error of 0.002 there; five of those are a background."""
    views = quiet_views() + np.float32(background)
    said = check_data(views, EVEN, 0.01, 0.01, stated=False)
    assert bool(said) == warned
    if warned:
        assert "subtract the dark frame" in said[0]


def test_a_ceiling_is_told_from_a_peak():
    views = np.minimum(quiet_views(), np.float32(0.7))
    (said,) = check_data(views, EVEN, 0.01, 0.01, stated=False)
    assert "exactly the brightest value, 0.7" in said


def test_light_at_the_edge_is_told_from_a_background():
    views = np.roll(quiet_views(), 10, axis=2)
    (said,) = check_data(views, EVEN, 0.01, 0.01, stated=False)
    assert "Light reaches the field's edge" in said
