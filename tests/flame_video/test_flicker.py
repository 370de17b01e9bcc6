"""Frequencies of sines that are known, with noise, gaps and uneven times."""

import numpy as np
import pytest

from lf_flame.flame_video import find_flicker, measure_flame, row_error
from lf_flame.flame_video.flicker import FALSE_ALARM


def sine(times, frequency, amplitude=2.0, phase=0.7, mean=30.0):
    return mean + amplitude * np.sin(2 * np.pi * frequency * times + phase)


@pytest.mark.parametrize("frequency", [1.837, 12.64, 44.1])
def test_a_sine_is_found_far_below_the_resolution(frequency):
    times = np.arange(200) / 100 + 5
    found = find_flicker(times, sine(times, frequency))
    assert found.resolution_hz == pytest.approx(100 / 199)
    assert found.frequency_hz == pytest.approx(frequency, abs=1e-3 * found.resolution_hz)
    assert found.peak_hz == found.frequency_hz
    assert found.amplitude == pytest.approx(2.0, rel=1e-3)
    assert found.false_alarm < 1e-100


@pytest.mark.parametrize("seed", range(3))
def test_noise_gaps_and_a_drift_leave_the_frequency(seed):
    rng = np.random.default_rng(seed)
    times = np.sort(rng.choice(300, 180, replace=False)) / 120
    heights = sine(times, 11.3) + 3 * times + 1.5 * rng.standard_normal(180)
    heights[rng.choice(180, 20, replace=False)] = np.nan
    found = find_flicker(times, heights)
    # Standard error of a frequency: sqrt(6 / n) / (pi T) * noise / amplitude, here 0.05 Hz.
    assert found.frequency_hz == pytest.approx(11.3, abs=0.25)
    assert found.amplitude == pytest.approx(2.0, rel=0.3)
    assert found.false_alarm < FALSE_ALARM


@pytest.mark.parametrize("periods", [3.3, 4.2, 6.1])
def test_few_periods_are_not_mistaken_for_a_drift(periods):
    """Removing the drift beforehand would remove a part of the sine with it."""
    times = np.linspace(0, 1, 40)
    for phase in (0.0, 1.0, 2.0):
        found = find_flicker(times, sine(times, periods, phase=phase) - 4 * times**2)
        assert found.frequency_hz == pytest.approx(periods, abs=1e-3)


@pytest.mark.parametrize("noise", [0.0, 0.2])
@pytest.mark.parametrize("phase", [0.0, 2.0])
def test_of_too_few_periods_the_needed_duration_is_stated(noise, phase):
    """30 frames at 200 a second of a flicker at 12.5 Hz: the highest peak is not another one."""
    times, rng = np.arange(30) / 200, np.random.default_rng(3)
    heights = sine(times, 12.5, phase=phase) + noise * rng.standard_normal(30)
    found = find_flicker(times, heights)
    assert np.isnan(found.frequency_hz)
    assert found.peak_hz == pytest.approx(12.5, abs=1)
    assert f"{found.peak_hz * 29 / 200:.2g} periods in these frames;" in found.describe()
    assert f"at least 3 ({3 / found.peak_hz:.2g} s) are needed." in found.describe()


def test_the_spectrum_is_that_of_generalised_least_squares():
    """Whitened by the noise's whole covariance, where few, uneven times make all columns alike."""
    rng = np.random.default_rng(7)
    times = np.sort(rng.uniform(0, 1, 17))
    heights = sine(times, 4.1) + 5 * times**2 + 0.1 * rng.standard_normal(17)
    found = find_flicker(times, heights)
    red = np.exp(-np.abs(times[:, None] - times) / found.noise.memory_s)
    share = found.noise.white_share
    root = np.linalg.cholesky(share * np.eye(17) + (1 - share) * red)
    drift = np.vander(times - times.mean(), 4)
    for frequency, power in zip(found.frequencies_hz, found.power, strict=True):
        angle = 2 * np.pi * frequency * times
        whole = np.column_stack([drift, np.cos(angle), np.sin(angle)])
        left = []
        for base in (drift, whole):
            columns = np.linalg.solve(root, np.column_stack([base, heights]))
            fit = np.linalg.lstsq(columns[:, :-1], columns[:, -1], rcond=None)[0]
            left.append(np.sum((columns[:, -1] - columns[:, :-1] @ fit) ** 2))
        assert power == pytest.approx(1 - left[1] / left[0], abs=1e-6)
    assert np.diff(found.frequencies_hz).max() <= found.resolution_hz / 5 + 1e-9


def red_noise(rng, count, kept):
    """AR(1) noise of variance 1, by its definition; white for kept = 0."""
    noise = np.empty(count)
    noise[0] = rng.standard_normal()
    for k in range(1, count):
        noise[k] = kept * noise[k - 1] + np.sqrt(1 - kept**2) * rng.standard_normal()
    return noise


@pytest.mark.slow
@pytest.mark.parametrize("kept", [0.0, 0.8])
def test_false_alarms_are_as_frequent_as_stated(kept):
    """Within a factor of two under white and red noise: 60 series of 100 frames each."""
    rng, times = np.random.default_rng(21), np.arange(100) / 100
    found = [find_flicker(times, 30 + red_noise(rng, 100, kept)) for _ in range(60)]
    alarms = np.array([one.false_alarm for one in found])
    for stated in (0.05, 0.1, 0.2):
        counted = np.mean(alarms < stated)
        scatter = 2 * np.sqrt(stated / 60)
        assert stated / 2 - scatter < counted < 2 * stated + scatter
    assert np.mean(alarms < FALSE_ALARM) < 0.04
    above = np.array([one.power.max() > one.level for one in found])
    assert np.mean(above == (alarms < FALSE_ALARM)) > 0.95  # but for peaks between frequencies


@pytest.mark.slow
@pytest.mark.parametrize("kept", [0.4, 0.9])
def test_red_noise_hides_no_line(kept):
    """At 12 Hz the sine's amplitude is the noise's standard deviation; 100 frames."""
    rng, times = np.random.default_rng(21), np.arange(100) / 100
    found = [
        find_flicker(times, red_noise(rng, 100, kept) + sine(times, 12.0, amplitude=1.0))
        for _ in range(12)
    ]
    assert np.mean([abs(one.frequency_hz - 12) < 0.5 for one in found]) >= 0.8


@pytest.mark.slow
@pytest.mark.parametrize("size", [1.5, 4.0, 40.0])
def test_a_slow_swing_hides_no_line(size):
    """1.2 Hz within 2 s are fewer than three periods."""
    rng, times = np.random.default_rng(23), np.arange(200) / 100
    for phase in range(4):
        heights = sine(times, 12.0, amplitude=1.0, phase=phase) + 0.4 * rng.standard_normal(200)
        heights += sine(times, 1.2, amplitude=size, phase=2 * phase)
        found = find_flicker(times, heights)
        assert found.frequency_hz == pytest.approx(12, abs=0.1)
        assert found.amplitude == pytest.approx(1, abs=0.15)


def sharp_flame(height_px):
    """A column of light with a tip that is sharper than a row: pixels hold their means."""
    lit = np.clip(height_px - np.arange(30), 0, 1)[::-1]
    return lit[:, None] * np.exp(-(((np.arange(15) - 7) / 3) ** 2))


def test_a_flame_that_only_grows_does_not_flicker():
    """By 0.1 row a frame, which 100 frames a second turn into 10 rows a second."""
    times, rng = np.arange(120) / 100, np.random.default_rng(0)
    heights = np.array([measure_flame(sharp_flame(8 + 10 * time)).height for time in times])
    heights += 0.003 * rng.standard_normal(120)
    assert find_flicker(times, heights).frequency_hz == pytest.approx(10, abs=0.1)
    found = find_flicker(times, heights, resolvable=row_error())
    assert np.isnan(found.frequency_hz)
    assert found.peak_hz == pytest.approx(10, abs=0.1)
    assert "is below the accuracy of the tip's row (0.1 px)" in found.describe(unit="px")
    # A flicker is still found in it.
    found = find_flicker(times, heights + sine(times, 23.1, 0.2), resolvable=row_error())
    assert found.frequency_hz == pytest.approx(23.1, abs=0.1)


@pytest.mark.parametrize("scale", [0.0, 1e-14])
def test_constant_heights_have_no_frequency(scale):
    """Neither have those that differ by rounding, in whatever rhythm."""
    times = np.arange(50) / 100
    found = find_flicker(times, 40 * (1 + scale * np.sin(2 * np.pi * 20 * times)))
    assert np.isnan([found.frequency_hz, found.peak_hz]).all()
    assert found.false_alarm == 1
    assert "constant" in found.describe()


@pytest.mark.parametrize("drift", [lambda t: t**3 - t, np.exp, np.sqrt, lambda t: t**5])
def test_a_drift_is_no_flicker_and_hides_none(drift):
    times = np.arange(100) / 50
    drifting = 6 * drift(times) / np.ptp(drift(times))
    assert np.isnan(find_flicker(times, 20 + drifting).frequency_hz)
    found = find_flicker(times, sine(times, 7.3, amplitude=0.3) + drifting)
    assert found.frequency_hz == pytest.approx(7.3, abs=0.1)
