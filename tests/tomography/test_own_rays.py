"""Emission of light fields by rays that the tests draw: what is found, and what is said."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from experiments.emission.truth import Lens, Sheet, cells, planck, record
from lf_flame import PAPER_CAMERA, LightField
from lf_flame.tomography import FrustumGrid, ProjectionOperator, reconstruct, two_colour_temperature
from lf_flame.tomography.figures import _depth_figure

LENS = Lens(lenslets=(40, 48))
CAMERA = replace(PAPER_CAMERA, views=7, lenslets=(40, 48))
FLAMES = [Sheet(3.0, (0.1, -1.0), (0.9, 0.45)), Sheet(-4.0, (0.0, 1.0), (0.8, 0.4))]
GRID = FrustumGrid(CAMERA, [3.0, -4.0])
CLEAN = record(LENS, FLAMES)
TRUTH = np.array([cells(LENS, flame) for flame in FLAMES])


def gaussian(views, sd, seed=0):
    noise = np.random.default_rng(seed).standard_normal(views.shape)
    return LightField(views + sd * views.max() * noise)


def photons(views, electrons, seed=0):
    rng = np.random.default_rng(seed)
    return LightField(rng.poisson(views * electrons / views.max()) * views.max() / electrons)


@pytest.mark.slow
@pytest.mark.parametrize(("background", "sd"), [(0.01, 0.02), (0.02, 0.05), (-0.01, 0.02)])
def test_a_background_is_fitted_where_a_margin_is_empty(background, sd):
    """Light within 2 %; taken for black, a background of 1 % of the peak adds 28 % of light."""
    lit = gaussian(CLEAN + background, sd)
    found, plain = reconstruct(lit, GRID), reconstruct(lit, GRID, background="none")
    assert found.background == pytest.approx(background, abs=1e-3)
    assert found.emission.sum() == pytest.approx(TRUTH.sum(), rel=0.02)
    assert found.warnings == ()
    assert abs(plain.emission.sum() / TRUTH.sum() - 1) > 0.04
    assert any("--background fit" in one for one in plain.warnings)


@pytest.mark.slow
def test_the_error_of_a_background_contains_it_in_any_noise():
    """Picked by the noise that is measured, pixels are too dark, or none is left (one of these)."""
    runs = [
        reconstruct(gaussian(CLEAN + 0.02, 0.02, seed), GRID, strength=1.0) for seed in range(8)
    ]
    assert all(one.background_sigma > 0 for one in runs)
    away = np.array([(one.background - 0.02) / one.background_sigma for one in runs])
    assert abs(away.mean()) < 3 / np.sqrt(8)
    assert np.sqrt(np.mean(away**2)) < 2


def hidden(views):
    """Views before which, at -8 mm, the lower part of the field is hidden."""
    rows = (np.arange(40) - 19.5) * LENS.cell
    at = (np.arange(7) - 3)[:, None] * LENS.step
    seen = rows + (rows - at) * -8.0 / LENS.focus < 0.3
    return views * seen[:, None, :, None]


GAINS = 1 + 0.1 * np.random.default_rng(1).standard_normal((7, 7, 1, 1))
AT_EDGE, AWAY = [Sheet(3.0, (0.0, -2.9), (0.9, 0.6))], FrustumGrid(CAMERA, [-4.0, -8.0])

WRONG = {
    "depths": (lambda views: views, FrustumGrid(CAMERA, [9.0, 6.0])),
    "hidden": (hidden, GRID),
    "gains": (lambda views: views * GAINS, GRID),
    "at the edge": (lambda views: record(LENS, AT_EDGE), AWAY),
}


@pytest.mark.slow
@pytest.mark.parametrize("what", WRONG)
def test_what_no_emission_explains_is_said_and_not_blamed_on_a_view(what):
    change, grid = WRONG[what]
    said = " ".join(reconstruct(gaussian(change(CLEAN), 0.005), grid).warnings)
    assert "No emission explains the views" in said
    assert "median view: its gain" not in said


@pytest.mark.parametrize(("axes", "level"), [((2, 3), 0.05), ((0, 1), 0.05), ((0, 1, 3), 0.01)])
def test_noise_that_neighbours_share_is_no_structure(axes, level):
    noise = np.random.default_rng(0).standard_normal(CLEAN.shape)
    for axis in axes:
        beside = np.roll(noise, 1, axis) + np.roll(noise, -1, axis)
        noise = (noise + beside / 4) / np.sqrt(1.125)
    assert reconstruct(LightField(CLEAN + level * CLEAN.max() * noise), GRID).warnings == ()


@pytest.mark.parametrize("left_out", [0, 1])
@pytest.mark.parametrize("gain", [0.8, 3.0])
def test_one_view_that_is_wrong_is_still_named(gain, left_out):
    """Beside views of weight 0, too, and one whose pixels are all unknown."""
    views, weights, valid = CLEAN.copy(), np.ones((7, 7)), np.ones(CLEAN.shape, bool)
    views[1, 5] *= gain
    weights[0, :left_out] = weights[6, 7 - left_out :] = 0
    valid[2, 1 : 1 + left_out] = False
    seen = LightField(gaussian(views, 0.005).views, weights=weights, valid=valid)
    said = " ".join(reconstruct(seen, GRID).warnings)
    assert "View 1, 5" in said
    assert "No emission explains" not in said


TIMES = stats.t(10).ppf(0.975)
"""Half-width of a bar of 95 % in standard deviations of 10 draws."""


@pytest.mark.slow
@pytest.mark.parametrize("record_noise", [gaussian, photons])
def test_error_bars_hold_the_truth(record_noise):
    """Bars of 95 %, of emission and of the temperature of two draws of one flame in two colours."""
    level = 0.02 if record_noise is gaussian else 100
    lit = 0.1 * TRUTH.max(axis=(1, 2), keepdims=True) < TRUTH
    held, sums, found, errors = [], [], [], []
    for seed in range(2):
        noisy = record_noise(CLEAN, level, seed)
        found.append(reconstruct(noisy, GRID, bootstrap=10, rng=np.random.default_rng(seed)))
        off = np.abs(found[-1].emission - TRUTH)
        held.append((off <= TIMES * found[-1].sigma)[lit])
        total = np.abs(np.sum(found[-1].emission - TRUTH, axis=(1, 2)))
        areas = np.square([GRID.cell_mm(depth) for depth in GRID.depths_mm])
        sums.append(total * areas / found[-1].light[1])
        assert (total < 0.012 * np.sum(TRUTH, axis=(1, 2))).all()
        errors.append([np.mean(np.square(x[lit])) for x in (off, found[-1].sigma)])
    (drawn,) = _depth_figure(found[0]).axes[0].containers[0][2]
    bars = [np.ptp(one[:, 1]) / 2 for one in drawn.get_segments()]
    assert bars == pytest.approx(TIMES * found[0].light[1])
    # Rather too wide than too narrow; by less than three.
    assert np.mean(held) > 0.93
    # Too narrow: planes share light, and the penalty, stronger with photons, takes up to 0.9 %.
    assert np.sqrt(np.mean(np.square(sums))) < (2.3 if record_noise is gaussian else 5.5)
    off, sigma = np.sqrt(np.mean(errors, axis=0))
    assert sigma < 3 * off
    colours, kelvin, held = (550.0, 650.0), 1800.0, []
    ratio = np.float32(np.divide(*(planck(nm, kelvin) / nm for nm in colours)))
    for green, red in zip(found, [*found[1:], found[0]], strict=True):
        soot = two_colour_temperature(
            ratio * green.emission,
            red.emission,
            wavelengths_nm=colours,
            sigmas=(ratio * green.sigma, red.sigma),
        )
        known = lit & np.isfinite(soot.kelvin)
        held.append((np.abs(soot.kelvin - kelvin) <= TIMES * soot.sigma)[known])
    # Too wide, as the record says: what is left of the correction is alike in both colours.
    assert np.mean(np.concatenate(held)) > 0.93


WIDE = [Sheet(8.0, (0.3, 0.3), (0.9, 0.8)), Sheet(-8.0, (-0.2, -0.6), (0.8, 1.0), 0.4)]


@pytest.mark.slow
def test_saturated_rays_do_not_change_the_emission_that_others_see():
    """The sensor clips at 60 % of the peak; cells that no clipped ray crosses stay as they were."""
    grid, truth = FrustumGrid(CAMERA, [8.0, -8.0]), np.array([cells(LENS, one) for one in WIDE])
    lit = gaussian(record(LENS, WIDE), 0.005).views
    level = 0.6 * lit.max()
    held, valid = np.minimum(lit, level), lit < level
    found = reconstruct(LightField(held, valid=valid), grid)
    assert f"{np.count_nonzero(~valid)} of the {valid.size} rays are unknown" in found.warnings[0]
    operator = ProjectionOperator(grid)
    crossed, every = (
        grid.crop(operator.rmatvec(rays.astype(np.float32).ravel()).reshape(grid.shape))
        for rays in (~valid, np.ones(valid.shape))
    )
    clear, shut = crossed < 0.01 * every, crossed > 0.9 * every
    plain, whole = reconstruct(LightField(held), grid), reconstruct(LightField(lit), grid)

    def bias(one, where):
        return abs((one.emission - truth)[where].mean())

    def error(one, where):
        return np.sqrt(np.square(one.emission - truth)[where].mean())

    partly = ~clear & ~shut
    assert bias(found, clear) < 2e-4 < bias(plain, clear)
    assert error(found, clear) < 0.6 * error(plain, clear)
    assert error(found, partly) < 0.2 * error(plain, partly)
    assert error(found, shut) < 0.06 < 0.15 < error(plain, shut)
    np.testing.assert_allclose(found.noise, whole.noise, rtol=0.02)
    # Draws for error bars have the noise of a sensor in rays that are unknown, too.
    assert found.fit.uneven[~valid].mean() == pytest.approx(1, abs=0.1)
    assert found.strength <= whole.strength < plain.strength  # not chosen for the clipped light
