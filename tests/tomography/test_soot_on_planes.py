"""Sooty sheets that dim each other, recorded by rays that share nothing with the reconstruction."""

import numpy as np
import pytest

from experiments.tomography import soot_rays
from experiments.tomography.soot_sheets import (
    NAMES,
    NM,
    SootSheet,
    bands,
    in_colours,
    planck,
    record,
)
from lf_flame import LightField, PlenopticCamera
from lf_flame.tomography import ColourCalibration, FrustumGrid, SpectralResponses, reconstruct_soot

pytestmark = pytest.mark.slow

VIEWS, LENSLETS = 5, (36, 36)
SHEETS = [
    SootSheet(-5.0, (0.2, -0.2), (0.7, 0.6), 0.3),
    SootSheet(5.0, (0.0, 0.2), (0.6, 0.7), 0.2, hot=1850.0),
]
CAMERA = PlenopticCamera(
    main_lens_focal_mm=soot_rays.FOCAL_MM,
    focus_distance_mm=soot_rays.FOCUS_MM,
    lenslet_focal_mm=soot_rays.LENSLET_FOCAL_MM,
    lenslet_pitch_mm=soot_rays.PITCH_MM,
    views=VIEWS,
    lenslets=LENSLETS,
)
GRID = FrustumGrid(CAMERA, [sheet.depth_mm for sheet in SHEETS])
SOOT, KELVIN = map(np.array, zip(*(sheet.cells(LENSLETS) for sheet in SHEETS), strict=True))
RED = in_colours((1 - np.exp(-SOOT[..., None] * 600 / NM)) * planck(KELVIN))[..., 0]
LIT = RED.max() / 5 < RED


@pytest.fixture(scope="module")
def exposure():
    """Light field with 1 % of noise, and its calibration."""
    views = record(SHEETS, VIEWS, LENSLETS)
    gains = 1 / views.max(axis=(0, 1, 2, 3))
    noise = 0.01 * np.random.default_rng(0).standard_normal(views.shape)
    nm = np.arange(380.0, 701.0, 5.0)
    responses = SpectralResponses(NAMES, nm, bands(nm))
    calibration = ColourCalibration(responses, gains, [0, 0, 0], (1000, 2500))
    return LightField((gains * views + noise).astype(np.float32)), calibration


@pytest.fixture(scope="module")
def found(exposure):
    return reconstruct_soot(exposure[0], GRID, exposure[1], bootstrap=6, iterations=20)


def test_temperature_and_absorption_of_sheets_come_from_one_exposure(found):
    apart = [(found.temperatures.kelvin - KELVIN)[p][LIT[p]] for p in range(len(SHEETS))]
    for one in apart:
        assert np.abs(one).max() < 25
        assert abs(one.mean()) < 2.5
    # Absorption in a band is that of its wavelengths, each by its light.
    by_band = in_colours(planck(1800.0) * 600 / NM) / in_colours(planck(1800.0))
    ratios = np.stack([found.temperatures.amount, *(found.optical_thickness.T / by_band).T]) / SOOT
    for plane, lit in enumerate(LIT):
        assert np.median(ratios[:, plane][:, lit], axis=1) == pytest.approx(1, abs=0.018)


def test_bars_of_temperatures_are_neither_too_wide_nor_too_narrow(found):
    """Colours share the error by penalty and cells, which their ratio does not feel."""
    apart, sigma = (found.temperatures.kelvin - KELVIN)[LIT], found.temperatures.sigma[LIT]
    assert 0.6 < np.sqrt(np.mean((apart / sigma) ** 2)) < 1.3


def test_sheets_taken_for_thin_are_too_cold(exposure):
    thin = reconstruct_soot(exposure[0], GRID, exposure[1], absorbing=False, iterations=20)
    for apart, lit in zip(thin.temperatures.kelvin - KELVIN, LIT, strict=True):
        assert apart[lit].mean() < -6
