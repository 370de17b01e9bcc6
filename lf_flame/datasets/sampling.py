"""Samples of a data set: drawn, simulated and refocused, each from the seed and its index.

With the route "direct" images come directly from the scene (`lf_flame.projection`) where the effect
plan allows, else from the light field. Both agree to 1e-6.
"""

from dataclasses import replace

import numpy as np

from lf_flame.datasets.config import DatasetConfig
from lf_flame.datasets.encodings import area_average
from lf_flame.errors import InputError
from lf_flame.lightfield import LightField
from lf_flame.optics.camera import PlenopticCamera
from lf_flame.projection import Projector
from lf_flame.refocus import SlopeSearch, find_sharpest_slope, shift_and_sum
from lf_flame.scenes.scene import Layer, Scene
from lf_flame.simulation import rendering
from lf_flame.simulation.planning.plan import EffectPlan, plan_effects

RAY_COUNTS = (2, 3, 5, 8, 12, 18, 27, 41, 62, 93, 140, 210, 315)
"""Numbers of rays per pixel and axis that are tried."""

SEARCHED, STEPS_SEARCHED = 0.6, 25
"""Range of slopes around the geometric one that is searched first, and number of steps."""

TARGET_ERROR = 1e-3
"""Largest root-mean-square error of a refocused image, which determines the number of rays: 60 dB
below white, about 15 dB below the error of the paper's network."""


def count_rays(config: DatasetConfig) -> int | None:
    """Find the number of rays per pixel, along each axis, that a data set needs; None without rays.

    It is the smallest with which all refocused images of the mean scene agree, to `TARGET_ERROR`,
    with those directly from the scene: far fewer than for the tolerance of a single light field,
    because a refocused image averages many pixels. If the effect plan does not allow direct images,
    that tolerance decides.
    """
    if config.route != "rays":
        return None
    scene, _ = config.draw(None)
    if config.plan.not_separable:
        return plan_effects(scene, config.camera, effects=config.effects, integrator="rays").rays
    slopes = [float(config.camera.depth_to_slope(z)) for z in config.depths_mm]
    exact = _refocus_directly(Projector(scene, config.camera, config.plan), config, slopes)
    for rays in RAY_COUNTS:
        light_field = render_drawn(scene, config, config.plan, 0, rays)
        error = _refocus(light_field, config, slopes) - exact
        if np.sqrt(np.square(error, dtype=np.float64).mean(axis=(1, 2))).max() <= TARGET_ERROR:
            return rays
    raise InputError(
        f"The images of the mean scene are not within {TARGET_ERROR:g} of the exact ones with "
        f'{rays} x {rays} rays per pixel: take route = "exact" or "direct".'
    )


def search_slopes(
    config: DatasetConfig, rays: int | None = None, whole_range: bool = False
) -> list[SlopeSearch]:
    """Find the slope of sharpest focus of each object of the mean scene, in the image around it.

    `rays` is the number from `count_rays`. All slopes are searched, or only those near the
    geometric one, which takes a third of the time; both results agree to 5e-5.
    """
    scene, _ = config.draw(None)
    light_field = render_drawn(scene, config, config.plan, 0, rays)
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
        return find_sharpest_slope(light_field, near, region=region)
    except InputError:  # the peak is elsewhere, or there is none
        return find_sharpest_slope(light_field, region=region)


def _region(layer: Layer, camera: PlenopticCamera) -> tuple[int, int, int, int]:
    """Lenslets that a layer covers in the central view, and a few around them."""
    scale = camera.field_mm(layer.depth_mm)[0] / camera.lenslets[0]  # mm per lenslet
    bounds = []
    for axis in (0, 1):
        middle = (camera.lenslets[axis] - 1) / 2
        edges = layer.cell_edges_mm[axis][[0, -1]] / scale + middle
        low, high = np.clip((edges[0] - 6, edges[1] + 6), 0, camera.lenslets[axis])
        bounds += [int(low), int(np.ceil(high))]
    top, bottom, left, right = bounds
    return top, bottom, left, right


def simulate_sample(
    config: DatasetConfig, slopes: list[float], index: int, rays: int | None = None
) -> dict:
    """Draw, simulate and refocus one sample; `rays` is the number from `count_rays`.

    Returns ``input`` (height, width, channels) and ``target`` (objects, h, w), float32 in [0, 1],
    and the ``parameters`` that were drawn.
    """
    scene, parameters = draw_sample(config, index)
    plan = config.plan_of(scene)
    if config.route != "direct" or plan.not_separable:
        light_field = render_drawn(scene, config, plan, index, rays)
        shown = config.encode(light_field)
        target = _refocus(light_field, config, slopes)
    else:
        projector = Projector(scene, config.camera, plan)
        shown = config.input.project(projector, config.image)
        target = _refocus_directly(projector, config, slopes)
    return {"input": shown, "target": target, "parameters": parameters}


def _refocus(light_field: LightField, config: DatasetConfig, slopes: list[float]) -> np.ndarray:
    """Refocus a light field with shift-and-sum, at the size of the targets."""
    return area_average(shift_and_sum(light_field, slopes), config.image)


def _refocus_directly(
    projector: Projector, config: DatasetConfig, slopes: list[float]
) -> np.ndarray:
    """Refocus a scene without a light field, at the size of the targets."""
    return np.clip(projector.refocus(slopes, block=config.block), 0, 1)


def draw_sample(config: DatasetConfig, index: int) -> tuple[Scene, dict]:
    """Draw the scene of one sample, and its parameters."""
    return config.draw(np.random.default_rng([config.seed, index]))


def render_sample(
    config: DatasetConfig, index: int, rays: int | None = None
) -> tuple[LightField, dict]:
    """Draw and render the light field of one sample; returns it with the scene's parameters."""
    scene, parameters = draw_sample(config, index)
    return render_drawn(scene, config, config.plan_of(scene), index, rays), parameters


def render_drawn(
    scene: Scene, config: DatasetConfig, plan: EffectPlan, index: int, rays: int | None = None
) -> LightField:
    """Render the scene of a sample, with `rays` rays along each axis, or as the plan decides."""
    seed = [config.seed, index, 1]  # of the sensor's noise, different from the scene's
    if rays:
        plan = replace(plan, rays=rays)
    return rendering.render_plan(scene, config.camera, plan, seed)
