"""A round flame's half section, against a flame rendered slab by slab and Abel's closed form."""

from dataclasses import replace

import numpy as np
import pytest
from builders import record_ball

from experiments.emission.truth import Lens
from lf_flame import PAPER_CAMERA, InputError, Layer, LightField, Scene, render
from lf_flame.tomography import (
    AxisymmetricGrid,
    AxisymmetricOperator,
    find_axis,
    reconstruct_axisymmetric,
)
from lf_flame.tomography.data_checks import left_out
from lf_flame.tomography.section_problem import BandedGram

ACROSS, DEPTH, WIDTH, HOLLOW, TALL = 0.83, 4.0, 0.8, 2.5, 2.6
RADIUS = 2.7


def glow(height, radius):
    """Emission per mm of a hollow flame; it fades with distance from the middle height."""
    q = (radius / WIDTH) ** 2
    return np.exp(-((height / TALL) ** 2) * 3) * (1 + HOLLOW * q) * np.exp(-q)


def slabs(thickness=0.1, cell=0.05, glow=glow, lean=0.0):
    """The flame as thin layers, each of its own light."""
    x = (np.arange(round(2 * RADIUS / cell)) + 0.5) * cell - RADIUS
    y = 3.6 - (np.arange(round(7.2 / cell)) + 0.5) * cell
    found = []
    for z in (np.arange(round(2 * RADIUS / thickness)) + 0.5) * thickness - RADIUS:
        radius = np.hypot(x[None, :] - lean * y[:, None], z)
        texture = glow(y[:, None], radius) * thickness
        found.append(Layer(texture, DEPTH + z, (7.2, 2 * RADIUS), (0.0, ACROSS)))
    return Scene(found)


@pytest.fixture(scope="module")
def camera():
    return replace(PAPER_CAMERA, views=7, lenslets=(72, 84))


@pytest.fixture(scope="module")
def coarse(camera):
    """The same field, the mean of 2 x 2 lenslets."""
    return replace(camera, lenslets=(36, 42), lenslet_pitch_mm=0.224, lenslet_focal_mm=0.8)


@pytest.fixture(scope="module")
def seen(camera):
    return render(slabs(), camera, tolerance=1e-6)


@pytest.fixture(scope="module")
def grid(camera):
    return AxisymmetricGrid(camera, ACROSS, DEPTH, RADIUS)


@pytest.fixture(scope="module")
def truth(grid):
    return glow(grid.heights_mm[:, None], grid.radii_mm[None, :])


def volume_error(found, truth, grid):
    """Root-mean-square over the volume, relative to the flame's own."""
    weight = np.sqrt(grid.radii_mm)
    return np.linalg.norm((found - truth) * weight) / np.linalg.norm(truth * weight)


def add_noise(light_field, share, seed=0):
    views = light_field.views
    noise = np.random.default_rng(seed).standard_normal(views.shape, dtype=np.float32)
    return LightField(views + np.float32(share * views.max()) * noise)


@pytest.mark.slow
def test_operator_sees_what_the_simulation_renders(grid, truth, seen):
    views = AxisymmetricOperator(grid).matvec(truth.ravel()).reshape(seen.views.shape)
    assert np.linalg.norm(views - seen.views) < 6e-3 * np.linalg.norm(seen.views)
    # Not by chance: a per cent of scale, or a node's shift of the axis, would show.
    fit = np.vdot(views, seen.views) / np.vdot(views, views)
    assert fit == pytest.approx(1, abs=3e-3)


@pytest.mark.parametrize("which", ["all", "central"])
@pytest.mark.parametrize("block", [1, 2])
def test_adjoint_and_gram_are_the_operators(camera, which, block):
    grid = AxisymmetricGrid(camera, ACROSS, DEPTH, RADIUS, block, which, burner_mm=-2.0)
    operator, gram = AxisymmetricOperator(grid), BandedGram(grid)
    rng = np.random.default_rng(1)
    x, y = rng.standard_normal(operator.shape[1]), rng.standard_normal(operator.shape[0])
    seen = operator.matvec(x)
    assert np.vdot(seen, y) == pytest.approx(np.vdot(x, operator.rmatvec(y)), rel=1e-12)
    scaled = gram.multiply(x / gram.unit) / gram.unit
    assert scaled == pytest.approx(operator.rmatvec(seen), abs=1e-11 * np.abs(scaled).max())


def test_axis_is_found_across_and_in_depth(camera, seen):
    axis = find_axis(add_noise(seen, 0.02), camera)
    assert axis.across_mm == pytest.approx(ACROSS, abs=0.02)
    assert axis.depth_mm == pytest.approx(DEPTH, abs=0.1)
    assert abs(axis.lean_deg) < 0.3
    assert 1.8 < axis.radius_mm < 3.2
    assert axis.lopsided < 0.02
    assert axis.across_error_mm < 0.01
    assert axis.depth_error_mm < 0.1


@pytest.mark.slow
def test_lean_and_halves_are_measured(camera, coarse):
    leaning = find_axis(render(slabs(lean=0.05), camera), camera)
    assert leaning.lean_deg == pytest.approx(np.degrees(np.arctan(0.05)), rel=0.03)
    views = render(slabs(), coarse).views.copy()
    views[..., 24:] *= 1.3  # the right half
    grid = AxisymmetricGrid(coarse, ACROSS, DEPTH, RADIUS)
    said = reconstruct_axisymmetric(LightField(views), grid).warnings
    assert any("not axisymmetric" in one for one in said)


@pytest.mark.slow
def test_sharp_burner_is_followed_where_it_is_known(coarse):
    def cut(height, radius):
        return np.where(height > -1.0, glow(height, radius), 0.0)

    seen = render(slabs(glow=cut, cell=0.04), coarse)
    errors = []
    for burner in (None, -1.0):
        grid = AxisymmetricGrid(coarse, ACROSS, DEPTH, RADIUS, burner_mm=burner)
        heights = grid.heights_mm[:, None]
        truth = np.where(heights > -1.0 - 1e-9, glow(heights, grid.radii_mm), 0.0)
        found = reconstruct_axisymmetric(seen, grid)
        errors.append(volume_error(found.emission, truth, grid))
    assert errors[1] < 0.015 < 0.05 < errors[0]


@pytest.mark.slow
def test_behind_a_round_aperture_the_whole_views_are_fitted():
    """A ball of light by rays that the tests draw; views that the aperture cuts show anything."""
    lens, width = Lens(views=7, lenslets=(40, 48)), 0.7
    seen = record_ball(lens, 3.0, 0.4, width)
    corner = np.abs(np.arange(7) - 3) + 0.5
    whole = np.hypot(corner[:, None], corner) <= 3.5
    seen[~whole] *= 0.3
    camera = replace(PAPER_CAMERA, views=7, lenslets=(40, 48))
    stopped = replace(camera, aperture_diameter_mm=camera.aperture_mm)
    found = reconstruct_axisymmetric(LightField(seen), AxisymmetricGrid(stopped, 0.4, 3.0, 1.9))
    heights, radii = found.grid.heights_mm[:, None], found.grid.radii_mm
    truth = np.exp(-(heights**2 + radii**2) / width**2) / width / np.sqrt(np.pi)
    assert volume_error(found.emission, truth, found.grid) < 0.01
    assert np.array_equal(np.isfinite(found.chi_squared), whole)
    assert found.warnings[0].startswith(f"{whole.sum()} of the 49 views are fitted")
    assert len(found.warnings) == 1
    central = replace(found.grid, which="central")
    assert left_out(central, None) == []  # a choice
    with pytest.raises(InputError, match="A fit of the central view needs the view in row 3"):
        reconstruct_axisymmetric(
            LightField(seen, weights=1 - np.outer(corner == 0.5, corner == 0.5)), central
        )
    axis = find_axis(LightField(seen), stopped)
    assert (axis.across_mm, axis.depth_mm) == pytest.approx((0.4, 3.0), abs=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("finer", [1, 2])
def test_unknown_pixels_are_filled_and_said(finer):
    camera = replace(PAPER_CAMERA, views=3, lenslets=(24, 40))
    grid = AxisymmetricGrid(camera, axis_mm=0.0, depth_mm=0.0, radius_mm=1.5, finer=finer)
    glow = np.outer(np.ones(grid.shape[0]), np.exp(-4 * grid.radii_mm**2))
    operator = AxisymmetricOperator(grid)
    views = np.reshape(operator @ glow.ravel(), operator.dimsd)
    valid = np.ones(views.shape, bool)
    valid[:, :, 12, 18:20] = False
    held = np.where(valid, views, 0)
    found, plain = (
        reconstruct_axisymmetric(one, grid, bootstrap=4)
        for one in (LightField(held, valid=valid), LightField(held))
    )
    assert found.warnings[0].startswith("18 of the 8640 rays are unknown")
    error, as_held = (np.abs(one.emission - glow)[2:-2].max() for one in (found, plain))
    assert error < 0.3 * as_held
    # Draws are of this light field, not of that with the stored values.
    assert np.abs(found.draws.mean(axis=0) - found.emission)[2:-2].max() < 2e-3
    some = np.arange(views.size).reshape(views.shape) % 41 == 0  # fewer rays than nodes
    few = LightField(held, valid=some)
    with pytest.raises(InputError, match="degrees of freedom of the emission, got 211: state"):
        reconstruct_axisymmetric(few, grid)
    assert reconstruct_axisymmetric(few, grid, noise=1e-3).noise == 1e-3
