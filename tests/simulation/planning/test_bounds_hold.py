"""Scenes and cameras at which bounds were too small, or effects were not simulated."""

import math
from dataclasses import replace

import numpy as np
import pytest

from lf_flame import PAPER_CAMERA, Layer, Scene, plan_effects, render
from lf_flame.simulation.diffraction import lenslet_share_leaving
from lf_flame.simulation.optical_pass import crosstalk

CAMERA = replace(PAPER_CAMERA, lenslets=(8, 10))
WIDE = replace(PAPER_CAMERA, lenslets=(2, 540))
CHROMATIC = replace(CAMERA, chromatic_shift=0.2, rim_distance_mm=150.0, rim_diameter_mm=61.0)
AWAY = replace(PAPER_CAMERA, lenslet_focal_mm=4.0, lenslet_pitch_mm=1.12, views=3,
               lenslets=(25, 31), exit_pupil_mm=150.0, chromatic_shift=0.1)  # fmt: skip
COMB = np.outer(*2 * [np.hanning(102)[1:-1]])
MATTER = np.broadcast_to(50.0 * (np.arange(100) % 2), COMB.shape)
EVEN = Layer([[1.0]], 0.0, (400.0, 400.0))
SMOKE = Layer([[0.0]], 0.0, (4.0, 4.0), optical_thickness=5.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effect", "camera", "layers", "least"),
    [
        ("lenslet_pitch_error", replace(WIDE, lenslet_pitch_error=1e-4),
         [Layer([[1.0]], -0.549, (4.0, 68.0), thickness_mm=2.0)], 3e-3),
        ("self_absorption", CAMERA, [Layer([[1.0, 0.0]], 0.0, (20.0, 2.0), thickness_mm=10.0,
         optical_thickness=[[0.0, 100.0]])], 0.1),
        ("self_absorption", CAMERA, [SMOKE, replace(SMOKE, texture=[[1.0]], optical_thickness=0)],
         0.9),
        ("defocus", CAMERA, [Layer(COMB, 2.0, (13.0, 13.0), optical_thickness=MATTER)], 0.01),
        ("vignetting", CHROMATIC, [EVEN], 0.05),
        ("chromatic", replace(AWAY, aperture_diameter_mm=AWAY.aperture_mm), [EVEN], 5e-3),
    ],
)  # fmt: skip
def test_a_change_is_within_its_bound(effect, camera, layers, least):
    scene = Scene(layers)
    kept, left = (
        render(scene, camera, tolerance=0.01, effects={effect: on}).views for on in (True, False)
    )
    changed = np.abs(kept - left).max() / kept.max()
    assert least < changed <= plan_effects(scene, camera, 0.01)[effect].bound


def test_light_of_a_single_view_adds_up_whole_circles():
    camera = replace(CAMERA, views=1, aperture_diameter_mm=4 * CAMERA.aperture_mm)
    found = render(Scene([EVEN]), camera, integrator="rays", rays=40).views
    assert found.max() == pytest.approx(4 * math.pi, rel=0.02)
    assert found.max() <= 1 + crosstalk(camera)


def test_a_narrow_aperture_is_seen_by_inner_views():
    camera = replace(CAMERA, views=5, pixel_pitch_mm=CAMERA.pixel_mm, aperture_diameter_mm=20.0)
    found = render(Scene([EVEN]), camera)
    assert found.views[0, 0].max() < 0.01
    assert found.weights.sum() == 5  # the middle one and those beside it


def test_lit_parts_through_displaced_lenslets_are_not_black():
    camera = replace(WIDE, lenslet_pitch_error=0.02, aperture_diameter_mm=WIDE.aperture_mm)
    few, far = (
        render(Scene([Layer([[1.0]], 10.0, (30.0, wide))]), camera, integrator="rays", rays=3)
        for wide in (60.0, 400.0)
    )
    np.testing.assert_array_equal(few.views[7, 7, :, 70:470], far.views[7, 7, :, 70:470])


@pytest.mark.parametrize("options", [{}, {"integrator": "rays", "rays": 8}])
def test_a_sheet_seen_from_behind_shines(options):
    """At 85 degrees, the views at 6.4 degrees see its back, and those at 4.5 hardly its front."""
    scene = Scene([Layer(np.ones((8, 8)), 0.0, (4.0, 4.0), tilt_deg=(85.0, 0.0))])
    views = render(scene, CAMERA, tolerance=0.05, **options).views
    assert views.min() >= 0
    assert views[-1].max() > 0.3 > views[-3].max()


def test_parts_and_tiles_are_for_diffraction_that_is_simulated():
    scene, gaps = Scene([EVEN]), replace(CAMERA, views=9, pixel_pitch_mm=5e-4)
    assert plan_effects(scene, gaps, integrator="rays", rays=4).parts == 1
    off = {"lenslet_diffraction": False}
    plan_effects(
        scene, replace(PAPER_CAMERA, pixel_pitch_mm=0.0012, wavelength_nm=550.0), 0.01, off
    )


def test_lenslets_diffract_by_their_true_pitch():
    camera = replace(CAMERA, wavelength_nm=550.0)
    small = replace(camera, lenslet_pitch_mm=0.9 * 0.112, pixel_pitch_mm=0.9 * camera.pixel_mm)
    wrong = replace(camera, lenslet_pitch_error=-0.1, pixel_pitch_mm=0.9 * camera.pixel_mm)
    assert lenslet_share_leaving(wrong) == pytest.approx(lenslet_share_leaving(small), rel=1e-3)
