"""Decisions of an effect plan: which effects are simulated, in how many parts, and by what method.

All effects that are left out may change the image, together, by at most a quarter of the tolerance.
The rest of the tolerance is for the slabs of thick layers, the colours of a chromatic lens and the
finite number of rays. A tighter tolerance therefore never drops an effect.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from lf_flame.errors import InputError
from lf_flame.optics.camera import PlenopticCamera
from lf_flame.scenes.scene import Scene
from lf_flame.simulation.planning.assumptions import is_stated, typical_bounds
from lf_flame.simulation.planning.effects import EFFECTS, MATTER, RAYS, Estimate
from lf_flame.simulation.planning.part_counts import count_colours, count_slabs
from lf_flame.simulation.planning.plan import LEFT_OUT_SHARE, EffectPlan, PlannedEffect
from lf_flame.simulation.planning.scene_bounds import SceneBounds, bound_scene
from lf_flame.simulation.planning.time_estimates import compare_integrators, estimate_seconds


def plan_effects(
    scene: Scene,
    camera: PlenopticCamera,
    tolerance: float = 1e-3,
    effects: Mapping[str, bool] | None = None,
    typical: bool = False,
    *,
    stated: Collection[str] = (),
) -> EffectPlan:
    """Decide which optical effects to simulate for a scene, before anything is rendered.

    For each effect, an upper bound is computed on how much the image would change if the effect
    were left out. Effects are left out, smallest bound first, while the sum of their bounds is
    within a quarter of the tolerance; the others are kept.

    Parameters
    ----------
    scene : Scene
        Scene to render.
    camera : PlenopticCamera
        Camera that records it.
    tolerance : float, optional
        Largest acceptable error of the image: root mean square, relative to its brightest pixel.
    effects : mapping of str to bool, optional
        Effects to simulate (True) or to leave out (False) regardless of their bounds, by name
        (`lf_flame.simulation.planning.effects.EFFECTS`).
    typical : bool, optional
        Whether also to estimate the effects whose causes the camera does not state, such as noise
        without a sensor, at typical values; see `EffectPlan.typical`.
    stated : collection of str, optional
        Names of fields of the camera that were set on purpose, although to the default value;
        effects that they cause are not among the typical ones.

    Returns
    -------
    EffectPlan
        Effects that are kept and left out, with bounds and reasons; `print` shows it as a table.

    Raises
    ------
    InputError
        If the tolerance is not above 0, an effect is unknown, or the tolerance would need more
        than 1,024 slabs (depth steps of a thick layer) or colours.

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
    chosen = _choose_effects(bound_scene(scene, camera), forced, LEFT_OUT_SHARE * tolerance)
    bounds, estimates, kept = chosen
    slabs = [1] * len(scene.layers)
    if "thickness" in kept:
        slabs = count_slabs(bounds, scene, tolerance, "self_absorption" in kept)
    colours = count_colours(bounds, tolerance) if "chromatic" in kept else 1
    traced = _traced(chosen)
    times = _estimate_times(scene, chosen, tolerance, slabs, colours, traced)
    planned = tuple(
        PlannedEffect(
            name,
            estimate.bound,
            name in kept,
            name in forced,
            estimate.criterion,
            times.added[name],
            stated=is_stated(camera, name, stated) or estimate.bound > 0,
        )
        for name, estimate in estimates.items()
    )
    return EffectPlan(
        tolerance,
        planned,
        tuple(slabs),
        colours,
        traced,
        times.integrator,
        typical_bounds(scene, camera, stated) if typical else {},
        seconds=times.seconds,
    )


class _Chosen(NamedTuple):
    """Effects that are simulated, and the bounds from which they were chosen.

    Attributes
    ----------
    bounds : SceneBounds
        Bounds of the scene; without the blur of defocus if that is left out.
    estimates : dict of str to Estimate
        Estimate of each effect with these bounds.
    kept : set of str
        Names of the effects that are simulated.
    """

    bounds: SceneBounds
    estimates: dict[str, Estimate]
    kept: set[str]

    @property
    def changes(self) -> dict[str, float]:
        """Bound of each effect."""
        return _changes(self.estimates)


class _Times(NamedTuple):
    """Estimated times in seconds on one core.

    Attributes
    ----------
    integrator : str
        Name of the integrator that renders the scene.
    added : dict of str to float
        Time that each effect adds, or would add.
    seconds : dict of str to float
        Time of the whole image by each integrator.
    """

    integrator: str
    added: dict[str, float]
    seconds: dict[str, float]


def _choose_effects(bounds: SceneBounds, forced: dict[str, bool], allowance: float) -> _Chosen:
    """Choose the effects to simulate: those forced on, and those that the allowance calls for."""
    estimates, sharp = _estimate_changes(bounds, forced, allowance)
    changes = _changes(estimates)
    # Without the blur of defocus the bounds of other effects are larger. Leaving defocus out costs
    # this difference too.
    changes["defocus"] += sum(
        max(0.0, sharp[name].bound - estimate.bound) for name, estimate in estimates.items()
    )
    kept = _choose(changes, forced, allowance)
    if "defocus" in kept:
        return _Chosen(bounds, estimates, kept)
    return _Chosen(replace(bounds, defocus=False), sharp, kept)


def _changes(estimates: Mapping[str, Estimate]) -> dict[str, float]:
    return {name: estimate.bound for name, estimate in estimates.items()}


def _estimate_times(
    scene: Scene,
    chosen: _Chosen,
    tolerance: float,
    slabs: Sequence[int],
    colours: int,
    traced: tuple[str, ...],
) -> _Times:
    """Estimate the time of each integrator, choose one, and estimate what each effect adds."""
    bounds, _, kept = chosen

    def costs_of(names: Collection[str]) -> dict[str, float]:
        return compare_integrators(scene, bounds.camera, tolerance, kept, slabs, names)

    costs = costs_of(traced)
    integrator = "rays" if traced else "exact"
    without = {}
    for name in traced:
        others = [one for one in traced if one != name]
        without[name] = costs_of(others)["rays" if others else "exact"]
    added = estimate_seconds(bounds, slabs, colours, costs[integrator], without)
    after = kept - {*MATTER, *RAYS, "thickness", "chromatic"}
    rest = costs["blank"] + sum(time for name, time in added.items() if name in after)
    seconds = {name: costs[name] * colours + rest for name in ("exact", "rays")}
    return _Times(integrator, added, seconds)


def _estimate_changes(
    bounds: SceneBounds, forced: Mapping[str, bool], allowance: float
) -> tuple[dict[str, Estimate], dict[str, Estimate]]:
    """Estimate how much leaving out each effect changes the image, with and without defocus.

    If defocus is certain to be kept, the second result equals the first.
    """
    estimates = {name: find(bounds) for name, find in EFFECTS.items()}
    if forced.get("defocus", estimates["defocus"].bound > allowance):
        return estimates, estimates
    without = replace(bounds, defocus=False)
    sharp = {name: find(without) for name, find in EFFECTS.items()}
    return (sharp if "defocus" in forced else estimates), sharp


def check_request(tolerance: float, forced: Mapping[str, bool]) -> None:
    """Check a tolerance, and the names and values of forced effects.

    Raises
    ------
    InputError
        If the tolerance is not a finite number above 0, an effect is unknown, or its value is not
        True or False.
    """
    if not (tolerance > 0 and math.isfinite(tolerance)):
        raise InputError(f"tolerance must be above 0, got {tolerance}.")
    unknown = [repr(name) for name in forced if name not in EFFECTS]
    if unknown:
        raise InputError(
            f"Unknown effect {', '.join(unknown)}; the known ones are {', '.join(EFFECTS)}."
        )
    for name, value in forced.items():
        if not isinstance(value, bool | np.bool_):
            raise InputError(f"Effect {name} must be forced by True or False, got {value!r}.")


def _choose(changes: dict[str, float], forced: dict[str, bool], allowance: float) -> set[str]:
    """Leave out effects, smallest bound first, while the sum of their bounds is small enough.

    Returns
    -------
    set of str
        Names of the effects that are kept.
    """
    kept = {name for name, on in forced.items() if on}
    used = 0.0
    for name in sorted((name for name in changes if name not in forced), key=changes.__getitem__):
        used += changes[name]
        if used > allowance:
            kept.add(name)
    if "f_number_mismatch" in kept:  # one round stop causes both effects
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


def _traced(chosen: _Chosen) -> tuple[str, ...]:
    """Kept effects that occur, and that treat the rays of one pixel's bundle differently."""
    changes = chosen.changes
    # A flat layer that absorbs, with nothing behind it, only becomes darker.
    alone = all(
        not layer.thickness_mm and not chosen.bounds.behind[layer]
        for layer in chosen.bounds.layers
        if layer.optical_thickness.any()
    )
    candidates = chosen.kept - ({"self_absorption"} if alone else set())
    return tuple(name for name in (*MATTER, *RAYS) if name in candidates and changes[name] > 0)
