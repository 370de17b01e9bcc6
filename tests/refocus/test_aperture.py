"""Weights of the views for apertures."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lf_flame import PAPER_CAMERA, InputError
from lf_flame.refocus.aperture import aperture_weights, f_number_aperture, round_aperture


@pytest.mark.slow
@given(
    views=st.tuples(st.integers(1, 16), st.integers(1, 16)),
    width=st.floats(0.05, 2),
    ring=st.floats(0, 0.95),
    shape=st.sampled_from(["round", "square"]),
    place=st.tuples(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5)),
)
@settings(max_examples=100, deadline=None)
def test_shares_are_those_of_many_points(views, width, ring, shape, place):
    """The place in widths of the full aperture."""
    n = 60
    y, x = (
        (((np.arange(n * k) + 0.5) / (n * k) - 0.5) - at) / (width / 2)
        for k, at in zip(views, place, strict=True)
    )
    if shape == "round":
        away = np.hypot(y[:, None], x[None, :])
    else:
        away = np.maximum(np.abs(y)[:, None], np.abs(x)[None, :])
    points = ((away < 1) & (away >= ring)).reshape(views[0], n, views[1], n)
    centre = tuple(at * k for at, k in zip(place, views, strict=True))
    found = aperture_weights(views, width, ring * width, shape, centre)
    np.testing.assert_allclose(found, points.mean(axis=(1, 3)), atol=0.035)


@pytest.mark.parametrize("views", [(1, 1), (4, 4), (15, 15), (5, 8)])
def test_a_disc_inside_has_the_area_of_a_disc(views):
    for diameter in (1e-3, 0.3, 1.0):
        area = round_aperture(views, diameter).sum() / math.prod(views)
        assert area == pytest.approx(math.pi / 4 * diameter**2, rel=1e-9)
    np.testing.assert_allclose(round_aperture(views, math.sqrt(2)), 1, rtol=1e-9)


def test_f_numbers_are_working_ones():
    own = 0.4 / 0.112
    weights = f_number_aperture(PAPER_CAMERA, 2 * own)
    np.testing.assert_allclose(weights, round_aperture((15, 15), 0.5), atol=0.01)
    with pytest.raises(InputError, match="must be 3.567 .all views. or more"):
        f_number_aperture(PAPER_CAMERA, 2.0)
