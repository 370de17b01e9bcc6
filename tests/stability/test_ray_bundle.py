"""Ray bundles from far out of focus to exactly in focus, and bundles of no width.

Truth is rational arithmetic on the same float64 inputs. Each test also runs a formula that
suggests itself, `naive` here, and shows that it fails what ours passes.
"""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from lf_flame import PAPER_CAMERA
from lf_flame._common.arrays import centred
from lf_flame.optics.ray_bundle import trace_footprint, trapezoid_cdf

UNIT = 2.0**-53
"""Unit roundoff of float64."""

DEFOCUS = sorted(s * 10.0**k for s in (-1, 0, 1) for k in range(-9, 4) if s * 10.0**k > -326)
"""Depths in mm, -100 to 1000, through a billionth of a mm and 0."""

as_exact = np.frompyfunc(Fraction, 1, 1)


def ramps(x, width_a, width_b):
    """Trapezoid's cumulative distribution as four ramps; exact for fractions, naive for floats."""
    outer, inner = (width_a + width_b) / 2, (width_a - width_b) / 2
    total = sum(
        sign * max(x + edge, 0 * x) ** 2
        for sign, edge in ((1, outer), (-1, inner), (-1, -inner), (1, -outer))
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        return total / (2 * width_a * width_b)


def exact_cdf(x, width_a, width_b):
    x, wide, narrow = (Fraction(n) for n in (x, max(width_a, width_b), min(width_a, width_b)))
    if narrow > 0:
        return ramps(x, wide, narrow)
    if wide > 0:
        return min(max(x / wide + Fraction(1, 2), Fraction(0)), Fraction(1))
    return Fraction(int(np.sign(x)) + 1, 2)


def exact_footprint(camera, depth, axis=0):
    """Centres, lenslet width and pixel width on a layer by similar triangles, in mm.

    The ray through height y of the array and h of the main lens crosses the focal plane at
    ``-y a0 / i0``, the conjugate of y, and goes on straight to the layer.
    """
    f, a0 = Fraction(camera.main_lens_focal_mm), Fraction(camera.focus_distance_mm)
    i0 = 1 / (1 / f - 1 / a0)
    lenslet_focal, pitch = Fraction(camera.lenslet_focal_mm), Fraction(camera.lenslet_pitch_mm)
    pixel = pitch * (1 + lenslet_focal / i0) / camera.views
    if camera.pixel_pitch_mm is not None:
        pixel = Fraction(camera.pixel_pitch_mm)

    def on_layer(y, h):
        return -y * a0 / i0 - (y * a0 / i0 + h) * Fraction(depth) / a0

    view_step = pixel * i0 / lenslet_focal
    lenslets = as_exact(centred(camera.lenslets[axis])) * pitch
    views = as_exact(centred(camera.views))[:, None] * view_step
    return -on_layer(lenslets, -views), on_layer(pitch, pitch), on_layer(0, -view_step)


def error(found, truth):
    """Largest absolute error; NaN where something is not finite."""
    found, truth = np.atleast_1d(found), np.atleast_1d(truth)
    if not np.all(np.isfinite(found)):
        return np.nan
    return float(np.abs(as_exact(found) - truth).max())


@pytest.fixture
def camera():
    return replace(PAPER_CAMERA, views=5, lenslets=(7, 270))


@pytest.mark.slow
def test_bundles_change_steadily_from_near_the_lens_to_far_away(camera):
    """Through the focal plane, where the pixel's width changes sign, and the focal length.

    Naive: blur by the image distance, ``view_step (i0 - i) / i``, carried back by ``a / i0``;
    for an object at the focal length it is infinity over infinity.
    """
    f, a0, i0 = camera.main_lens_focal_mm, camera.focus_distance_mm, camera.image_distance_mm
    depths = np.sort([*DEFOCUS, *(f * np.array([1 - 1e-12, 1, 1 + 1e-12]) - a0)])
    pixel_widths, naive, allowed = [], [], []
    for depth in np.unique(depths):
        truth, found = exact_footprint(camera, depth, 1), trace_footprint(camera, depth, 1)
        # heights and angles reach the layer over the sum of all distances, however signed
        path = (a0 + depth) + i0 + (a0 + depth) * i0 / f
        allowed.append(8 * UNIT * path * (camera.field_mm(0)[1] + camera.aperture_mm) / i0)
        assert error(found.centres_mm, truth[0]) <= allowed[-1]
        assert error(found.lenslet_width_mm, truth[1]) <= allowed[-1]
        assert error(found.pixel_width_mm, truth[2]) <= allowed[-1]
        pixel_widths.append(found.pixel_width_mm)
        with np.errstate(all="ignore"):
            i = np.float64(a0 + depth) * f / (a0 + depth - f)
            naive.append(camera.view_step_mm * (i0 - i) / i * (a0 + depth) / i0)
    assert np.all(np.diff(pixel_widths) > 0)
    assert not np.all(np.diff(naive) > 0)


def test_weights_are_exact_from_a_billionth_of_a_mm_out_of_focus_to_a_metre(camera):
    """Naive: the difference of squared ramps, divided by the width that vanishes in focus."""
    allowed, naive_error = 1e-12, {}
    for depth in DEFOCUS:
        footprint, truth = trace_footprint(camera, depth, 0), exact_footprint(camera, depth)
        widths = abs(footprint.lenslet_width_mm), abs(footprint.pixel_width_mm)
        naive_error[depth] = 0.0
        for index in ((0, 0), (2, 3), (4, 5)):
            centre = footprint.centres_mm[index]
            edges = centre + np.linspace(-1.2, 1.2, 14) * footprint.half_width_mm
            from_centre = as_exact(edges) - truth[0][index]
            exact = np.diff([exact_cdf(x, abs(truth[1]), abs(truth[2])) for x in from_centre])
            assert error(np.diff(trapezoid_cdf(edges - centre, *widths)), exact) <= allowed
            naive = [ramps(x, *map(np.float64, widths)) for x in edges - centre]
            naive_error[depth] = np.maximum(naive_error[depth], error(np.diff(naive), exact))
    assert naive_error[1e-9] > 1e3 * allowed
    assert not naive_error[0.0] <= 1e3 * allowed
