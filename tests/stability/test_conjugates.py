"""Units of length, and lenses without power: what the list of hard cases leaves out."""

from dataclasses import replace

import numpy as np
import pytest
from builders import OPTICS

from lf_flame import PAPER_CAMERA
from lf_flame.optics.ray_transfer import chain, free_space, thin_lens


def in_unit(scale):
    return replace(PAPER_CAMERA, **{name: length * scale for name, length in OPTICS.items()})


@pytest.mark.parametrize("scale", [1e3, 1e-3])
def test_matrices_and_slopes_in_other_units_are_similar(scale):
    """B scales with the unit and C against it; A, D and the slope stay."""
    camera = in_unit(scale)
    similar = PAPER_CAMERA.object_to_array(0.01) * [[1, scale], [1 / scale, 1]]
    np.testing.assert_allclose(
        camera.object_to_array(0.01 * scale), similar, rtol=1e-14, atol=1e-13 * scale
    )
    slope = PAPER_CAMERA.depth_to_slope(0.01)
    assert camera.depth_to_slope(0.01 * scale) == pytest.approx(slope, rel=16 * 2.0**-53)


def test_a_unit_that_is_a_power_of_two_changes_no_digit():
    unit = 2.0**20
    assert in_unit(unit).depth_to_slope(20.0 * unit) == PAPER_CAMERA.depth_to_slope(20.0)
    assert in_unit(unit).slope_to_depth(2.1) == PAPER_CAMERA.slope_to_depth(2.1) * unit


def test_a_lens_of_infinite_focal_length_is_not_there():
    path = free_space(326.0), thin_lens(np.inf), free_space(277.0)
    np.testing.assert_array_equal(chain(*path), free_space(326.0 + 277.0))


@pytest.mark.parametrize("lengths", [(0.1, 0.2), (33.0, 77.0), (12.7, 25.4)])
def test_a_telescope_has_no_power_up_to_rounding(lengths):
    f1, f2 = lengths
    power = chain(thin_lens(f1), free_space(f1 + f2), thin_lens(f2))[1, 0]
    assert abs(power) <= 16 * 2.0**-53 * (1 / f1 + 1 / f2)
