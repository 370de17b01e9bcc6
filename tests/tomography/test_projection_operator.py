"""The operator is the simulation, and its adjoint is its adjoint."""

from dataclasses import replace

import numpy as np
import pytest

from lf_flame import PAPER_CAMERA, render
from lf_flame.refocus import shift_and_sum
from lf_flame.tomography import FrustumGrid, ProjectionOperator

GRIDS = {
    "slopes above 1, focus, before and behind": ([40.0, 6.0, 0.0, -7.5], 1),
    "blocks": ([12.0, -12.0], 2),
    "one plane": ([3.0], 3),
}


@pytest.fixture(params=GRIDS)
def grid(request, camera):
    return FrustumGrid(camera, *GRIDS[request.param])


@pytest.mark.slow
def test_it_equals_rendering(grid, camera):
    """Of random cells, averaged over blocks after rendering."""
    cells = np.random.default_rng(1).random(grid.shape)
    rendered = render(grid.scene(cells), camera, tolerance=1e-9).views
    (t, s), block = grid.pixels, grid.block
    wanted = rendered.reshape(7, 7, t, block, s, block).mean(axis=(3, 5), dtype=np.float64)
    found = ProjectionOperator(grid, "float64").matvec(cells.ravel()).reshape(wanted.shape)
    assert found == pytest.approx(wanted, abs=1e-6 * wanted.max())


@pytest.mark.parametrize(("dtype", "tolerance"), [("float32", 1e-6), ("float64", 1e-12)])
def test_inner_products_agree_across_it(grid, dtype, tolerance):
    operator, rng = ProjectionOperator(grid, dtype), np.random.default_rng(2)
    cells = rng.standard_normal(operator.shape[1]).astype(dtype)
    views = rng.standard_normal(operator.shape[0]).astype(dtype)
    seen, back = operator.matvec(cells), operator.rmatvec(views)
    assert seen.dtype == back.dtype == np.dtype(dtype)
    left = np.vdot(seen.astype(np.float64), views)
    right = np.vdot(cells.astype(np.float64), back)
    scale = np.linalg.norm(seen) * np.linalg.norm(views)
    assert abs(left - right) <= tolerance * scale


def test_the_adjoint_of_a_plane_in_focus_is_the_photograph():
    """At depth 0 each lenslet sees its own cell alone: the sum over views, as shift-and-sum."""
    camera = replace(PAPER_CAMERA, views=5, lenslets=(8, 10))
    grid = FrustumGrid(camera, [0.0])
    views = np.random.default_rng(3).random((5, 5, 8, 10)).astype(np.float32)
    back = ProjectionOperator(grid).rmatvec(views.ravel()).reshape(grid.shape)
    wanted = 25 * shift_and_sum(views, [0.0])
    assert grid.crop(back) == pytest.approx(wanted, rel=1e-5)
