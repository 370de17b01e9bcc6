"""Emission by a law that was measured with targets: as by the camera itself, and as it is."""

from dataclasses import replace

import numpy as np
import pytest
from builders import record_ball
from checkerboards import Bench

from experiments.emission.truth import Lens, Sheet, cells, record
from lf_flame import PAPER_CAMERA, LightField
from lf_flame.calibration import fit_targets, measure_target
from lf_flame.tomography import (
    AxisymmetricGrid,
    FrustumGrid,
    depth_blur,
    find_axis,
    reconstruct,
    reconstruct_axisymmetric,
)

LENS = Lens(lenslets=(40, 48))
CAMERA = replace(PAPER_CAMERA, views=7, lenslets=(40, 48))
ZERO = 330.0
"""Distance from the lens to the user's zero, 4 mm behind the focal plane."""


@pytest.fixture(scope="module")
def law():
    """Law from three checkerboards before the lens of the tests' own rays."""
    bench = Bench(LENS.focal, LENS.focus, LENS.pitch, LENS.step, LENS.views, LENS.lenslets)
    depths = [-12.0, -4.0, 4.0]
    boards = [measure_target(bench.picture(ZERO + z, 0.95, fine=3)) for z in depths]
    return fit_targets(depths, boards, square_mm=0.95).law


@pytest.fixture(scope="module")
def flame():
    """Two sheets, their views with noise, and their emission in the cells of each depth."""
    sheets = [Sheet(3.0, (0.1, -1.0), (0.9, 0.45)), Sheet(-4.0, (0.0, 1.0), (0.8, 0.4))]
    views = record(LENS, sheets)
    noise = np.random.default_rng(0).standard_normal(views.shape)
    truth = np.array([cells(LENS, one) for one in sheets])
    return LightField(views + 0.005 * views.max() * noise), truth


def distance(one, other):
    return np.linalg.norm(one - other) / np.linalg.norm(other)


@pytest.mark.slow
def test_emission_by_the_law_is_that_by_the_camera(law, flame):
    light_field, truth = flame
    own = FrustumGrid(CAMERA, [3.0, -4.0])
    measured = FrustumGrid(law, [LENS.focus + z - ZERO for z in (3.0, -4.0)])
    by_camera, by_law = (reconstruct(light_field, grid) for grid in (own, measured))
    assert distance(by_law.emission, by_camera.emission) < 2e-3
    assert distance(by_law.emission, truth) < 5e-3
    assert by_law.warnings == ()
    for plane, depth in enumerate((3.0, -4.0)):
        size = LENS.cell * (1 + depth / LENS.focus)
        assert measured.cell_mm(measured.depths_mm[plane]) == pytest.approx(size, rel=5e-4)
    assert depth_blur(law, 1.0) == pytest.approx(LENS.focus / (7 * LENS.step), rel=0.01)


@pytest.mark.slow
def test_views_are_brought_to_the_brightness_that_the_law_holds(law, flame):
    fall = 1 - 0.03 * np.hypot(*np.mgrid[-3:4, -3:4])
    darker = LightField(flame[0].views * fall[..., None, None])
    depths = [-1.0, -8.0]
    known = replace(law, fall_off=tuple(map(tuple, fall.tolist())))
    found = reconstruct(darker, FrustumGrid(known, depths))
    assert distance(found.emission, flame[1]) < 0.01
    assert distance(reconstruct(darker, FrustumGrid(law, depths)).emission, flame[1]) > 0.05


@pytest.mark.slow
def test_a_ball_of_light_by_the_law_is_that_by_the_camera(law):
    """Its axis is found at the depth from the user's zero, its emission in mm of the law."""
    width, at = 0.7, LENS.focus - ZERO
    views = record_ball(LENS, 2.0, 0.3, width)
    axis = find_axis(LightField(views), law)
    assert (axis.across_mm, axis.depth_mm) == pytest.approx((0.3, 2.0 + at), abs=0.02)
    found = reconstruct_axisymmetric(LightField(views), AxisymmetricGrid(law, 0.3, 2.0 + at, 1.9))
    heights, radii = found.grid.heights_mm[:, None], found.grid.radii_mm
    truth = np.exp(-(heights**2 + radii**2) / width**2) / width / np.sqrt(np.pi)
    weight = np.sqrt(radii)
    assert distance(found.emission * weight, truth * weight) < 0.01
    assert found.warnings == ()
    masked = LightField(views, weights=np.arange(49).reshape(7, 7) != 25)
    found = reconstruct_axisymmetric(masked, found.grid, bootstrap=0)
    assert [w[:24] for w in found.warnings[-1:]] == ["The axis is not checked: "[:24]]


@pytest.mark.slow
def test_the_axis_is_checked_in_views_whose_distortion_is_undone_once(law):
    """15 pixels from the centre, twice would be a third of a pixel off."""
    known = replace(law, distortion=1e-4)
    light_field = LightField(record_ball(LENS, 2.0, 1.9, 0.7))
    axis = find_axis(light_field, known)
    grid = AxisymmetricGrid(known, axis.across_mm, axis.depth_mm, 1.9)
    found = reconstruct_axisymmetric(light_field, grid, bootstrap=0)
    assert not [warning for warning in found.warnings if "was stated" in warning]
