"""Sooty sheets that dim each other, recorded by rays that share nothing with the reconstruction."""

from dataclasses import replace

import numpy as np
import pytest

from experiments.emission.truth import Lens, Slab, planck, trace
from lf_flame import InputError, LightField, PlenopticCamera
from lf_flame.tomography import ColourCalibration, FrustumGrid, SpectralResponses, reconstruct_soot
from lf_flame.tomography.geometries import PlaneGeometry

pytestmark = pytest.mark.slow

NM, NAMES = np.arange(380.0, 701.0, 20.0), ("red", "green", "blue")
LENS = Lens(views=5, lenslets=(36, 36))
# Depth, middle, width, optical thickness at 600 nm and temperature in the middle.
SHEETS = [(-5.0, (0.2, -0.2), (0.7, 0.6), 0.3, 1800.0), (5.0, (0.0, 0.2), (0.6, 0.7), 0.2, 1850.0)]
GRID = FrustumGrid(PlenopticCamera(**LENS.numbers()), [sheet[0] for sheet in SHEETS])


def bands(nm):
    """Responses, 67 nm wide at half height, which overlap, shape (colours, wavelengths)."""
    return np.exp(-(((nm - [[600.0], [530.0], [460.0]]) / 40) ** 2))


def in_colours(light):
    return light @ bands(NM).T * 20


def soot(sheet, y, x):
    """Optical thickness at 600 nm, a Gaussian, and temperature, which rises across it."""
    _, middle, width, thickness, hot = sheet
    up, right = (y - middle[0]) / width[0], (x - middle[1]) / width[1]
    return thickness * np.exp(-(up**2) - right**2), hot + 60 * np.tanh(right - up)


def slab(sheet):
    def light(y, x):
        tau, kelvin = soot(sheet, y, x)
        tau = tau[..., None] * 600 / NM + 1e-300
        return tau * planck(NM, kelvin[..., None]), tau

    return Slab(sheet[0], light)


def in_cells(sheet):
    """Thickness and temperature in the middle of the pixels of the central view."""
    at = (np.arange(36) - 17.5) * LENS.cell * (1 + sheet[0] / LENS.focus)
    return soot(sheet, at[:, None], at)


SOOT, KELVIN = map(np.array, zip(*map(in_cells, SHEETS), strict=True))
RED = in_colours((1 - np.exp(-SOOT[..., None] * 600 / NM)) * planck(NM, KELVIN[..., None]))[..., 0]
LIT = RED.max() / 5 < RED


@pytest.fixture(scope="module")
def exposure():
    """Light field with 1 % of noise, and its calibration."""
    slabs = [slab(sheet) for sheet in SHEETS]
    views = in_colours(trace(LENS, slabs, parts=3, channels=(NM.size,)))
    gains = 1 / views.max(axis=(0, 1, 2, 3))
    noise = 0.01 * np.random.default_rng(0).standard_normal(views.shape)
    nm = np.arange(380.0, 701.0, 5.0)
    responses = SpectralResponses(NAMES, nm, bands(nm))
    calibration = ColourCalibration(responses, gains, [0, 0, 0], (1000, 2500))
    return LightField((gains * views + noise).astype(np.float32)), calibration


@pytest.fixture(scope="module")
def found(exposure):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(PlaneGeometry, "iterations", 20)
        return reconstruct_soot(exposure[0], GRID, exposure[1], bootstrap=6)


def test_temperature_and_absorption_of_sheets_come_from_one_exposure(found):
    apart = [(found.temperatures.kelvin - KELVIN)[p][LIT[p]] for p in range(len(SHEETS))]
    for one in apart:
        assert np.abs(one).max() < 25
        assert abs(one.mean()) < 2.5
    # Absorption in a band is that of its wavelengths, each by its light.
    by_band = in_colours(planck(NM, 1800.0) * 600 / NM) / in_colours(planck(NM, 1800.0))
    ratios = np.stack([found.temperatures.amount, *(found.optical_thickness.T / by_band).T]) / SOOT
    for plane, lit in enumerate(LIT):
        assert np.median(ratios[:, plane][:, lit], axis=1) == pytest.approx(1, abs=0.018)


def test_bars_of_temperatures_are_neither_too_wide_nor_too_narrow(found):
    """Colours share the error by penalty and cells, which their ratio does not feel."""
    apart, sigma = (found.temperatures.kelvin - KELVIN)[LIT], found.temperatures.sigma[LIT]
    assert 0.6 < np.sqrt(np.mean((apart / sigma) ** 2)) < 1.3


def test_a_flame_too_thick_is_refused_after_its_rounds(exposure, monkeypatch):
    """Gains a hundredth of the true ones: a hundred times as much soot."""
    monkeypatch.setattr("lf_flame.tomography.soot.MOST_ROUNDS", 2)
    light_field, calibration = exposure
    dim = replace(calibration, gains=calibration.gains / 100)
    with pytest.raises(InputError, match=r"at most 2 in each colour, but comes out at [1-9]"):
        reconstruct_soot(light_field, GRID, dim)
