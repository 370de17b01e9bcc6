"""Samples of a data set: drawn, simulated and refocused, each from the seed and its index.

Where the effect plan allows, images come straight from the scene (`lf_flame.projection`); else from
the light field. Both ways agree to 1e-6.
"""

import numpy as np

from lf_flame._common.arrays import area_average
from lf_flame.datasets.config import DatasetConfig
from lf_flame.errors import InputError
from lf_flame.lightfield import LightField
from lf_flame.optics.camera import PlenopticCamera
from lf_flame.projection import Projector
from lf_flame.refocus import SlopeSearch, find_sharpest_slope, shift_and_sum
from lf_flame.scenes.scene import Layer, Scene
from lf_flame.simulation.plan import EffectPlan
from lf_flame.simulation.rendering import render_plan

SEARCHED, STEPS_SEARCHED = 0.6, 25
"""Slopes to either side of the geometry's that are searched at first, and how many in all."""


def search_slopes(config: DatasetConfig, whole_range: bool = False) -> list[SlopeSearch]:
    """Find, on the mean scene, the slope that makes each object sharpest.

    Each search sees only the part of the image around its object.

    Parameters
    ----------
    config : DatasetConfig
    whole_range : bool, optional
        Search all slopes, not only those near where the geometry puts the object, which takes a
        third of the time. The slopes found agree to 1e-5.

    Returns
    -------
    list of SlopeSearch
        In the order of the template's objects.

    Raises
    ------
    InputError
        If an object has no sharpest slope.
    """
    scene, _ = config.draw(None)
    light_field = render_plan(scene, config.camera, config.plan, seed=config.seed)
    regions = [_region(layer, config.camera) for layer in scene.layers]
    if whole_range:
        return [find_sharpest_slope(light_field, region=region) for region in regions]
    expected = [float(config.camera.depth_to_slope(layer.depth_mm)) for layer in scene.layers]
    return [
        _search_near(light_field, slope, region)
        for slope, region in zip(expected, regions, strict=True)
    ]


def _search_near(
    light_field: LightField, slope: float, region: tuple[int, int, int, int]
) -> SlopeSearch:
    try:
        near = slope + np.linspace(-SEARCHED, SEARCHED, STEPS_SEARCHED)
        return find_sharpest_slope(light_field, near, region)
    except InputError:  # it is somewhere else, or nowhere
        return find_sharpest_slope(light_field, region=region)


def _region(layer: Layer, camera: PlenopticCamera) -> tuple[int, int, int, int]:
    """Lenslets that a layer covers in the central view, and a few around them."""
    scale = camera.field_mm(layer.depth_mm)[0] / camera.lenslets[0]  # mm per lenslet
    bounds = []
    for axis in (0, 1):
        middle = (camera.lenslets[axis] - 1) / 2
        edges = layer.cell_edges_mm(axis)[[0, -1]] / scale + middle
        low, high = np.clip((edges[0] - 6, edges[1] + 6), 0, camera.lenslets[axis])
        bounds += [int(low), int(np.ceil(high))]
    top, bottom, left, right = bounds
    return top, bottom, left, right


def simulate_sample(
    config: DatasetConfig, slopes: list[float], index: int, through_light_field: bool = False
) -> dict:
    """Draw, simulate and refocus one sample.

    Parameters
    ----------
    config : DatasetConfig
    slopes : list of float
    index : int
    through_light_field : bool, optional
        Form the light field, even where the plan needs none.

    Returns
    -------
    dict
        ``input`` (height, width, channels) and ``target`` (objects, h, w), float32 in [0, 1],
        ``parameters``, and ``plan``, by which it was simulated.
    """
    scene, parameters = draw_sample(config, index)
    plan = config.plan_of(scene)
    if through_light_field or plan.not_separable:
        light_field = render_drawn(scene, config, plan, index)
        shown = config.encode(light_field)
        target = area_average(shift_and_sum(light_field, slopes), config.image)
    else:
        projector = Projector(scene, config.camera, plan)
        shown = config.input.project(projector, config.image)
        target = np.clip(projector.refocus(slopes, block=config.block), 0, 1)
    return {"input": shown, "target": target, "parameters": parameters, "plan": plan}


def draw_sample(config: DatasetConfig, index: int) -> tuple[Scene, dict]:
    """Draw the scene of one sample, and its parameters."""
    return config.draw(np.random.default_rng([config.seed, index]))


def render_sample(config: DatasetConfig, index: int) -> tuple[LightField, dict]:
    """Draw and render the light field of one sample; returns it with the scene's parameters."""
    scene, parameters = draw_sample(config, index)
    return render_drawn(scene, config, config.plan_of(scene), index), parameters


def render_drawn(scene: Scene, config: DatasetConfig, plan: EffectPlan, index: int) -> LightField:
    """Render the scene of a sample."""
    seed = [config.seed, index, 1]  # of the sensor's noise, apart from the scene's
    return render_plan(scene, config.camera, plan, seed=seed)
