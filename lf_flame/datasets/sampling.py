"""Samples of a data set: drawn, rendered and refocused, each from the seed and its index."""

import numpy as np

from lf_flame._common.arrays import area_average
from lf_flame.datasets.config import DatasetConfig
from lf_flame.lightfield import LightField
from lf_flame.optics.camera import PlenopticCamera
from lf_flame.refocus import SlopeSearch, find_sharpest_slope, shift_and_sum
from lf_flame.scenes.scene import Layer, Scene
from lf_flame.simulation.plan import EffectPlan
from lf_flame.simulation.rendering import render_plan


def search_slopes(config: DatasetConfig) -> list[SlopeSearch]:
    """Find, on the mean scene, the slope that makes each object sharpest.

    Each search sees only the part of the image around its object.

    Returns
    -------
    list of SlopeSearch
        In the order of the template's objects.
    """
    scene, _ = config.draw(None)
    light_field = render_plan(scene, config.camera, config.plan, seed=config.seed)
    regions = [_region(layer, config.camera) for layer in scene.layers]
    return [find_sharpest_slope(light_field, region=region) for region in regions]


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


def simulate_sample(config: DatasetConfig, slopes: list[float], index: int) -> dict:
    """Draw, render and refocus one sample.

    Returns
    -------
    dict
        ``input`` (height, width, channels) and ``target`` (objects, h, w), float32 in [0, 1],
        ``parameters``, and ``plan``, by which it was simulated.
    """
    light_field, parameters = render_sample(config, index)
    return {
        "input": config.encode(light_field),
        "target": area_average(shift_and_sum(light_field, slopes), config.image),
        "parameters": parameters,
        "plan": light_field.plan,
    }


def render_sample(config: DatasetConfig, index: int) -> tuple[LightField, dict]:
    """Draw and render the light field of one sample; returns it with the scene's parameters."""
    scene, parameters = config.draw(np.random.default_rng([config.seed, index]))
    return render_drawn(scene, config, config.plan_of(scene), index), parameters


def render_drawn(scene: Scene, config: DatasetConfig, plan: EffectPlan, index: int) -> LightField:
    """Render the scene of a sample."""
    seed = [config.seed, index, 1]  # of the sensor's noise, apart from the scene's
    return render_plan(scene, config.camera, plan, seed=seed)
