"""Costs of matching against sums written out, and against surfaces whose slopes are known."""

import numpy as np
import pytest
from scipy.interpolate import BSpline
from scipy.ndimage import correlate1d, gaussian_filter

from lf_flame.refocus import matching

SLOPES = np.linspace(-1.0, 1.0, 9)


def match_views(views, slopes):
    compared = matching.ComparedViews(views, slopes, np.ones(views.shape[:2]))
    return compared.costs(compared.limit())


def moved(picture, slope, views=(5, 5)):
    """Views of a plane at a whole slope: view (v, u) is the picture moved by slope steps."""
    out = np.empty((*views, *picture.shape), np.float32)
    for v, u in np.ndindex(views):
        at = (slope * (v - (views[0] - 1) // 2), slope * (u - (views[1] - 1) // 2))
        out[v, u] = np.roll(picture, at, axis=(0, 1))
    return out


def spline_read(view, down, across):
    """A view read at (t + down, s + across) by SciPy's cubic B-spline, edges repeated."""
    basis = BSpline.basis_element([-2, -1, 0, 1, 2], extrapolate=False)
    for axis, shift in ((0, down), (1, across)):
        n = view.shape[axis]
        places = np.arange(n) + shift
        total = 0.0
        for k in range(int(np.floor(places.min())) - 2, int(np.ceil(places.max())) + 3):
            weight = np.nan_to_num(basis(places - k))
            shape = (-1, 1) if axis == 0 else (1, -1)
            total = total + weight.reshape(shape) * view.take([np.clip(k, 0, n - 1)], axis=axis)
        view = total
    return view


def written_out(views, slopes):
    """The same costs by plain sums in float64."""
    v, u = views.shape[:2]
    views = views / np.abs(views).max()
    kinds = [np.sign(np.arange(n) - (n - 1) / 2) for n in (v, u)]
    shifted = np.array([
        [[spline_read(views[a, b], slope * (a - (v - 1) / 2), slope * (b - (u - 1) / 2))
          for b in range(u)] for a in range(v)] for slope in slopes
    ])  # fmt: skip
    inner = [np.flatnonzero(np.abs(np.arange(n) - (n - 1) / 2) < 1) for n in (v, u)]
    middle = shifted[:, inner[0]][:, :, inner[1]].mean(axis=(1, 2))
    apart = np.abs(shifted - middle[:, None, None])
    usual = np.median(apart.mean(axis=(1, 2)).min(axis=0))
    limit = max(0.07 * middle[-1].std(), 2.5 * usual, 1e-3)
    costs = []
    for sign_v in (0, -1, 1):
        for sign_u in (0, -1, 1):
            near = [[a for a in range(n) if sign * kind[a] >= 0 or a in middle_ones]
                    for n, sign, kind, middle_ones in
                    ((v, sign_v, kinds[0], inner[0]), (u, sign_u, kinds[1], inner[1]))]  # fmt: skip
            side = np.minimum(apart, limit)[:, near[0]][:, :, near[1]].mean(axis=(1, 2)) / limit
            for axis in (1, 2):
                side = correlate1d(side, [0.1065, 0.787, 0.1065], axis=axis, mode="nearest")
            costs.append(side + 0.07 * ((sign_v != 0) + (sign_u != 0)))
    return np.min(costs, axis=0).transpose(1, 2, 0)


@pytest.mark.parametrize("shape", [(3, 5, 20, 24), (4, 4, 17, 16), (2, 3, 12, 20)])
def test_costs_are_the_sums_written_out(shape, rng):
    views = 3.0 * gaussian_filter(rng.uniform(size=shape), (0, 0, 1, 1))
    found = match_views(views.astype(np.float32), SLOPES)
    np.testing.assert_allclose(found, written_out(views, SLOPES), atol=2e-5)


def test_behind_an_outline_half_the_views_say_enough(rng):
    """A wall at slope 1, from column 20 on hidden by a card at slope -1; all views would fail."""
    wall, card = rng.uniform(size=(2, 40, 48))
    views, front = moved(wall, 1, (5, 5)), moved(card, -1, (5, 5))
    for u in range(5):
        views[:, u, :, 24 - (u - 2) :] = front[:, u, :, 24 - (u - 2) :]
    costs = match_views(views, SLOPES)
    found = SLOPES[costs.argmin(axis=2)][8:-8]
    assert np.all(found[:, 8:22] == 1)
    assert np.all(found[:, 26:-8] == -1)
