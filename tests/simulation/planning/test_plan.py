"""Share of the tolerance for effects that are left out, and the cost of planning."""

import math
from dataclasses import replace

import builders
import pytest

from lf_flame import Layer, PlenopticCamera, Scene, plan_effects
from lf_flame.simulation.planning import chosen_pixels


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


def test_planning_takes_a_fraction_of_the_work_of_rendering(monkeypatch, rng):
    """Rays through planes, in front of a sensor with hardly more pixels than are chosen."""
    work, gather = [], chosen_pixels.gather

    def counted(planes, passes, layout, rays):
        image = gather(planes, passes, layout, rays)
        work.append(len(planes) * len(passes) * image.size * (rays or 1) ** 2)
        return image

    monkeypatch.setattr(chosen_pixels, "gather", counted)
    layer = Layer(rng.uniform(size=(9, 9)), 12.0, (1.2, 1.4), thickness_mm=8.0)
    camera = PlenopticCamera(
        **builders.camera(2, (6, 8)), aperture_diameter_mm=90.0, chromatic_shift=1e-3
    )
    plan = plan_effects(Scene([layer]), camera, 0.01)
    pixels = camera.views**2 * math.prod(camera.lenslets)
    whole = pixels * plan.rays**2 * sum(plan.slabs) * plan.colours
    assert 0.005 < sum(work) / whole < 0.2
