"""The round flame of known section, and how sections are compared with it."""

import numpy as np
import pytest

from experiments.tomography.phantoms import BLOCK, round_glow
from experiments.tomography.round_flames import HEIGHT_MM, RADIUS_MM, _errors, _halves
from lf_flame import LightField


def test_glow_projects_to_one_at_its_brightest():
    z = np.linspace(-14, 14, 561)
    x = np.linspace(0, 6, 61)
    h = np.linspace(0, 0.99, 100)[:, None, None]
    glow = round_glow(h, np.hypot(x[:, None], z), RADIUS_MM)
    assert glow.sum(axis=2).max() * 0.05 == pytest.approx(1, abs=1e-3)
    outside = round_glow(np.array([-0.01, 1.0, 1.2]), np.zeros(3), RADIUS_MM)
    assert np.array_equal(outside, np.zeros(3))


def test_errors_weigh_the_volume_and_the_section():
    heights, radii = np.linspace(12, -12, 49), np.arange(0, 9, 0.5)
    truth = round_glow(heights[:, None] / HEIGHT_MM + 0.5, radii[None, :], RADIUS_MM)
    assert _errors(heights, radii, truth) == (0, 0)
    assert _errors(heights, radii, 1.02 * truth) == pytest.approx((0.02, 0.02))
    on_axis = truth.copy()
    on_axis[:, 0] = 0
    volume, section = _errors(heights, radii, on_axis)
    assert volume == 0  # the axis has no volume
    assert section > 0.2


def test_halves_are_averaged_about_the_column_right_of_the_middle():
    views = np.zeros((3, 3, 2 * BLOCK, 8 * BLOCK), np.float32)
    bright = np.array([0, 1, 2, 3, 9, 5, 4, 7])  # by pixel; the axis is the fifth
    views[1, 1] = np.repeat(bright, BLOCK)[None]
    half = _halves(LightField(views), every=False)
    assert half == pytest.approx(np.array([[9, (5 + 3) / 2, (4 + 2) / 2, (7 + 1) / 2]] * 2))
