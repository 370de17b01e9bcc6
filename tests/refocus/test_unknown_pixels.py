"""Light fields with unknown pixels: planes of waves with highlights, written out here."""

import numpy as np
import pytest

from lf_flame import LightField
from lf_flame.refocus import (
    align_views,
    all_in_focus,
    find_sharpest_slope,
    find_slope_range,
    fourier_slice,
    refocus,
    refocus_surface,
    shift_and_sum,
)

STEPS = np.arange(-3, 4)
SLOPE = 0.6


def wall(slope=SLOPE, peak=0.0, size=(48, 56), seed=1):
    """Views of a plane of waves of 4 to 8 lenslets with a Gaussian highlight in the middle."""
    t, s = (np.arange(n) - (n - 1) / 2 for n in size)
    v, u, t, s = np.meshgrid(STEPS, STEPS, t, s, indexing="ij")
    t, s = t - slope * v, s - slope * u
    rng = np.random.default_rng(seed)
    waves = 0.5 + peak * np.exp(-((t - 3) ** 2 + (s + 2) ** 2) / 25)
    for length, angle, phase in zip(
        rng.uniform(4, 8, 20), rng.uniform(0, 6.28, 20), rng.uniform(0, 6.28, 20), strict=True
    ):
        along = np.sin(angle) * t + np.cos(angle) * s
        waves = waves + 0.03 * np.cos(2 * np.pi * along / length + phase)
    return waves.astype(np.float32)


GAIN = np.float32((1 + 0.1 * STEPS + 0.04 * STEPS[:, None])[..., None, None] / 1.42)
"""Gain of each view, as of an uneven pupil; views are divided by it."""


def clipped(full):
    """Light field of a sensor that clips at 60 % of the peak of its brightest view."""
    level = 0.6 * (full * GAIN).max()
    return LightField(np.minimum(full * GAIN, level) / GAIN, valid=full * GAIN < level)


FULL = wall(peak=2.0)
CLIPPED = clipped(FULL)


def test_a_clipped_highlight_keeps_its_slope():
    slopes = np.linspace(-1, 1, 21)
    truth = find_sharpest_slope(FULL, slopes).slope
    assert truth == pytest.approx(SLOPE, rel=1e-3)
    assert find_sharpest_slope(CLIPPED, slopes).slope == pytest.approx(truth, rel=0.005)


@pytest.mark.parametrize("interpolation", ["linear", "nearest", "cubic", "sinc"])
def test_a_refocused_highlight_has_the_light_of_views_that_are_not_clipped(interpolation):
    options = {"interpolation": interpolation}
    truth, found = (refocus(one, SLOPE, **options) for one in (FULL, CLIPPED))
    plain = refocus(CLIPPED.views, SLOPE, **options)
    error = np.sqrt(np.mean((found - truth) ** 2))
    assert error < 0.25 * np.sqrt(np.mean((plain - truth) ** 2))
    lost = shift_and_sum(~CLIPPED.valid * np.float32(1), SLOPE)
    np.testing.assert_allclose(found[lost == 0], truth[lost == 0], rtol=0.01)
    sliced = fourier_slice(CLIPPED, SLOPE, width=8)[8:-8, 8:-8]
    np.testing.assert_allclose(sliced, refocus(CLIPPED, SLOPE, interpolation="sinc")[8:-8, 8:-8],
                               atol=0.02)  # fmt: skip


def test_what_no_view_knows_is_a_lower_bound_and_said(caplog):
    level = 0.6 * FULL.max()
    light_field = LightField(np.minimum(FULL, level), valid=level > FULL)
    found = shift_and_sum(light_field, SLOPE)
    assert "refocused values are lower bounds" in caplog.text
    # The mean of what is held: dropping saturated pixels would make the rim darker.
    np.testing.assert_allclose(found, shift_and_sum(light_field.views, SLOPE), atol=2e-3)
    assert np.all(found <= shift_and_sum(FULL, SLOPE) + 1e-6)


def test_unknown_pixels_do_not_enter_a_mean():
    """In each column of three views, those known have the value of the column."""
    views = np.broadcast_to(np.arange(1.0, 6.0), (3, 1, 2, 5)).copy()
    valid = np.ones(views.shape, bool)
    valid[0, 0, :, 1] = valid[1:, 0, :, 3] = False
    views[~valid] = 0
    light_field = LightField(views, weights=[[1], [2], [3]], valid=valid)
    for image in (shift_and_sum(light_field, 0.0), refocus_surface(light_field, np.zeros((2, 5)))):
        np.testing.assert_allclose(image, np.broadcast_to(np.arange(1.0, 6.0), (2, 5)), rtol=1e-6)
    coloured = LightField(np.stack([views, 2 * views], axis=-1), valid=valid)
    image = shift_and_sum(coloured, [0.0])[0]
    np.testing.assert_allclose(image[..., 1], 2 * np.broadcast_to(np.arange(1.0, 6.0), (2, 5)))


@pytest.mark.slow
@pytest.mark.parametrize("slope", [SLOPE, -0.35])
def test_lenslets_that_no_view_knows_do_not_draw_slopes_to_0(slope):
    """A hole at fixed lenslets, as of dirt on them, is sharpest at slope 0."""
    full = wall(slope)
    valid = np.ones(full.shape, bool)
    valid[..., 18:25, 22:30] = False
    light_field = LightField(np.where(valid, full, 0), valid=valid)
    slopes = np.linspace(-1, 1, 21)
    truth = find_sharpest_slope(full, slopes).slope
    assert abs(find_sharpest_slope(light_field.views, slopes).slope / truth - 1) > 0.01
    assert find_sharpest_slope(light_field, slopes).slope == pytest.approx(truth, rel=0.002)
    assert find_slope_range(light_field).slope == pytest.approx(slope, abs=0.01)
    found = all_in_focus(light_field, np.linspace(slope - 0.8, slope + 0.8, 17))
    assert np.abs(found.slope - slope).max() < 0.07  # BadPix(0.07), at the edges too
    image = all_in_focus(full, np.linspace(slope - 0.8, slope + 0.8, 17)).all_in_focus
    assert np.sqrt(np.mean((found.all_in_focus - image) ** 2)) < 0.01


def test_a_hole_is_filled_from_its_rim_and_never_below_what_it_holds():
    t, s = np.mgrid[:9, :11].astype(float)
    ramp = (2 * t + 3 * s)[None, None]
    valid = np.ones(ramp.shape, bool)
    valid[0, 0, 3:6, 4:7] = False
    filled = LightField(np.where(valid, ramp, 0), valid=valid).filled
    np.testing.assert_allclose(filled, ramp, atol=3.01)
    assert filled[0, 0, 4, 5] == pytest.approx(ramp[0, 0, 4, 5])  # by symmetry
    np.testing.assert_array_equal(filled[valid], ramp[valid].astype(np.float32))
    saturated = LightField(np.where(valid, ramp, 99), valid=valid)
    assert np.all(saturated.filled[~valid] == 99)
    np.testing.assert_array_equal(align_views(saturated, 0.0, [(0, 0)])[0], saturated.filled[0, 0])
    blind = LightField(ramp, valid=np.zeros(ramp.shape))
    np.testing.assert_array_equal(blind.filled, ramp.astype(np.float32))


def test_a_light_field_carries_what_is_known():
    views = np.arange(24.0).reshape(2, 2, 2, 3)
    valid = views != 7
    light_field = LightField(np.stack([views, views], axis=-1), valid=valid.astype(np.uint8))
    assert light_field.valid.dtype == bool
    np.testing.assert_array_equal(light_field.grey().valid, valid)
    assert light_field.unknown.startswith("1 of the 24 pixels")
    assert LightField(views, valid=np.ones(views.shape)).valid is None
    assert LightField(views).unknown == ""
    held = np.where(valid, views, 0)
    mean = np.array([[9.0, 10, 11], [12, 13, 14]])
    mean[0, 1] = (1 + 13 + 19 + (6 + 8 + 10 + 0.5 * (9 + 11)) / 4) / 4  # filled from around
    np.testing.assert_allclose(LightField(held, valid=valid).photograph, mean, rtol=1e-6)
