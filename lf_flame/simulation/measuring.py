"""Change of an image by an effect, measured from the images with and without it."""

from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np

from lf_flame.optics.camera import PlenopticCamera
from lf_flame.scenes.scene import Scene
from lf_flame.simulation.planning.decisions import plan_effects
from lf_flame.simulation.planning.effects import EFFECTS
from lf_flame.simulation.planning.plan import CAUSES, EffectPlan, PlannedEffect
from lf_flame.simulation.rendering import render_plan

RAYS = 4
"""Number of rays per pixel along each axis, if rays are traced. Images with and without an effect
use the same rays, so that their errors nearly cancel in the difference."""

OF_THE_SCENE = ("defocus", "occlusion", "self_absorption", "thickness")
"""Effects that stay as planned while another one is measured; all others are off."""


def measure_changes(
    scene: Scene,
    camera: PlenopticCamera,
    plan: EffectPlan,
    *,
    progress: Callable[[Iterable], Iterable] = iter,
) -> dict[str, float]:
    """Measure the change of the image by each effect of a plan, by rendering with and without it.

    An effect whose cause the camera does not state is measured at a typical value of the cause
    (`lf_flame.simulation.planning.plan`). The bounds of a plan hold for all similar scenes;
    the measured change of one scene is smaller, often by far.

    Parameters
    ----------
    scene : Scene
    camera : PlenopticCamera
    plan : EffectPlan
        Plan of this scene and camera.
    progress : callable, optional
        Function that wraps the list of effects, as ``tqdm`` does.

    Returns
    -------
    dict of str to float
        Root-mean-square change over the image, relative to its brightest pixel without the effect.

    Examples
    --------
    >>> from lf_flame import plan_effects
    >>> from lf_flame.scenes import read_scene
    >>> from lf_flame.simulation import measure_changes
    >>> scene, camera, _ = read_scene("scene.toml")
    >>> changes = measure_changes(scene, camera, plan_effects(scene, camera))
    >>> 0.01 < changes["defocus"] < 0.1
    True
    """
    asked = [effect for effect in plan.effects if _can_be_measured(effect)]
    return {effect.name: _change(scene, camera, plan, effect) for effect in progress(asked)}


def _can_be_measured(effect: PlannedEffect) -> bool:
    if effect.stated:
        return effect.bound > 0
    return CAUSES[effect.name].typical is not None


def _change(
    scene: Scene, camera: PlenopticCamera, plan: EffectPlan, effect: PlannedEffect
) -> float:
    cause = CAUSES.get(effect.name)
    if not effect.stated and cause is not None and cause.typical is not None:
        camera = replace(camera, **{cause.field: cause.typical(camera)})
    forced = {name: name in OF_THE_SCENE and plan[name].kept for name in EFFECTS}
    forced["round_aperture"] = effect.name == "f_number_mismatch"  # both are one stop
    without, with_it = (
        _render(scene, camera, plan.tolerance, forced | {effect.name: on}) for on in (False, True)
    )
    change = np.sqrt(np.square(with_it - without, dtype=np.float64).mean())
    return float(change / max(float(without.max()), np.finfo(np.float32).tiny))


def _render(scene, camera, tolerance: float, forced: dict[str, bool]) -> np.ndarray:
    plan = plan_effects(scene, camera, tolerance, forced)
    rays = RAYS if plan.integrator == "rays" else None
    return render_plan(scene, camera, plan, plan.integrator, rays, seed=0).views
