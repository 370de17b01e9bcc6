"""Denoisers behind shift-and-sum."""

import numpy as np
import pytest

from lf_flame.systems.denoised import (
    Denoised,
    estimate_electron,
    non_local_means,
    total_variation,
)
from lf_flame.systems.formulas import ShiftAndSum

DENOISERS = [non_local_means, total_variation]


@pytest.fixture
def clean():
    """Squares of some grey levels, on black and on grey."""
    image = np.zeros((90, 120))
    image[20:60, 20:50], image[40:80, 60:100] = 0.9, 0.5
    return image + 0.05


@pytest.mark.parametrize("electrons", [30, 300, 10_000])
def test_an_electron_is_found_beside_edges(clean, rng, electrons):
    found = estimate_electron(rng.poisson(clean * electrons) / electrons)
    assert found == pytest.approx(1 / electrons, rel=0.15)


def test_what_is_dark_tells_nothing_of_the_noise(rng):
    image = np.zeros((90, 120))
    image[:, :40] = rng.poisson(50, (90, 40)) / 100
    assert estimate_electron(image) == pytest.approx(0.01, rel=0.15)
    assert estimate_electron(np.zeros((9, 9))) == 0


@pytest.mark.parametrize("denoise", DENOISERS)
@pytest.mark.parametrize("noise", [0.02, 0.1])
def test_noise_goes_and_edges_stay(clean, rng, denoise, noise):
    noisy = clean + rng.normal(0, noise, clean.shape)
    cleaned = denoise(noisy, noise)
    error = np.sqrt(np.mean((cleaned - clean) ** 2))
    assert error < noise / 2.5
    assert cleaned[40, 30] - cleaned[40, 10] == pytest.approx(0.9, abs=2 * noise)


def test_total_variation_takes_as_much_as_the_noise_is(clean, rng):
    noisy = clean + rng.normal(0, 0.05, clean.shape)
    taken = total_variation(noisy, 0.05) - noisy
    assert np.sqrt(np.mean(taken**2)) == pytest.approx(0.05, rel=0.02)


@pytest.mark.parametrize("denoise", DENOISERS)
@pytest.mark.parametrize("colours", [(), (3,)])
def test_a_light_field_in_low_light_gains_and_a_clean_one_stays(rng, clean, denoise, colours):
    channels = np.linspace(0.5, 1, 3) if colours else np.ones(())
    views = np.broadcast_to(np.multiply.outer(clean, channels), (3, 3, 90, 120, *colours))
    views = views.astype(np.float32)
    plain = ShiftAndSum()
    system = Denoised(plain, denoise, "denoised")
    truth = plain.refocus(views, [0.0])
    np.testing.assert_allclose(system.refocus(views, [0.0]), truth, atol=1e-6)
    dark = rng.poisson(views * 20).astype(np.float32) / 20
    errors = [np.mean((one.refocus(dark, [0.0]) - truth) ** 2) for one in (plain, system)]
    assert errors[1] < errors[0] / 3
    level = system.refocus(dark, [0.0])[0][:15, 110:].mean()
    assert level == pytest.approx(truth[0][:15, 110:].mean(), rel=0.08)
    assert system.view_indices(3, 3) == plain.view_indices(3, 3)


@pytest.mark.parametrize("denoise", DENOISERS)
def test_light_is_kept_down_to_some_electrons(rng, denoise):
    """The inverse of the root is that of the mean root, not of each."""
    flat = rng.poisson(4, (1, 1, 60, 80)).astype(np.float32) / 8
    cleaned = Denoised(ShiftAndSum(), denoise, "denoised").refocus(flat, [0.0])
    assert cleaned.mean() == pytest.approx(flat.mean(), rel=0.02)
    assert cleaned.std() < flat.std() / 3
