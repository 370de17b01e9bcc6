"""Assume causes of effects that a data sheet does not state, and measure what each changes."""

import re
from collections.abc import Callable, Collection, Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from lf_flame.errors import InputError
from lf_flame.optics.camera import PlenopticCamera
from lf_flame.scenes.scene import Scene
from lf_flame.simulation.planning.effects import CAUSES, EFFECTS, TYPICAL_SENSOR, is_stated
from lf_flame.simulation.planning.plan import EffectPlan, PlannedEffect, plan_effects
from lf_flame.simulation.rendering import CROSSING, render_plan

MEASURING_RAYS = 4
"""Number of rays per pixel along each axis, if rays are traced. Images with and without an effect
use the same rays, so that their errors nearly cancel in the difference."""

OF_THE_SCENE = ("defocus", "occlusion", "self_absorption", "thickness")
"""Effects that stay as planned while another one is measured; all others are off."""


def assume(
    camera: PlenopticCamera, words: Iterable[str], stated: Collection[str] = ()
) -> PlenopticCamera:
    """Set properties of a camera that its data sheet does not state.

    Parameters
    ----------
    camera : PlenopticCamera
        Camera to start from.
    words : iterable of str
        Assumptions, applied in order:

        - ``550nm``: wavelength, which turns on diffraction;
        - ``round``: round aperture, matched to the lenslets;
        - ``f/4``: round aperture with this f-number of the main lens;
        - ``12bit``: sensor with this number of bits, otherwise typical;
        - ``falloff``: images are not divided by a white image, so that cos^4 remains;
        - ``typical``: typical value for each field that is not stated and has one.
    stated : collection of str, optional
        Fields that ``typical`` does not change although they have the default value.

    Returns
    -------
    PlenopticCamera
        Camera with these properties.

    Raises
    ------
    InputError
        If a word is not one of these, or a value is out of range.

    Examples
    --------
    >>> from lf_flame import PAPER_CAMERA
    >>> from lf_flame.simulation import assume
    >>> assume(PAPER_CAMERA, ["550nm", "f/4"]).wavelength_nm
    550.0
    """
    for word in words:
        camera = replace(camera, **_assumed_fields(camera, word, stated))
    return camera


def _assumed_fields(camera: PlenopticCamera, word: str, stated: Collection[str]) -> dict[str, Any]:
    number = r"(\d+(?:\.\d*)?)"
    if word == "typical":
        return {
            cause.field: cause.typical(camera)
            for name, cause in CAUSES.items()
            if cause.typical and not is_stated(camera, name, stated) and name != "f_number_mismatch"
        }
    if word == "round":
        return {"aperture_diameter_mm": camera.aperture_mm}
    if word == "falloff":
        return {"falloff_corrected": False}
    if found := re.fullmatch(number + "nm", word):
        return {"wavelength_nm": float(found[1])}
    if (found := re.fullmatch("f/" + number, word)) and float(found[1]) > 0:
        return {"aperture_diameter_mm": camera.main_lens_focal_mm / float(found[1])}
    if found := re.fullmatch(r"(\d{1,2})bit", word):
        return {"sensor": replace(camera.sensor or TYPICAL_SENSOR, bits=int(found[1]))}
    raise InputError(
        f"Assumptions must be 550nm, round, f/4, 12bit (any numbers), falloff or typical, "
        f"separated by commas, got {word!r}."
    )


def measure_changes(
    scene: Scene,
    camera: PlenopticCamera,
    plan: EffectPlan,
    *,
    progress: Callable[[Iterable], Iterable] = iter,
) -> dict[str, float]:
    """Measure the change of the image by each effect of a plan, by rendering with and without it.

    An effect whose cause the camera does not state is measured at a typical value of the cause
    (`lf_flame.simulation.planning.plan`). The bounds of a plan hold for all similar scenes; the
    measured change of one scene is smaller, often much smaller. Effects that hexagonal arrays do
    not simulate are not measured for them.

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
    asked = [effect for effect in plan.effects if _can_be_measured(effect, camera)]
    return {effect.name: _change(scene, camera, plan, effect) for effect in progress(asked)}


def _can_be_measured(effect: PlannedEffect, camera: PlenopticCamera) -> bool:
    if camera.layout == "hexagonal" and effect.name in CROSSING:
        return False
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
    if plan.rays:
        plan = replace(plan, rays=MEASURING_RAYS)
    return render_plan(scene, camera, plan, seed=0).views
