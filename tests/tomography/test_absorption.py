"""Absorption is as the simulator composes it, front to back, and what it takes is given back."""

from dataclasses import replace

import numpy as np
import pytest

from lf_flame import Layer, LightField, Scene, render
from lf_flame.scenes.flames import flame_texture
from lf_flame.tomography import (
    AbsorbingOperator,
    FrustumGrid,
    ProjectionOperator,
    ReconstructionPlan,
    reconstruct,
)
from lf_flame.tomography.absorption import spread_thickness
from lf_flame.tomography.resolution import NO_DEPTH

DEPTHS = (3.0, 0.0, -4.0)
TOTAL = 0.5


def operator_of(grid, thickness, dtype="float64"):
    return AbsorbingOperator(grid, spread_thickness(grid, thickness), dtype)


def worst(found, wanted):
    """Largest difference; quicker than comparing one by one."""
    return float(np.max(np.abs(found - wanted)))


def views_of(operator, cells):
    return operator.matvec(cells.ravel()).reshape(operator.dimsd)


def smooth_thickness(grid, total):
    """A bump in each plane, off the middle, another in each."""
    y, x = (np.linspace(-1, 1, count) for count in grid.pixels)
    bumps = [
        np.exp(-(((y[:, None] - 0.2) / 0.5) ** 2) - ((x - place) / 0.4) ** 2)
        for place in np.linspace(-0.4, 0.3, grid.shape[0])
    ]
    return np.array(bumps) * total / np.sum(bumps, axis=0).max()


@pytest.mark.parametrize(("dtype", "tolerance"), [("float32", 1e-6), ("float64", 1e-12)])
@pytest.mark.parametrize("block", [1, 2])
def test_inner_products_agree_across_it(camera, dtype, tolerance, block):
    grid = FrustumGrid(camera, [40.0, 6.0, -7.5], block)
    operator, rng = operator_of(grid, smooth_thickness(grid, 0.8), dtype), np.random.default_rng(2)
    cells = rng.standard_normal(operator.shape[1]).astype(dtype)
    views = rng.standard_normal(operator.shape[0]).astype(dtype)
    seen, back = operator.matvec(cells), operator.rmatvec(views)
    assert seen.dtype == back.dtype == np.dtype(dtype)
    left = np.vdot(seen.astype(np.float64), views)
    right = np.vdot(cells.astype(np.float64), back)
    assert abs(left - right) <= tolerance * np.linalg.norm(seen) * np.linalg.norm(views)


@pytest.mark.parametrize("depths", [DEPTHS, DEPTHS[::-1]])
def test_even_absorbers_take_the_share_of_the_equation_of_transfer(camera, depths):
    """Random cells in and behind even matter; each plane is rendered alone, as light only adds."""
    grid = FrustumGrid(camera, depths)
    cells = np.random.default_rng(1).random(grid.shape)
    thickness = np.array([0.1, 0.25, 0.4])
    wanted = np.zeros(operator_of(grid, thickness).dimsd)
    for depth, tau, layer in zip(depths, thickness, grid.scene(cells).layers, strict=True):
        before = thickness[np.array(depths) < depth].sum()
        share = np.exp(-before) * -np.expm1(-tau) / tau
        wanted += share * render(Scene([layer]), camera, tolerance=1e-9).views
    found = views_of(operator_of(grid, thickness), cells)
    assert worst(found, wanted) < 1e-6 * wanted.max()


@pytest.mark.slow
def test_views_that_are_not_fitted_neither_see_nor_count(camera, rng):
    """The operator's views are some of all; the mean transmission is that of these alone."""
    full = FrustumGrid(camera, [8.0, -6.0])
    used_views = np.abs(np.subtract(*np.indices((camera.views,) * 2))) < 3
    grid = replace(full, used_views=used_views)
    thickness = spread_thickness(grid, smooth_thickness(grid, 1.0))
    some, every = (AbsorbingOperator(one, thickness, "float64") for one in (grid, full))
    cells = rng.uniform(size=grid.shape).ravel()
    views = every.matvec(cells).reshape(every.dimsd)
    assert worst(some.matvec(cells).reshape(some.dimsd), views[used_views][:, None]) < 1e-12
    noise = rng.uniform(size=some.dimsd)
    assert np.vdot(some.matvec(cells), noise) == pytest.approx(cells @ some.rmatvec(noise.ravel()))
    ones = np.ones(int(np.prod(some.dimsd)))
    seen, even = (one.rmatvec(ones) for one in (some, ProjectionOperator(grid, "float64")))
    share = (seen[even > 0] / even[even > 0]).ravel()
    found = some.mean_transmission().ravel()[even > 0]
    np.testing.assert_allclose(found, share, rtol=1e-9)
    assert worst(found, every.mean_transmission().ravel()[even > 0]) > 1e-4


def in_line(total):
    """Three flames behind each other that absorb where they glow."""
    layers = []
    for depth, x, height in ((3.0, 0.0, 4.8), (0.0, 0.2, 4.1), (-4.0, 0.1, 3.4)):
        glow = flame_texture(height, 0.45, cell_mm=0.06)
        tau = total / 3 * glow / glow.max()
        layers.append(Layer(glow, depth, (height, 2.88), (0.2, x), optical_thickness=tau))
    return Scene(layers)


class Recorded:
    """Rendered once: views without noise, emission and thickness on the central view's pixels."""

    def __init__(self, grid, scene):
        self.clean = render(scene, grid.camera, tolerance=1e-3).views
        planes = list(enumerate(scene.layers))
        self.truth = np.stack([grid.crop(grid.average(one, p)) for p, one in planes])
        matter = [Layer(x.optical_thickness, x.depth_mm, x.size_mm, x.centre_mm) for _, x in planes]
        self.tau = np.stack([grid.crop(grid.average(one, p)) for p, one in enumerate(matter)])

    def with_noise(self, share, seed=0):
        noise = np.random.default_rng(seed).standard_normal(self.clean.shape, dtype=np.float32)
        return LightField(self.clean + np.float32(share * self.clean.max()) * noise)


@pytest.fixture(scope="module")
def flames_in_line(grid):
    return Recorded(grid, in_line(TOTAL))


def worst_error(found, truth):
    return max(np.linalg.norm(a - b) / np.linalg.norm(b) for a, b in zip(found, truth, strict=True))


@pytest.mark.slow
def test_flames_that_absorb_where_they_glow_are_found(grid, flames_in_line):
    """Each as well as without absorption; the bright parts of each within 1 %."""
    truth, light_field = flames_in_line.truth, flames_in_line.with_noise(0.01)
    assert flames_in_line.tau.sum(axis=0).max() > 0.48
    found = reconstruct(light_field, grid, optical_thickness=flames_in_line.tau)
    assert worst_error(found.emission, truth) < 0.02
    assert found.emission.sum() / truth.sum() == pytest.approx(1, abs=0.02)
    for plane, true in zip(found.emission, truth, strict=True):
        bright = true > 0.5 * true.max()
        assert plane[bright].sum() / true[bright].sum() == pytest.approx(1, abs=0.01)
    assert found.noise == pytest.approx(0.01 * flames_in_line.clean.max(), rel=0.01)
    assert found.chi_squared.mean() == pytest.approx(1, abs=0.03)
    assert not [one for one in found.warnings if not one.startswith(NO_DEPTH)]


@pytest.mark.slow
def test_errors_grow_as_light_is_raised(camera, grid, noisy):
    """Of even matter: emission and error bars are each plane's, over its share."""
    thickness, rng = [0.2, 0.0, 0.6], np.random.default_rng
    options = {"strength": 0.01, "bootstrap": 2}
    plain = reconstruct(noisy(0.05), grid, rng=rng(1), **options)
    found = reconstruct(noisy(0.05), grid, rng=rng(1), optical_thickness=thickness, **options)
    share = np.array([-np.expm1(-0.2) / 0.2 * np.exp(-0.6), np.exp(-0.6), -np.expm1(-0.6) / 0.6])
    assert found.light[1] == pytest.approx(plain.light[1] / share, rel=1e-3)
    for name in ("emission", "sigma"):
        wanted = getattr(plain, name) / share[:, None, None]
        assert worst(getattr(found, name), wanted) < 1e-3 * wanted.max()
    assert found.chi_squared == pytest.approx(plain.chi_squared, rel=1e-3)
    assert found.strength == 0.01  # a strength that is given is kept


@pytest.mark.slow
def test_an_unsettled_correction_is_said(grid, flames_in_line):
    plan = ReconstructionPlan(grid, strength=0.01, optical_thickness=flames_in_line.tau)
    found = plan.reconstruct(flames_in_line.with_noise(0.01), fits=2)
    assert any("not converged" in warning for warning in found.warnings)


def test_thickness_is_laid_on_the_cells(grid):
    assert worst(spread_thickness(grid, 0.6), 0.2) < 1e-12
    by_plane = spread_thickness(grid, [0.1, 0.2, 0.3])
    assert by_plane.shape == grid.shape
    assert by_plane[:, 5, 7] == pytest.approx([0.1, 0.2, 0.3])
    given = np.random.default_rng(0).random((3, 54, 60)) / 3
    cells = spread_thickness(grid, given)
    assert np.array_equal(grid.crop(cells), given)
    assert cells[2, 0, 0] == given[2, 0, 0]
    assert cells[2, -1, 40 + grid.reach] == given[2, -1, 40]
