"""What a camera does not state is said to be unknown, and measured changes are true ones."""

from dataclasses import replace

import numpy as np
import pytest

from lf_flame import PAPER_CAMERA, Layer, Scene, plan_effects
from lf_flame.simulation import assume, measure_changes
from lf_flame.simulation.planning.effects import CAUSES, EFFECTS
from lf_flame.simulation.rendering import CROSSING

CAMERA = replace(PAPER_CAMERA, views=5, lenslets=(20, 30))
EVEN = Scene([Layer([[1.0]], 0.0, (9.0, 9.0))])


def test_what_is_not_stated_has_no_bound_of_zero():
    plan = plan_effects(EVEN, CAMERA)
    unknown = {effect.name for effect in plan.effects if not effect.stated}
    assert unknown == set(CAUSES)
    shown = {line.split()[0]: line for line in str(plan).splitlines() if line[:1].isalpha()}
    for name in EFFECTS:
        assert ("not stated" in shown[name]) == (name in unknown)
    assert {e["bound"] for e in plan.to_json()["effects"] if e["name"] in unknown} == {None}
    assert "13 effects" in str(plan)


def test_stating_a_cause_makes_its_effects_known():
    camera = assume(CAMERA, ["550nm", "12bit"])
    unknown = {effect.name for effect in plan_effects(EVEN, camera).effects if not effect.stated}
    stated = {"lenslet_diffraction", "main_lens_diffraction", "shot_noise", "read_noise"}
    assert unknown == set(CAUSES) - stated - {"quantisation", "saturation"}
    plan = plan_effects(EVEN, assume(CAMERA, ["typical"]), integrator="rays", rays=1)
    assert all(effect.stated or effect.name == "vignetting" for effect in plan.effects)


def test_what_is_stated_by_its_default_is_stated():
    fields = {"falloff_corrected", "lenslet_rotation_rad", "sensor"}  # a sensor of None is none
    plan = plan_effects(EVEN, CAMERA, typical=True, stated=fields)
    known = {"cos4", "lenslet_rotation"}
    assert {effect.name for effect in plan.effects if not effect.stated} == set(CAUSES) - known
    assert not known & plan.typical.keys()
    assert {plan[name].bound for name in known} == {0.0}
    typical = assume(CAMERA, ["typical"], fields)
    assert (typical.falloff_corrected, typical.lenslet_rotation_rad) == (True, 0.0)
    assert typical.lenslet_pitch_error > 0


def test_typical_bounds_are_those_of_the_stated_cause():
    typical = plan_effects(EVEN, CAMERA, typical=True).typical
    electrons = 8000.0
    # Five standard errors of the root-mean-square over so many pixels are in the bound.
    slack = 1 + 5 / np.sqrt(2 * 25 * 20 * 30)
    assert typical["shot_noise"] == pytest.approx(slack / np.sqrt(electrons), rel=5e-3)
    assert typical["quantisation"] == pytest.approx(10_000 / 4095 / 2 / electrons, rel=5e-3)
    assert "vignetting" not in typical
    scene = Scene([Layer([[0.0, 1.0]], 5.0, (1.0, 1.0))])
    stated = plan_effects(scene, replace(CAMERA, chromatic_shift=1 / 2400))["chromatic"].bound
    typical = plan_effects(scene, CAMERA, typical=True).typical
    assert typical["chromatic"] == pytest.approx(stated, rel=0.03)
    assert stated > 0


@pytest.mark.parametrize(
    ("word", "field", "value"),
    [
        ("550nm", "wavelength_nm", 550.0),
        ("632.8nm", "wavelength_nm", 632.8),
        ("round", "aperture_diameter_mm", 150 * 326 / 176 * 0.112 / 0.4),
        ("f/4", "aperture_diameter_mm", 37.5),
        ("falloff", "falloff_corrected", False),
    ],
)
def test_words_of_a_data_sheet(word, field, value):
    assert getattr(assume(CAMERA, [word]), field) == pytest.approx(value)


@pytest.mark.slow
def test_measured_changes_are_those_of_a_closed_form():
    """Of an even field: cos^4 dims it by where pixels look; noise is that of the electrons."""
    found = measure_changes(EVEN, CAMERA, plan_effects(EVEN, CAMERA))
    squares = []
    for lenslets in CAMERA.lenslets:
        lens_mm = (np.arange(lenslets) - (lenslets - 1) / 2) * 0.112
        places_mm = ((np.arange(20) + 0.5) / 4 - 2.5) * CAMERA.pixel_mm  # four to a pixel
        squares.append((places_mm[:, None] / 0.4 + lens_mm / CAMERA.image_distance_mm) ** 2)
    cos4 = (1 + squares[0][:, None, :, None] + squares[1][None, :, None, :]) ** -2.0
    pixels = cos4.reshape(5, 4, 5, 4, 20, 30).mean(axis=(1, 3))
    assert found["cos4"] == pytest.approx(np.sqrt(np.mean((1 - pixels) ** 2)), rel=0.005)
    assert found["shot_noise"] == pytest.approx(8000**-0.5, rel=0.02)
    assert found["read_noise"] == pytest.approx(2 / 8000, rel=0.02)
    assert found["lenslet_rotation"] < 1e-6  # an even field looks the same through a turned array
    assert set(found) == set(CAUSES) - {"vignetting"}
    hexagonal = replace(CAMERA, layout="hexagonal", lenslets=(6, 8))
    found = measure_changes(EVEN, hexagonal, plan_effects(EVEN, hexagonal))
    assert set(found) == set(CAUSES) - {"vignetting", *CROSSING}
