"""How many slabs a plan takes: the numbers of its bound, and the bound against images."""

from dataclasses import replace

import pytest

from lf_flame import Layer, Scene, plan_effects


@pytest.mark.parametrize("name", ["cos4", "thickness", "chromatic"])
def test_effects_left_out_use_up_a_quarter_of_the_tolerance(small_camera, rng, name):
    """The rest is for slabs, colours and rays, as the documentation says."""
    camera = replace(small_camera, falloff_corrected=name != "cos4",
                     chromatic_shift=1e-3 if name == "chromatic" else 0.0)  # fmt: skip
    thick = 1.0 if name == "thickness" else 0.0
    scene = Scene([Layer(rng.uniform(size=(5, 6)), 5.0, (1.5, 1.6), thickness_mm=thick)])
    bound = plan_effects(scene, camera)[name].bound
    assert bound > 0
    silent = {"defocus": True}
    assert name in plan_effects(scene, camera, 3.99 * bound, silent).kept
    assert name not in plan_effects(scene, camera, 4.01 * bound, silent).kept


def test_effects_left_out_share_that_quarter(small_camera, rng):
    """Two small effects of which each alone would be left out, but not both."""
    camera = replace(small_camera, falloff_corrected=False, chromatic_shift=1e-5)
    scene = Scene([Layer(rng.uniform(size=(5, 6)), 5.0, (1.5, 1.6))])
    bounds = [plan_effects(scene, camera)[name].bound for name in ("cos4", "chromatic")]
    tolerance = 4 * (max(bounds) + 0.5 * min(bounds))
    plan = plan_effects(scene, camera, tolerance, {"defocus": True})
    assert len(plan.kept & {"cos4", "chromatic"}) == 1
    assert plan.left_out_bound == min(bounds)
