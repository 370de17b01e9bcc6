"""What planning and rendering refuse, each in one sentence."""

from dataclasses import replace
from functools import partial

import pytest
from sentences import each, refusals

from lf_flame import PAPER_CAMERA, InputError, Layer, Scene, plan_effects, render
from lf_flame.simulation import assume
from lf_flame.simulation.diffraction import tiled_sensor
from lf_flame.simulation.rendering import render_plan

CAMERA = replace(PAPER_CAMERA, views=4, lenslets=(10, 12))
SCENE = Scene([Layer([[1.0]], 0.0, (1.0, 1.0))])
ASIDE = Scene([Layer([[1.0]], 0.0, (1.0, 1.0), (0.0, 90.0))])
TWO = Scene(SCENE.layers + ASIDE.layers)
BEHIND = Scene([Layer([[1.0]], -400.0, (1.0, 1.0))])
SMALL_PIXELS = replace(CAMERA, wavelength_nm=650.0, pixel_pitch_mm=1e-6)

test_it_is_refused_in_a_sentence = refusals(
    [
        *each(
            partial(plan_effects, SCENE, CAMERA),
            ((1e-3, {"blooming": True}), "Unknown effect 'blooming'; the known ones are defocus, "),
            ((1e-3, {"blooming": True, "fog": True}), "effect 'blooming', 'fog'; the"),
            ((1e-3, {"cos4": "yes"}), "cos4 must be forced by True or False, got 'yes'"),
            ((1e-3, ["cos4"]), r"effects must map names to True or False, got \['cos4'\]"),
            ((1e-3, {"f_number_mismatch": True, "round_aperture": False}), "cannot be forced on"),
            ((0.0,), "tolerance must be above 0, got 0.0"),
            ((float("nan"),), "tolerance must be above 0"),
        ),
        *each(
            partial(render, SCENE, CAMERA),
            ({"integrator": "magic"}, "must be auto, exact or rays, got 'magic'"),
            ({"tolerance": 0}, "tolerance must be above 0, got 0"),
            ({"rays": 4}, "needs integrator='rays', got 4, 'auto'"),
            ({"integrator": "rays", "rays": 0}, "rays must be at least 1 .* got 0, 'rays'"),
        ),
        (partial(plan_effects, ASIDE, PAPER_CAMERA), "outside the field: in x it spans 89.5"),
        (lambda: render_plan(TWO, CAMERA, plan_effects(SCENE, CAMERA)), "1 layers .* scene of 2"),
        (partial(render, BEHIND, PAPER_CAMERA), "in front of the main lens.*-400"),
        (partial(tiled_sensor, SMALL_PIXELS), "use a larger pixel_pitch_mm or tolerance, or force"),
        *(
            (partial(assume, CAMERA, [word]), f"Assumptions must be 550nm, .* got '{word}'")
            for word in ("", "nm", "550", "f/0", "f/", "1e9nm", "square")
        ),
        *(
            (partial(assume, CAMERA, [f"{bits}bit"]), f"whole number from 1 to 16, got {bits}")
            for bits in (99, 0)
        ),
    ]
)


@pytest.mark.slow
def test_a_tolerance_out_of_reach_names_the_obstacle():
    thick = Scene([Layer([[1.0, 0.5]], 0.0, (1.6, 1.8), thickness_mm=60.0)])
    with pytest.raises(InputError, match="too small: the number of slabs would exceed 1024"):
        plan_effects(thick, CAMERA, 1e-9)
    card = Layer([[0.3]], -10.0, (0.8, 0.9), opaque=True)
    scene = Scene([Layer([[1.0]], 10.0, (1.6, 1.8)), card])
    few = replace(CAMERA, views=1, lenslets=(1, 2))
    with pytest.raises(InputError, match="the number of rays would exceed 2048"):
        render(scene, few, tolerance=1e-12, integrator="rays")
