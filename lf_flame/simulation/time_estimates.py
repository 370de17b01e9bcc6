"""Estimates of the time that integrators and effects take, from measured rates."""

import math
from collections.abc import Collection, Sequence

from lf_flame.optics.camera import PlenopticCamera
from lf_flame.optics.sensor import STAGES
from lf_flame.scenes.scene import Scene
from lf_flame.simulation.effects import EFFECTS, MATTER, RAYS
from lf_flame.simulation.optical_pass import OpticalPass
from lf_flame.simulation.polygons import expected_pairs, split_planes
from lf_flame.simulation.scene_bounds import SceneBounds
from lf_flame.simulation.slabs import slice_scene

NANOSECONDS = {
    "exact": 2.5,
    "ray": 1.5,
    "dimmed": 4.0,
    "polygon": 1.2,
    "ray_effect": 1.0,
    "cos4": 0.25,
    "lenslet_blur": 420.0,
    "main_lens_blur": 35.0,
    "noise": 18.0,
}
"""Time for a pixel and plane (exact), a ray and plane (ray; dimmed: where planes dim others), two
polygons and a plane (polygon), a ray and stop or shift (ray_effect), and a pixel (others), on one
core, as measured for the tables of costs. For the column of estimates, and where planes dim others
for the choice between rays and polygons."""

TYPICAL_RAYS = 18
"""Rays per pixel and axis that the default tolerance takes in most scenes; for estimates only."""

RAYS_TIMES_TOLERANCE = 0.1
"""Where planes dim others, rays per pixel and axis times the tolerance that they meet, about."""


def compare_integrators(
    scene: Scene,
    camera: PlenopticCamera,
    tolerance: float,
    kept: Collection[str],
    slabs: Sequence[int],
    traced: Collection[str],
) -> dict[str, float]:
    """Estimate the seconds of each integrator for one colour, on one core.

    "open" is the exact integrator's time if light only added.
    """
    work = camera.views**2 * math.prod(camera.lenslets) * sum(slabs)
    open_s = work * NANOSECONDS["exact"] * 1e-9
    if not any(name in MATTER for name in traced):
        traced_s = work * TYPICAL_RAYS**2 * NANOSECONDS["ray"] * 1e-9
        return {"open": open_s, "exact": open_s, "rays": traced_s}
    parts = dict(zip(scene.layers, slabs, strict=True))
    _, behind = split_planes(slice_scene(scene, parts, "self_absorption" in kept, set(traced)))
    pairs = expected_pairs(behind, OpticalPass(camera, defocus="defocus" in kept)) if behind else 0
    rays = max(TYPICAL_RAYS, RAYS_TIMES_TOLERANCE / tolerance)
    return {
        "open": open_s,
        "exact": open_s + pairs * len(behind) * NANOSECONDS["polygon"] * 1e-9,
        "rays": work * rays**2 * NANOSECONDS["dimmed"] * 1e-9,
    }


def estimate_seconds(
    bounds: SceneBounds,
    kept: Collection[str],
    slabs: Sequence[int],
    colours: int,
    costs: dict[str, float],
    integrator: str,
) -> dict[str, float]:
    """Roughly how long each effect takes, or would take, on one core.

    costs: of `compare_integrators`.
    """
    camera = bounds.camera
    pixels = camera.views**2 * math.prod(camera.lenslets)
    base = costs[integrator] * colours
    per_ray = pixels * sum(slabs) * colours * TYPICAL_RAYS**2 * NANOSECONDS["ray_effect"] * 1e-9
    seconds = dict.fromkeys(EFFECTS, 0.0)
    seconds["cos4"] = pixels * NANOSECONDS["cos4"] * 1e-9
    seconds["thickness"] = base * (1 - len(slabs) / sum(slabs))
    seconds["chromatic"] = base * (1 - 1 / colours)
    for name in (*MATTER, *RAYS):
        if name in kept:
            seconds[name] = per_ray if name in RAYS else base - costs["open"] * colours
    if camera.wavelength_nm is not None:
        for stop in ("lenslet", "main_lens"):
            seconds[f"{stop}_diffraction"] = pixels * NANOSECONDS[f"{stop}_blur"] * 1e-9
    if camera.sensor is not None:
        seconds.update(dict.fromkeys(STAGES, pixels * NANOSECONDS["noise"] * 1e-9))
    return seconds
