"""Light of black bodies and soot in a camera's colours, against closed forms and quadrature."""

import re
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import quad

from experiments.emission.truth import planck
from lf_flame.errors import InputError
from lf_flame.tomography import (
    ColourCalibration,
    SpectralResponses,
    calibrate_colours,
    measure_source,
    read_colours,
    soot_temperature,
)
from lf_flame.tomography.soot_output import _uncertainties

NM = np.arange(400.0, 721.0, 10.0)
MIDDLES = (460, 540, 610)


def bell(nm, middle):
    """Response that halves 29 nm from its middle."""
    return np.exp(-(((nm - middle) / 35) ** 2))


CURVES = [bell(NM, middle) for middle in MIDDLES]
CAMERA = SpectralResponses(("blue", "green", "red"), NM, CURVES)


@pytest.mark.parametrize("kelvin", [900.0, 1800.0, 3000.0])
def test_a_broad_colour_is_the_integral_over_its_curve(kelvin):
    for colour, middle in enumerate(MIDDLES):

        def soot(nm, middle=middle):
            return bell(nm, middle) * planck(nm, kelvin) * (nm / 600) ** -1.3

        wanted, _ = quad(soot, 400, 720, points=NM[1:-1], limit=200)
        assert CAMERA.soot(kelvin, 1.3)[colour] == pytest.approx(wanted, rel=3e-4)


@pytest.mark.parametrize("step", [10, 20])
def test_wavelengths_far_apart_leave_the_temperature(step):
    """Straight lines between samples every 20 nm would give up to 13 K too much at 2,300 K."""
    fine, coarse = np.arange(380.0, 781.0, 0.1), np.arange(380.0, 781.0, step)
    camera = SpectralResponses(("green", "red"), coarse, [bell(coarse, 540), bell(coarse, 610)])
    curves = np.stack([bell(fine, 540), bell(fine, 610)])
    gains = (curves @ planck(fine, 1300.0)) / camera.black_body(1300.0)  # as of a furnace
    for kelvin in (1500.0, 1900.0, 2300.0):
        light = curves @ (planck(fine, kelvin) * (fine / 600) ** -1.0)
        found = soot_temperature(light[:, None], camera, gains=gains)
        assert found.kelvin[0] == pytest.approx(kelvin, abs=0.2)


def test_a_gap_between_two_filters_holds_no_light():
    """A spline through all rows of the table swings there to 88,000 times the filters' area."""
    nm = [479, 480, 481, 559, 560, 561, 639, 640, 641]
    filters = SpectralResponses(("blue", "green", "red"), nm, np.eye(9)[[1, 4, 7]])
    areas = filters.black_body(1800.0) / planck(np.array([480.0, 560.0, 640.0]), 1800.0)
    assert areas == pytest.approx(areas[1], rel=1e-3)  # at the ends of the table too
    assert 0.5 < areas[1] < 1.1


def test_three_broad_colours_give_temperature_and_amount_back():
    kelvin = np.array([[900.0, 1400.0], [1800.0, 2900.0]])
    light = np.array([2.0, 3.0, 5.0]).reshape(3, 1, 1) * 0.4 * CAMERA.soot(kelvin, 1.2)
    found = soot_temperature(light, CAMERA, gains=(2, 3, 5), soot_exponent=1.2)
    assert found.kelvin == pytest.approx(kelvin, abs=1e-4)
    assert found.amount == pytest.approx(0.4, rel=1e-6)


def leaky_camera(nm, leak, cut=660.0):
    """Blue, green and red that all let some light of every wavelength through, up to a cut."""
    curves = [np.exp(-(((nm - at) / wide) ** 2)) for at, wide in ((460, 35), (540, 40), (610, 40))]
    return (np.array(curves) + leak) / (1 + np.exp((nm - cut) / 8))


@pytest.mark.parametrize("leak", [0.0, 0.1])
def test_colours_that_leak_red_have_a_temperature_where_soot_glows(leak):
    """Below some 900 K, blue is all leaked red, and its ratio to red that of a hotter soot."""
    coarse, fine = np.arange(400.0, 721.0, 5.0), np.arange(400.0, 720.1, 0.1)
    camera = SpectralResponses(("blue", "green", "red"), coarse, leaky_camera(coarse, leak))
    kelvin = np.array([1100.0, 1750.0, 1900.0])
    light = leaky_camera(fine, leak) @ (planck(fine[:, None], kelvin) * (600 / fine[:, None]))
    assert soot_temperature(light, camera).kelvin == pytest.approx(kelvin, abs=1)


def test_errors_of_three_colours_are_those_of_draws(rng):
    light = CAMERA.soot(1700.0)
    sigmas = light * [0.08, 0.02, 0.01]
    drawn = light[:, None] + sigmas[:, None] * rng.standard_normal((3, 4000))
    found = soot_temperature(drawn, CAMERA, sigmas=np.repeat(sigmas[:, None], 4000, axis=1))
    assert np.std(found.kelvin) == pytest.approx(np.mean(found.sigma), rel=0.05)
    assert np.mean(found.misfit) == pytest.approx(1, abs=0.1)
    # Weights count: without them blue, the noisiest, would decide.
    even = soot_temperature(drawn, CAMERA)
    assert np.std(even.kelvin) > 1.15 * np.std(found.kelvin)


@pytest.mark.slow
def test_errors_that_colours_share_cancel(rng):
    """Draws whose errors are the same in all colours leave the temperature; others do not."""
    light = CAMERA.soot(np.full(3, 1700.0))
    errors = light * 0.05
    shared = 1 + 0.05 * rng.standard_normal((300, 1))
    alone = 1 + 0.05 * rng.standard_normal((3, 300, 1))
    together = soot_temperature(light, CAMERA, sigmas=errors, draws=[shared * one for one in light])
    apart = soot_temperature(
        light, CAMERA, sigmas=errors, draws=[a * one for a, one in zip(alone, light, strict=True)]
    )
    linear = soot_temperature(light, CAMERA, sigmas=errors)
    assert np.all(together.sigma < 1e-3 * linear.sigma)
    assert apart.sigma == pytest.approx(linear.sigma, rel=0.12)
    with pytest.raises(InputError, match="draws must be as many for each of the 3 colours"):
        soot_temperature(light, CAMERA, sigmas=errors, draws=[np.ones((2, 3))] * 2)


def test_gains_of_a_furnace_come_back_with_their_errors(rng):
    kelvin = np.linspace(1200, 1700, 6)
    gains = np.array([3e-4, 2e-4, 1e-4])
    exposures = np.array([4, 2, 1, 1, 0.5, 0.25])
    inside = 0
    for _ in range(60):
        signals = 0.9 * gains * exposures[:, None] * CAMERA.black_body(kelvin).T
        signals *= np.exp(0.01 * rng.standard_normal(signals.shape))
        fit = calibrate_colours(kelvin, signals, CAMERA, exposures=exposures, emissivity=0.9)
        apart = np.log(fit.calibration.gains / gains)
        inside += np.sum(np.abs(apart) < fit.calibration.relative_errors)
    assert inside / 180 == pytest.approx(0.683, abs=0.1)
    assert fit.calibration.temperature_range_K == (1200, 1700)


def test_a_black_level_that_was_left_in_is_refused():
    kelvin = np.linspace(1200, 1700, 8)
    signals = CAMERA.black_body(kelvin).T
    with pytest.raises(InputError, match="No gain explains the signals of blue"):
        calibrate_colours(kelvin, signals + [0.2, 0, 0] * signals[4], CAMERA)


def test_signals_are_means_over_the_even_part():
    y, x = np.mgrid[:60, :80]
    inside = np.hypot(y - 20, x - 50) < 15
    rim = np.hypot(y - 20, x - 50) < 18
    pictures = [
        (level * (inside + 0.4 * (rim & ~inside)))[..., None] * np.array([0.1, 1.0])
        for level in (1, 5)
    ]
    found = measure_source(pictures)
    assert found.signals == pytest.approx(np.array([[0.1, 1], [0.5, 5]]))
    assert found.uneven < 0.01


def test_files_give_back_what_was_written(tmp_path):
    made = ColourCalibration(CAMERA, [1e-4, 2e-4, 3e-4], [0.01, 0.02, 0], (1200.0, 1700.0))
    (tmp_path / "colours.toml").write_text(made.to_toml())
    read = read_colours(tmp_path / "colours.toml")
    assert read.gains.tolist() == made.gains.tolist()
    assert read.relative_errors.tolist() == made.relative_errors.tolist()
    assert read.temperature_range_K == (1200.0, 1700.0)
    for name in ("values", "wavelengths_nm"):
        assert getattr(read.responses, name).tolist() == getattr(CAMERA, name).tolist()
    assert read.responses.names == CAMERA.names


def test_errors_of_gains_tilt_the_line_through_all_colours():
    """Wien's law: the logarithm of light is a line over 1 / wavelength, with the slope -c2 / T."""
    errors, names = np.array([0.15, 0.025, 0.1]), (450.0, 550.0, 650.0)
    x = 1e9 / np.array(names)
    kelvin = 1500**2 * np.linalg.norm((x - x.mean()) * errors) / (0.0143878 * len(x) * x.var())
    colours = {"gains": np.ones(3), "responses": SpectralResponses.single(names)}
    known = SimpleNamespace(**colours, relative_errors=errors)
    _, said = _uncertainties(SimpleNamespace(kelvin=np.array([1500.0])), known, 1.0)
    assert float(re.search(r"of (\d+) K", said)[1]) == pytest.approx(kelvin, rel=0.03)
