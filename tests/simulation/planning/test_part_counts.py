"""How many slabs are taken: the numbers of their bound, and the bound against images."""

from functools import partial

import numpy as np
import pytest

from lf_flame import Layer, Scene
from lf_flame.simulation.bundle_shifts import farthest_move_mm
from lf_flame.simulation.exact import integrate
from lf_flame.simulation.layouts import blank_image
from lf_flame.simulation.optical_pass import OpticalPass
from lf_flame.simulation.planning import part_counts
from lf_flame.simulation.planning.scene_bounds import bound_scene, box_mm, change_rate, smeared
from lf_flame.simulation.slabs import slice_scene


def test_midpoints_err_at_kinks_and_curves_as_the_bound_says():
    fine = (np.arange(100_000) + 0.5) / 100_000 - 0.5
    kinks = [np.maximum(fine - at, 0).mean() - max(-at, 0) for at in np.linspace(-0.5, 0.5, 41)]
    assert max(kinks) == pytest.approx(1 / part_counts.KINK, rel=1e-4)
    assert (fine**2 / 2).mean() == pytest.approx(1 / part_counts.CURVATURE, rel=1e-4)


def test_the_way_of_a_part_follows_from_its_first_order(small_camera, rng):
    layer = Layer(rng.uniform(size=(5, 6)), 5.0, (1.5, 1.6), thickness_mm=1e-3)
    bounds = bound_scene(Scene([layer]), small_camera)
    here, steps = bounds.footprints[layer, 0], bounds.steps[layer, 0]
    travel = farthest_move_mm(small_camera, here, 0, layer.depth_mm + 5e-4) * 2
    mean = smeared(bounds, layer, 0, depth_mm=1e-3)
    rate = change_rate(steps, box_mm(bounds, layer, 0))
    assert part_counts.TRAVEL_PER_MEAN * mean / rate == pytest.approx(travel, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("cells", [(2, 2), (6, 7), (40, 50)])
@pytest.mark.parametrize("depth_mm", [0.0, 12.0])
def test_slabs_err_by_no_more_than_their_bound(small_camera, rng, cells, depth_mm):
    """On chequerboards too, whose light bends the most."""
    for texture in (rng.uniform(size=cells), np.indices(cells).sum(axis=0) % 2.0):
        layer = Layer(texture, depth_mm, (1.5, 1.6), (0.03, -0.02), thickness_mm=10.0)
        scene = Scene([layer])
        bounds = bound_scene(scene, small_camera)

        def image(slabs, scene=scene, layer=layer):
            planes = slice_scene(scene, {layer: slabs}, absorption=False, dimming=set())
            out = blank_image(small_camera, "views", np.float64)
            integrate(planes, OpticalPass(small_camera), "views", out)
            return out

        def smear(axis, parts, bounds=bounds, layer=layer):
            return smeared(bounds, layer, axis, depth_mm=layer.thickness_mm / parts)

        bound = partial(part_counts._sliced_change, bounds, layer, smear=smear)
        truth = image(256)
        for slabs in (2, 4, 8, 16):
            assert np.abs(image(slabs) - truth).max() <= bound(slabs)
        assert bound(512) < bound(256) / 2  # the second order
