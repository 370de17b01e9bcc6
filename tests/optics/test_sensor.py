import numpy as np
import pytest

from lf_flame.optics import sensor
from lf_flame.optics.sensor import STAGES, Sensor, expose

ALL = frozenset(STAGES)
PIXELS = 100_000


def flat_field(electrons, exposure_e=1000.0):
    return np.full(PIXELS, electrons / exposure_e, np.float32)


@pytest.mark.parametrize("mean", [0.5, 8.0, 500.0])
def test_shot_noise_is_poisson(rng, mean):
    counts = expose(flat_field(mean), Sensor(1000.0), {"shot_noise"}, rng) * 1000.0
    np.testing.assert_allclose(counts, np.rint(counts), atol=1e-3)
    # five standard errors; the fourth central moment of a Poisson law is mean + 3 mean^2
    assert np.mean(counts) == pytest.approx(mean, abs=5 * np.sqrt(mean / PIXELS))
    spread = np.sqrt((mean + 2 * mean**2) / PIXELS)
    assert np.var(counts, dtype=float) == pytest.approx(mean, abs=5 * spread)
    none = np.mean(np.abs(counts) < 0.5)
    margin = 5 * np.sqrt(np.exp(-mean) / PIXELS) + 1e-12
    assert none == pytest.approx(np.exp(-mean), abs=margin)


def test_shot_noise_of_bright_pixels_keeps_mean_and_variance(rng):
    mean = 4e9
    image = np.full(PIXELS, 1.0, np.float32)
    counts = expose(image, Sensor(mean), {"shot_noise"}, rng).astype(float) * mean
    assert np.mean(counts) == pytest.approx(mean, abs=5 * np.sqrt(mean / PIXELS))
    # float32 holds these to 240 or 480 electrons, 0.4 to 0.8 % of the noise in square
    assert np.var(counts) == pytest.approx(mean, rel=5 * np.sqrt(2 / PIXELS) + 0.01)


def test_the_two_laws_of_shot_noise_meet(rng, monkeypatch):
    image = flat_field(2000.0)
    poisson = expose(image, Sensor(1000.0), {"shot_noise"}, rng)
    monkeypatch.setattr(sensor, "MOST_COUNTED", 1000.0)
    normal = expose(image, Sensor(1000.0), {"shot_noise"}, rng)
    assert not np.array_equal(poisson, normal)
    shares = [0.01, 0.1, 0.5, 0.9, 0.99]
    few, many = (np.quantile(counts, shares) for counts in (poisson, normal))
    np.testing.assert_allclose(few, many, rtol=2e-3)


def test_photon_transfer_of_the_whole_chain(rng):
    """EMVA 1288: var = K^2 var_dark + 1/12 + K (mean - mean_dark), in digital numbers."""
    camera = Sensor(1000.0, full_well_e=10_000.0, bits=10, read_noise_e=15.0)
    gain = 1 / camera.step_e
    for mean in (300.0, 2000.0, 6000.0):
        numbers = expose(flat_field(mean), camera, ALL, rng).astype(float) * 1000.0 * gain
        variance = gain**2 * 15.0**2 + 1 / 12 + gain * (gain * mean)
        assert np.mean(numbers) == pytest.approx(gain * mean, abs=5 * np.sqrt(variance / PIXELS))
        assert np.var(numbers) == pytest.approx(variance, rel=6 * np.sqrt(2 / PIXELS))


def test_read_noise_is_normal_and_adds_to_dark_and_negative_pixels(rng):
    camera = Sensor(100.0, read_noise_e=3.0)
    for level in (0.0, -0.5, 2.0):
        image = np.full(PIXELS, level, np.float32)
        noise = (expose(image, camera, {"read_noise"}, rng).astype(float) - level) * 100.0
        assert np.mean(noise) == pytest.approx(0, abs=5 * 3 / np.sqrt(PIXELS))
        assert np.std(noise) == pytest.approx(3, rel=5 / np.sqrt(2 * PIXELS))
        assert np.mean(np.abs(noise) < 3) == pytest.approx(0.6827, abs=0.01)


def test_negative_radiance_passes_the_shot_noise_unchanged(rng):
    """It is no light, so nothing is counted; a mean over pixels stays what it was."""
    image = np.array([-1e9, -3.0, -0.37, -1e-4], np.float32)
    np.testing.assert_allclose(expose(image, Sensor(1000.0), {"shot_noise"}, rng), image, rtol=1e-6)


@pytest.mark.parametrize("bits", [1, 8, 12, 16])
def test_quantisation_rounds_to_the_nearest_code(rng, bits):
    camera = Sensor(5000.0, bits=bits)
    image = rng.uniform(0, 2, 5000).astype(np.float32)
    numbers = expose(image, camera, {"quantisation"}, rng).astype(float) * 5000.0 / camera.step_e
    np.testing.assert_allclose(numbers, np.rint(numbers), atol=0.01)
    error = np.abs(numbers - image.astype(float) * 5000.0 / camera.step_e)
    assert 0.45 < error.max() <= 0.51
    assert len(np.unique(np.rint(numbers))) <= 2**bits


def test_quantisation_alone_has_no_highest_number_and_keeps_noise_about_black():
    camera = Sensor(1000.0, full_well_e=1000.0, bits=2)
    image = np.array([-3.0, -0.1, 0.2, 1.4, 7.1], np.float32)
    rounded = expose(image, camera, {"quantisation"}, np.random.default_rng(0))
    np.testing.assert_allclose(rounded, np.array([-9, 0, 1, 4, 21]) / 3, rtol=1e-6)


def test_saturation_clips_at_the_full_well(rng):
    camera = Sensor(1000.0, full_well_e=1000.0)
    image = np.array([-1.0, 0.3, 0.999, 1.0, 1.001, 50.0], np.float32)
    clipped = expose(image, camera, {"saturation"}, rng)
    np.testing.assert_array_equal(clipped, np.minimum(image, 1))


@pytest.mark.parametrize("kept", [STAGES, ["shot_noise"], ["saturation", "quantisation"]])
def test_darkness_stays_dark_without_read_noise(rng, kept):
    black = expose(np.zeros((3, 4, 5)), Sensor(1e6), set(kept) - {"read_noise"}, rng)
    assert np.all(black == 0)


def test_boundless_light_saturates_and_stays_finite(rng):
    image = np.array([0.0, 1.0, 1e10, 1e30, 3e38], np.float32)
    camera = Sensor(1e12, full_well_e=1e12)
    np.testing.assert_allclose(expose(image, camera, ALL, rng), [0, 1, 1, 1, 1], atol=1e-5)
    unbound = expose(image, camera, ALL - {"saturation", "quantisation"}, rng)
    np.testing.assert_allclose(unbound, image, rtol=1e-5, atol=1e-5)


def test_noise_does_not_depend_on_the_parts_it_is_drawn_in(monkeypatch):
    image = np.geomspace(1e-2, 1e8, 700, dtype=np.float32).reshape(7, 100)
    whole = expose(image, Sensor(1000.0, 1e12), ALL, np.random.default_rng(3))
    monkeypatch.setattr(sensor, "PIXELS_AT_ONCE", 37)
    parts = expose(image, Sensor(1000.0, 1e12), ALL, np.random.default_rng(3))
    np.testing.assert_array_equal(whole, parts)
