"""Temperatures against Planck's law, which the experiments write out with their own constants."""

import numpy as np
import pytest

from experiments.emission.truth import planck
from lf_flame.tomography import two_colour_temperature

COLOURS = (550.0, 650.0)


def soot_emission(wavelength_nm, kelvin, exponent=1.0):
    """Planck's radiance per wavelength times an absorption coefficient."""
    return planck(wavelength_nm, kelvin) * (wavelength_nm / 600) ** -exponent


@pytest.mark.parametrize("colours", [COLOURS, (650.0, 550.0), (900.0, 4000.0)])
@pytest.mark.parametrize("exponent", [0.0, 1.0, 1.4])
def test_temperatures_come_back(colours, exponent):
    """To a thousandth of a kelvin, where Planck's law is far from Wien's, too."""
    kelvin = np.array([[600.0, 1200.0], [1800.0, 4500.0]])
    emissions = [soot_emission(colour, kelvin, exponent) for colour in colours]
    found = two_colour_temperature(*emissions, wavelengths_nm=colours, soot_exponent=exponent)
    assert found.kelvin == pytest.approx(kelvin, abs=1e-3)
    assert found.sigma is None
    emissions[0] = emissions[0] / 2  # by a camera that sees the first colour half as bright
    options = {"wavelengths_nm": colours, "soot_exponent": exponent, "calibration": 0.5}
    assert two_colour_temperature(*emissions, **options).kelvin == pytest.approx(kelvin, abs=1e-3)


def test_errors_are_those_of_draws():
    """Linear propagation against ten thousand draws of 1 % of noise, within 5 %."""
    rng, kelvin = np.random.default_rng(0), 1800.0
    emissions = [np.full(10_000, soot_emission(colour, kelvin)) for colour in COLOURS]
    sigmas = [0.01 * emission for emission in emissions]
    noisy = [
        emission + sigma * rng.standard_normal(emission.shape)
        for emission, sigma in zip(emissions, sigmas, strict=True)
    ]
    found = two_colour_temperature(*noisy, wavelengths_nm=COLOURS, sigmas=sigmas)
    assert np.mean(found.sigma) == pytest.approx(np.std(found.kelvin), rel=0.05)
    # By Wien: T^2 / (c2 (1 / l1 - 1 / l2)), times the error of the ratio.
    wien = 1800**2 / (14.387769e6 * (1 / 550 - 1 / 650)) * 0.01 * np.sqrt(2)
    assert np.mean(found.sigma) == pytest.approx(wien, rel=0.02)


def test_what_has_no_ratio_has_no_temperature():
    first, second = (
        np.array([0.0, 1.0, -1.0, 0.0, 1e9, 1.0]),
        np.array([0.0, 0.0, 1.0, 1.0, 1.0, 1.0]),
    )
    found = two_colour_temperature(first, second, wavelengths_nm=COLOURS)
    assert np.isnan(found.kelvin[:5]).all()
    bright = soot_emission(550, 1800) / soot_emission(650, 1800)
    faint = two_colour_temperature(
        [bright] * 2, [1.0] * 2, wavelengths_nm=COLOURS, sigmas=([0.01] * 2, [0.2, 0.5])
    )
    assert faint.kelvin[0] == pytest.approx(1800, abs=1e-3)
    assert np.isnan([faint.kelvin[1], faint.sigma[1]]).all()
