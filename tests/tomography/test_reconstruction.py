"""Emission found again from light fields that the simulation made, where naive ways fail."""

import numpy as np
import pytest

from lf_flame import InputError, Layer, LightField, Scene, render
from lf_flame.refocus import shift_and_sum
from lf_flame.tomography import FrustumGrid, ReconstructionPlan, reconstruct
from lf_flame.tomography.frustum_grid import planes_between
from lf_flame.tomography.resolution import NO_DEPTH

DEPTHS = (3.0, 0.0, -4.0)


def worst_error(found, truth):
    return max(np.linalg.norm(a - b) / np.linalg.norm(b) for a, b in zip(found, truth, strict=True))


@pytest.mark.parametrize(
    ("share", "limit"), [(0.0, 0.02), pytest.param(0.05, 0.06, marks=pytest.mark.slow)]
)
def test_planes_are_found_where_refocused_images_are_wrong(grid, truth, noisy, fits, share, limit):
    found = fits(share)
    assert worst_error(found.emission, truth) < limit
    assert found.emission.min() >= 0
    assert worst_error(shift_and_sum(noisy(share), grid.slopes), truth) > 1.2
    assert found.warnings == ()


@pytest.mark.slow
def test_a_glow_without_detail_is_shared_among_depths_and_not_told(camera):
    """An even field: no depth is right, and the total is."""
    grid = FrustumGrid(camera, [6.0, -6.0])
    even = LightField(np.full((7, 7, 54, 60), 0.5, np.float32))
    found = reconstruct(even, grid, background="none")
    middle = found.emission[:, 24:30, 25:35]
    assert middle.sum(axis=0) == pytest.approx(0.5, rel=0.06)
    assert any(one.startswith(NO_DEPTH) for one in found.warnings)


@pytest.mark.slow
def test_depths_of_light_are_found_on_a_stack(camera, flames, clean):
    grid = FrustumGrid(camera, planes_between(-6.5, 5.5, 1))
    found = reconstruct(clean, grid)
    depths = np.array(grid.depths_mm)
    right = FrustumGrid(camera, DEPTHS)
    for plane, layer in enumerate(flames.layers):
        cells = right.crop(right.average(layer, plane))
        light = found.emission[:, cells > 0.3 * cells.max()].sum(axis=1, dtype=np.float64)
        near = np.abs(depths - layer.depth_mm) < 3
        assert light[near] @ depths[near] / light[near].sum() == pytest.approx(
            layer.depth_mm, abs=0.5
        )


def test_blocks_average_the_light_field(camera, flames, clean):
    grid = FrustumGrid(camera, DEPTHS, 2)
    truth = np.stack([grid.crop(grid.average(one, p)) for p, one in enumerate(flames.layers)])
    assert worst_error(reconstruct(clean, grid).emission, truth) < 0.1


@pytest.mark.slow
def test_a_frame_starts_from_the_one_before(grid, clean, noisy):
    """It finds what it finds alone, of a flame that has moved, and grown half as bright again."""
    plan = ReconstructionPlan(grid)
    first = plan.reconstruct(noisy(0.01))
    moved = LightField(1.5 * np.roll(noisy(0.01, 1).views, (2, -1), (2, 3)))
    found = plan.reconstruct(moved, start=first)
    alone = reconstruct(moved, grid, strength=first.strength)
    assert found.strength == first.strength
    assert found.noise == pytest.approx(0.015 * clean.views.max(), rel=0.02)
    off = found.emission - alone.emission
    assert np.sqrt(np.mean(off**2)) < 2e-4 * alone.emission.max()
    other = ReconstructionPlan(FrustumGrid(grid.camera, (3.0, -4.0)))
    with pytest.raises(InputError, match="start must be a reconstruction on the plan's grid"):
        other.reconstruct(moved, start=first)


def test_darkness_gives_darkness(grid, camera):
    found = reconstruct(LightField(np.zeros((7, 7, 54, 60), np.float32)), grid)
    assert not found.emission.any()


def test_faint_light_that_many_pixels_see_is_kept(camera, flames):
    """An even faint disc, fainter than the noise of a pixel, but seen by thousands of them."""
    y, x = np.mgrid[-1:1:80j, -1:1:80j]
    glow = 0.03 * (np.hypot(y, x) < 0.8)
    sheet = Layer(glow, -4.0, (6.0, 6.0))
    scene = Scene([flames.layers[0], sheet])
    grid = FrustumGrid(camera, [3.0, -4.0])
    views = render(scene, camera).views
    noise = np.random.default_rng(5).standard_normal(views.shape, dtype=np.float32)
    noisy = LightField(views + np.float32(0.05 * views.max()) * noise)
    truth = grid.crop(grid.average(sheet, 1))
    found = reconstruct(noisy, grid).emission[1]
    assert found.sum() == pytest.approx(truth.sum(), rel=0.1)
