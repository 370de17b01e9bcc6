"""The decisions of an effect plan: what is kept, in how many parts, by which integrator.

An effect is left out only if all that is left out together changes the image by less than a quarter
of the tolerance; the rest is for the slabs of thick flames, the colours of a chromatic lens and the
finite number of rays. A tighter tolerance therefore never drops an effect.
"""

import math
from collections.abc import Collection, Mapping
from dataclasses import replace

import numpy as np

from lf_flame.errors import InputError
from lf_flame.optics.camera import PlenopticCamera
from lf_flame.scenes.scene import Scene
from lf_flame.simulation.planning.assumptions import is_stated, typical_bounds
from lf_flame.simulation.planning.effects import EFFECTS, MATTER, RAYS, Estimate
from lf_flame.simulation.planning.part_counts import count_colours, count_slabs
from lf_flame.simulation.planning.plan import EffectPlan, PlannedEffect
from lf_flame.simulation.planning.scene_bounds import SceneBounds, bound_scene
from lf_flame.simulation.planning.time_estimates import compare_integrators, estimate_seconds

LEFT_OUT_SHARE = 0.25
"""Share of the tolerance that all effects left out may use up together."""


def plan_effects(
    scene: Scene,
    camera: PlenopticCamera,
    tolerance: float = 1e-3,
    effects: Mapping[str, bool] | None = None,
    typical: bool = False,
    *,
    stated: Collection[str] = (),
) -> EffectPlan:
    """Decide which effects a scene calls for, before anything is rendered.

    Parameters
    ----------
    scene : Scene
    camera : PlenopticCamera
    tolerance : float, optional
        Change of the image that may be accepted, relative to its brightest pixel.
    effects : mapping of str to bool, optional
        Effects to force on (True) or off (False), whatever their bound.
    typical : bool, optional
        Tell how large effects would be whose causes the camera does not state, at usual values.
    stated : collection of str, optional
        Fields of the camera that count as stated although they hold the default.

    Returns
    -------
    EffectPlan

    Raises
    ------
    InputError
        If the tolerance is not above 0, an effect is unknown, or the tolerance would need more
        slabs or colours than are sensible.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame import PAPER_CAMERA, Layer, Scene, plan_effects
    >>> scene = Scene([Layer(np.ones((8, 8)), depth_mm=10.0, size_mm=(4.0, 4.0))])
    >>> sorted(plan_effects(scene, PAPER_CAMERA).kept)
    ['defocus']
    """
    forced = dict(effects or {})
    check_request(tolerance, forced)
    bounds = bound_scene(scene, camera)
    allowance = LEFT_OUT_SHARE * tolerance
    estimates, sharp = _estimate_changes(bounds, forced, allowance)
    # Without defocus all else may change more, which leaving it out then costs too.
    changes = {name: estimate.bound for name, estimate in estimates.items()}
    changes["defocus"] += sum(
        max(0.0, sharp[name].bound - estimate.bound) for name, estimate in estimates.items()
    )
    kept = _choose(changes, forced, allowance)
    if "defocus" not in kept:
        bounds, estimates = replace(bounds, defocus=False), sharp
    changes = {name: estimate.bound for name, estimate in estimates.items()}
    slabs = [1] * len(scene.layers)
    if "thickness" in kept:
        slabs = count_slabs(bounds, scene, tolerance, "self_absorption" in kept)
    colours = count_colours(bounds, tolerance) if "chromatic" in kept else 1
    traced = _traced(kept, changes, bounds)

    def compare(names: Collection[str]) -> tuple[dict[str, float], str]:
        costs = compare_integrators(scene, camera, tolerance, kept, slabs, names)
        cheaper = any(name in MATTER for name in names) and costs["rays"] < costs["exact"]
        rays = any(name in RAYS for name in names) or cheaper
        return costs, "rays" if rays else "exact"

    costs, integrator = compare(traced)
    others = {}
    for name in traced:
        without, instead = compare([one for one in traced if one != name])
        others[name] = without[instead]
    added = estimate_seconds(bounds, kept, slabs, colours, costs, others, integrator)
    planned = tuple(
        PlannedEffect(
            name, e.bound, name in kept, name in forced, e.criterion, added[name],
            stated=is_stated(camera, name, stated) or e.bound > 0,
        )
        for name, e in estimates.items()
    )  # fmt: skip
    after = set(kept) - {*MATTER, *RAYS, "thickness", "chromatic"}
    rest = costs["blank"] + sum(added[name] for name in after)
    seconds = {name: costs[name] * colours + rest for name in ("exact", "rays")}
    usual = typical_bounds(scene, camera, stated) if typical else {}
    return EffectPlan(
        tolerance, planned, tuple(slabs), colours, traced, integrator, usual, seconds=seconds
    )


def _estimate_changes(
    bounds: SceneBounds, forced: Mapping[str, bool], allowance: float
) -> tuple[dict[str, Estimate], dict[str, Estimate]]:
    """Estimate what leaving out each effect costs, with defocus and, if that may go, without."""
    estimates = {name: find(bounds) for name, find in EFFECTS.items()}
    if forced.get("defocus", estimates["defocus"].bound > allowance):
        return estimates, estimates
    without = replace(bounds, defocus=False)
    sharp = {name: find(without) for name, find in EFFECTS.items()}
    return (sharp if "defocus" in forced else estimates), sharp


def check_request(tolerance: float, forced: Mapping[str, bool]) -> None:
    """Refuse a tolerance or effects that cannot be meant.

    Raises
    ------
    InputError
    """
    if not (tolerance > 0 and math.isfinite(tolerance)):
        raise InputError(f"tolerance must be above 0, got {tolerance}.")
    for name, value in forced.items():
        if name not in EFFECTS:
            raise InputError(f"Unknown effect {name!r}; the known ones are {', '.join(EFFECTS)}.")
        if not isinstance(value, bool | np.bool_):
            raise InputError(f"Effect {name} must be forced by True or False, got {value!r}.")


def _choose(changes: dict[str, float], forced: dict[str, bool], allowance: float) -> set[str]:
    """Leave out effects, smallest bound first, while their sum stays within the allowance."""
    kept = {name for name, on in forced.items() if on}
    used = 0.0
    for name in sorted((name for name in changes if name not in forced), key=changes.__getitem__):
        used += changes[name]
        if used > allowance:
            kept.add(name)
    if "f_number_mismatch" in kept:  # both are one round stop
        if forced.get("round_aperture", True):
            kept.add("round_aperture")
        elif "f_number_mismatch" not in forced:
            kept.remove("f_number_mismatch")
        else:
            raise InputError(
                "f_number_mismatch cannot be forced on with round_aperture forced off: "
                "both are one round stop."
            )
    return kept


def _traced(kept: set[str], changes: dict[str, float], bounds: SceneBounds) -> tuple[str, ...]:
    """Kept effects that arise and that weigh or shift the rays of one bundle unevenly."""
    alone = all(
        not layer.thickness_mm and not bounds.behind[layer]
        for layer in bounds.layers
        if layer.optical_thickness.any()
    )
    candidates = set(kept) - ({"self_absorption"} if alone else set())
    return tuple(name for name in (*MATTER, *RAYS) if name in candidates and changes[name] > 0)
