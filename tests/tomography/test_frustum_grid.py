"""The grid's geometry, against similar triangles and areas by hand."""

from dataclasses import replace

import numpy as np
import pytest

from experiments.emission.truth import Lens, Sheet, cells, record
from lf_flame import PAPER_CAMERA, LightField
from lf_flame.tomography import FrustumGrid, reconstruct


def test_cells_grow_with_distance_from_the_main_lens():
    """By similar triangles through the middle of the lens: a lenslet's pitch times 326 / i0."""
    grid = FrustumGrid(PAPER_CAMERA, [20.0, -10.0], 3)
    image_distance = 1 / (1 / 150 - 1 / 326)
    for depth in (20.0, 0.0, -10.0):
        wanted = 3 * 0.112 * (326 + depth) / image_distance
        assert grid.cell_mm(depth) == pytest.approx(wanted, rel=1e-12)
    edges = grid.edges_mm(0, 1)
    assert np.diff(edges) == pytest.approx(grid.cell_mm(20.0))
    assert edges[0] == pytest.approx(-edges[-1])


def test_the_grid_holds_all_that_any_view_sees(camera):
    """The outermost view's outermost ray, by two points: on the lens and in the focal plane."""
    grid = FrustumGrid(camera, [25.0, -9.0])
    half_lens = camera.view_step_mm * camera.views / 2
    half_field = camera.field_mm(0.0)[1] / 2
    for plane, depth in enumerate(grid.depths_mm):
        farthest = half_field + (half_lens + half_field) * abs(depth) / 326
        assert grid.edges_mm(plane, 1)[-1] >= farthest


@pytest.mark.slow
@pytest.mark.parametrize(("views", "whole"), [(10, 52)])
def test_behind_a_round_aperture_the_whole_views_are_fitted(views, whole):
    """The light field is that of rays drawn in the test; cut views hold what they like."""
    lens = Lens(views=views, lenslets=(48, 60))
    # A round stop as wide as the square one.
    camera = replace(PAPER_CAMERA, views=views, lenslets=(48, 60))
    stopped = replace(camera, aperture_diameter_mm=camera.aperture_mm)
    grid = FrustumGrid(stopped, [3.0, -4.0])
    corner = np.abs(np.arange(views) - (views - 1) / 2) + 0.5
    inside = corner[:, None] ** 2 + corner**2 < (views / 2) ** 2
    assert grid.view_count == inside.sum() == whole
    sheets = [Sheet(3.0, (0.2, -1.2), (1.2, 0.5)), Sheet(-4.0, (0.2, 1.2), (1.0, 0.4))]
    seen = record(lens, sheets)
    seen[~inside] *= 0.3
    found = reconstruct(LightField(seen), grid)
    truth = np.array([cells(lens, sheet) for sheet in sheets])
    assert np.linalg.norm(found.emission - truth) < 0.01 * np.linalg.norm(truth)
    assert f"{whole} of the {views**2} views are fitted" in found.warnings[0]
    assert np.array_equal(np.isfinite(found.chi_squared), inside)


def test_a_view_counts_with_the_one_on_the_other_side(camera):
    used_views = np.ones((camera.views,) * 2, bool)
    used_views[0, 1] = False
    grid = FrustumGrid(camera, [0.0], used_views=used_views)
    assert np.argwhere(~grid.used_views).tolist() == [[0, 1], [camera.views - 1, camera.views - 2]]
