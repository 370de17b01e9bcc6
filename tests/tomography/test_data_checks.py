"""Warnings come where something is wrong, and only there."""

import re
from types import SimpleNamespace

import numpy as np
import pytest

from experiments.emission.truth import Lens, Sheet, record
from lf_flame.tomography import FrustumGrid
from lf_flame.tomography.data_checks import data_checks, depth_checks


def quiet_views():
    """A bump on darkness, with noise of 0.01."""
    rows, columns = np.mgrid[-10:11, -12:13]
    views = np.broadcast_to(np.exp(-(rows**2 + columns**2) / 16.0), (5, 5, 21, 25))
    noise = np.random.default_rng(0).standard_normal(views.shape)
    return (views + 0.01 * noise).astype(np.float32)


EVEN = np.ones((5, 5))


def check_data(views, chi_squared, noise, measured, stated, residual=None):
    """Sentences on a fit with so much noise, which left white noise or the given residual."""
    if residual is None:
        residual = noise * np.random.default_rng(9).standard_normal(views.shape)
    found = SimpleNamespace(noise=noise, measured=measured, shared=1.0, settled=True)
    checks = data_checks(views, residual, chi_squared, found, stated=stated)
    return tuple(one.sentence for one in checks if one.failed)


def depth_said(grid, emission):
    return tuple(one.sentence for one in depth_checks(grid, emission) if one.failed)


QUIET = quiet_views()
DARK = np.random.default_rng(1).standard_normal((5, 5, 8, 8)).astype(np.float32)
EDGE = np.float32(0.5) + np.random.default_rng(0).normal(0, 0.01, (5, 5, 12, 12)).astype(np.float32)


@pytest.mark.parametrize(
    ("views", "noise", "measured", "stated", "said"),
    [
        (QUIET, 0.01, 0.01, True, None),
        (QUIET, 0.01, 0.02, False, None),
        (QUIET, 0.01, 0.02, True, "2 times the stated noise"),
        (0 * DARK, 0.0, 0.0, False, "contains no light above its noise"),
        (0.3 * DARK, 0.3, 0.3, False, "contains no light above its noise"),
        (-QUIET, 0.01, 0.01, False, "its sign is flipped"),
        (np.minimum(QUIET, np.float32(0.7)), 0.01, 0.01, False, "exactly the brightest value, 0.7"),
        (EDGE, 0.01, 0.01, False, "adds about more than the rest of its light"),
    ],
)
def test_a_sentence_comes_where_something_is_wrong(views, noise, measured, stated, said):
    found = check_data(views, EVEN, noise, measured, stated=stated)
    assert said in found[0] if said else not found


def test_advice_on_a_background_depends_on_what_was_tried():
    found = SimpleNamespace(noise=0.01, measured=0.01, shared=1.0, settled=True)
    for fitted, advice in ((None, "--background fit"), (False, "no pixel is"), (True, "uneven")):
        checks = data_checks(EDGE, 0 * EDGE, EVEN, found, fitted_background=fitted)
        assert [check for check in checks if advice in check.sentence]


LENS = Lens(views=5, lenslets=(40, 48))
FLAME = record(LENS, [Sheet(2.0, (0.1, -0.4), (0.8, 0.5)), Sheet(-3.0, (0.0, 0.5), (0.7, 0.4))])


@pytest.mark.parametrize(("background", "sd"), [(0.01, 0.02), (0.02, 0.05), (-0.01, 0.02)])
@pytest.mark.parametrize("photons", [False, True])
def test_a_background_far_below_the_noise_of_a_pixel_is_seen(background, sd, photons):
    rng = np.random.default_rng(3)
    noise = rng.standard_normal(FLAME.shape) * np.sqrt(FLAME + 0.1 if photons else 1.0)
    for level, warned in ((0.0, False), (background, True)):
        views = (FLAME + level + sd * noise).astype(np.float32)
        said = check_data(views, EVEN, sd, sd, stated=False)
        assert bool(said) == warned
    assert "subtract the dark frame" in said[0]
    adds = abs(background) / np.abs(FLAME.mean() + 0 * background)
    told = float(re.search(r"about (\d+)%", said[0])[1]) / 100
    assert told == pytest.approx(adds, rel=0.1)


def test_planes_nearer_than_the_blur_are_said(camera):
    """Two cells of 0.1315 mm over 0.2387 rad are 1.10 mm; 1 mm times 0.2387 is 0.24 mm."""
    y, x = np.mgrid[-1:1:54j, -1:1:60j]
    flame = np.exp(-((y / 0.4) ** 2) - (x / 0.2) ** 2)
    planes = np.linspace(-3, 3, 7)
    lone = np.where(np.arange(7)[:, None, None] == 3, flame, 0)
    (said,) = depth_said(FrustumGrid(camera, planes), lone)
    assert said.startswith("A light field gives almost no depth information for a smooth flame: ")
    assert "planes 1 mm apart resolve periods up to 0.24 mm" in said
    assert depth_said(FrustumGrid(camera, [-4.0, -2.8, 2.0]), lone[2:5]) == ()
    assert depth_said(FrustumGrid(camera, [0.0]), lone[3:4]) == ()


def test_light_behind_other_light_and_nearer_than_the_blur_is_said(camera):
    """A smooth flame at each of two planes, side by side, behind each other, and far behind."""
    y, x = np.mgrid[-1:1:90j, -1:1:180j]

    def flame(at):
        return np.exp(-((y / 0.4) ** 2) - ((x - at) / 0.2) ** 2)

    near, far = FrustumGrid(camera, (-1.0, 1.0)), FrustumGrid(camera, (-30.0, 30.0))
    behind = np.stack([flame(0.0), flame(0.05)])
    (said,) = depth_said(near, behind)
    assert "planes 2 mm apart resolve periods up to 0.48 mm" in said
    assert depth_said(near, np.stack([flame(-0.5), flame(0.5)])) == ()
    assert depth_said(far, behind) == ()
    assert depth_said(near, np.zeros_like(behind)) == ()
