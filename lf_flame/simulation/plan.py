"""The effect plan: which physical effects a scene calls for, and how the image will be made.

An effect is left out only if all that is left out together changes the image by less than a
quarter of the tolerance; the rest is for the slabs of thick flames, the colours of a chromatic lens
and the finite number of rays. A tighter tolerance so never drops an effect.
"""

import math
from bisect import bisect_left
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from functools import partial

import numpy as np
from tabulate import tabulate

from lf_flame.errors import InputError
from lf_flame.optics.camera import PlenopticCamera
from lf_flame.optics.sensor import STAGES
from lf_flame.scenes.scene import Layer, Scene
from lf_flame.simulation.absorbing_slabs import AbsorbingSlabs
from lf_flame.simulation.effects import EFFECTS, MATTER, NOT_SEPARABLE, RAYS, Estimate
from lf_flame.simulation.optical_pass import OpticalPass
from lf_flame.simulation.polygons import expected_pairs, split_planes
from lf_flame.simulation.scene_bounds import (
    SceneBounds,
    bound_scene,
    box_mm,
    change_rate,
    smeared,
)
from lf_flame.simulation.slabs import slab_edges, slice_scene
from lf_flame.simulation.spread_bounds import colour_change, depth_change

LEFT_OUT_SHARE = 0.25
"""Share of the tolerance that all effects left out may use up together."""

SLICING_SHARE = 0.125
"""Share of the tolerance for the slabs of thick layers, and the same for the colours."""

RAYS_SHARE = 0.5
"""Share of the tolerance for the finite number of rays."""

MOST_PARTS = 1024
"""Slabs or colours beyond which a tolerance counts as out of reach."""

POWERS = tuple(2**k for k in range(1, 12))
"""Powers of 2 that are tried as numbers of parts."""

EIGHTHS_MEAN = 5 / 8
"""Mean move to the far ends of a part's eighths, over the move to the part's end: `smeared`'s."""

TRAVEL_PER_MEAN = 2 / EIGHTHS_MEAN
"""Travel from end to end of a part, over the mean move that `smeared` finds."""

BOX_EDGES = 2
"""Edges of a box along one axis."""

BOUNDARIES_BESIDE = 2
"""Boundaries of cells that an edge passes at most, beyond its travel over the width of a cell."""

KINK = 8
"""Of a slope that jumps by J inside a part of width h, midpoints err by at most J h^2 / KINK."""

CURVATURE = 24
"""Of a second derivative g, midpoints of parts of width h err by g h^2 / CURVATURE."""

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


@dataclass(frozen=True)
class PlannedEffect:
    """One line of a plan.

    Attributes
    ----------
    name : str
    bound : float
        Upper bound on the relative change of the image if it is left out: of the light that
        reaches the sensor, or for a stage of the sensor, of what that stage does by itself.
        (Behind a converter that rounds, a smaller change can become a whole step.)
    kept : bool
    forced : bool
        Whether the user decided, not the bound.
    criterion : str
    seconds : float
        Estimate of the time that it adds, or would add, on one core.
    """

    name: str
    bound: float
    kept: bool
    forced: bool
    criterion: str
    seconds: float


@dataclass(frozen=True)
class EffectPlan:
    """What will be simulated, and what not, and why; `print` shows it as a table.

    Attributes
    ----------
    tolerance : float
    effects : tuple of PlannedEffect
        All known effects, in the order in which light meets them.
    slabs : tuple of int
        Planes for each layer of the scene, in its order.
    colours : int
        Focal lengths over the band of light.
    traced : tuple of str
        Kept effects that weigh or shift the rays of one bundle unevenly.
    integrator : str
        The cheapest that does everything kept: "exact" or "rays". Stops and a rotated array need
        rays; what hides or dims takes them where polygons would be too many.
    """

    tolerance: float
    effects: tuple[PlannedEffect, ...]
    slabs: tuple[int, ...]
    colours: int
    traced: tuple[str, ...]
    integrator: str

    @property
    def only_by_rays(self) -> tuple[str, ...]:
        """Kept effects that the exact integrator cannot do."""
        return tuple(name for name in self.traced if name in RAYS)

    @property
    def not_separable(self) -> dict[str, str]:
        """What stands between the scene and images without a light field: effect and reason.

        Empty where light only adds, along y and along x apart: refocused images are then projected
        straight from the scene (`lf_flame.projection`).
        """
        acts = {name for name in self.kept if name not in (*MATTER, *RAYS)} | set(self.traced)
        return {name: why for name, why in NOT_SEPARABLE.items() if name in acts}

    @property
    def kept(self) -> frozenset[str]:
        """Names of the effects that will be simulated."""
        return frozenset(effect.name for effect in self.effects if effect.kept)

    @property
    def left_out_bound(self) -> float:
        """Bound on the relative change of the image by all that the plan itself left out."""
        return sum(e.bound for e in self.effects if not e.kept and not e.forced)

    def __getitem__(self, name: str) -> PlannedEffect:
        """Look up one effect by name."""
        return next(effect for effect in self.effects if effect.name == name)

    def to_json(self) -> dict:
        """Values for a record beside an image or a data set."""
        lines = [
            {**asdict(e), "bound": e.bound if math.isfinite(e.bound) else None}
            for e in self.effects
        ]
        return {
            "tolerance": self.tolerance,
            "integrator": self.integrator,
            "slabs": list(self.slabs),
            "colours": self.colours,
            "left_out_bound": self.left_out_bound,
            "not_separable": self.not_separable,
            "effects": lines,
        }

    def __str__(self) -> str:
        rows = [
            (
                effect.name,
                f"{effect.bound:.2g}",
                ("kept" if effect.kept else "left out") + (", forced" if effect.forced else ""),
                effect.criterion,
                f"{effect.seconds:.2g}" if effect.seconds else "",
            )
            for effect in self.effects
        ]
        columns = ["effect", "bound", "decision", "criterion", "adds (s)"]
        table = tabulate(rows, headers=columns, tablefmt="simple", disable_numparse=True)
        notes = [
            f"tolerance {self.tolerance:g}: relative to the brightest pixel; what is left out "
            f"changes the image by at most {self.left_out_bound:.2g}",
            f"integrator: {self.integrator}",
            *self._way_to_images(),
        ]
        if max(self.slabs) > 1:
            notes.append(f"slabs of each layer: {', '.join(map(str, self.slabs))}")
        if self.colours > 1:
            notes.append(f"colours over the band: {self.colours}")
        return f"{table}\n\n" + "\n".join(notes)

    def _way_to_images(self) -> list[str]:
        """Say whether refocused images need the light field, and why."""
        if not self.not_separable:
            return ["refocused images: straight from the scene, as light only adds"]
        reasons = [f"  {name} {why}" for name, why in self.not_separable.items()]
        return ["refocused images: through the light field, as", *reasons]


def plan_effects(
    scene: Scene,
    camera: PlenopticCamera,
    tolerance: float = 1e-3,
    effects: Mapping[str, bool] | None = None,
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

    Returns
    -------
    EffectPlan

    Raises
    ------
    InputError
        If the tolerance is not above 0, an effect is unknown, or the tolerance would need more
        slabs or colours than are sensible.
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
        slabs = _count_slabs(bounds, scene, tolerance, "self_absorption" in kept)
    colours = _count_colours(bounds, tolerance) if "chromatic" in kept else 1
    traced = _traced(kept, changes, bounds)
    costs = _compare_costs(scene, camera, tolerance, kept, slabs, traced)
    rays = any(name in RAYS for name in traced) or costs["rays"] < costs["exact"]
    integrator = "rays" if rays else "exact"
    seconds = _estimate_seconds(bounds, kept, slabs, colours, costs, integrator)
    planned = tuple(
        PlannedEffect(name, e.bound, name in kept, name in forced, e.criterion, seconds[name])
        for name, e in estimates.items()
    )
    return EffectPlan(tolerance, planned, tuple(slabs), colours, traced, integrator)


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


def _count_slabs(
    bounds: SceneBounds, scene: Scene, tolerance: float, absorption: bool
) -> list[int]:
    """Planes for each layer, so that those of all layers together keep within their share."""
    thick = sum(layer.thickness_mm > 0 for layer in scene.layers)
    allowance = SLICING_SHARE * tolerance * bounds.peak / max(thick, 1)

    def change(layer: Layer, slabs: float) -> float:
        moved = _sliced_change(
            bounds,
            layer,
            slabs,
            lambda axis, n: smeared(bounds, layer, axis, depth_mm=layer.thickness_mm / n),
        )
        return moved if moved <= allowance else min(moved, depth_change(bounds, layer, slabs))

    def count(layer: Layer) -> int:
        if not layer.thickness_mm > 0:
            return 1
        even = partial(change, layer)
        if not (absorption and layer.optical_thickness.any()):
            return _count_parts(even, allowance, "thickness", tolerance)
        crowded = _absorbing_change(bounds, layer, even)
        return _count_parts(crowded, allowance, "thickness", tolerance, 2 * MOST_PARTS)

    return [count(layer) for layer in scene.layers]


def _absorbing_change(
    bounds: SceneBounds, layer: Layer, even: Callable[[float], float]
) -> Callable[[int], float]:
    """Bound on the error of the slabs of a layer that absorbs, of which half crowd at its faces.

    even: bound for so many equal slabs, of the light as if nothing dimmed it.
    """
    absorbing = AbsorbingSlabs(bounds, layer)

    def change(slabs: int) -> float:
        widest = float(np.diff(slab_edges(layer, slabs)).max())
        return min(absorbing.change(slabs), even(1 / widest))

    return change


def _count_colours(bounds: SceneBounds, tolerance: float) -> int:
    allowance = SLICING_SHARE * tolerance * bounds.peak
    band_mm = bounds.camera.chromatic_shift * bounds.camera.main_lens_focal_mm

    def smear(layer: Layer, axis: int, colours: int) -> float:
        return smeared(bounds, layer, axis, focal_mm=band_mm / colours)

    def change(colours: int) -> float:
        moved = [
            _sliced_change(bounds, layer, colours, partial(smear, layer)) for layer in bounds.layers
        ]
        if sum(moved) <= allowance:
            return sum(moved)
        return sum(
            min(one, colour_change(bounds, layer, colours))
            for one, layer in zip(moved, bounds.layers, strict=True)
        )

    return _count_parts(change, allowance, "chromatic", tolerance)


def _sliced_change(
    bounds: SceneBounds, layer: Layer, parts: float, smear: Callable[[int, float], float]
) -> float:
    """Bound on the error of `parts` midpoints in place of an integral over depth or colour.

    The smaller of two ("How many slabs" in the documentation derives them). Of the first order:
    as if the light of each part stood where it moves the bundle farthest. Of the second: a box
    that moves by ``travel`` of its own widths in all bends its light where an edge passes from
    cell to cell, by ``next * travel`` each, for which midpoints err by 1 / KINK; and in between
    by the product of both axes, ``2 whole travel_y travel_x``, for which they err by
    1 / CURVATURE.

    smear: from an axis and a number of parts to the change of the first order.
    """
    first, travels, kinks = 0.0, [], 0.0
    for axis in (0, 1):
        steps, box = bounds.steps[layer, axis], box_mm(bounds, layer, axis)
        first += smear(axis, parts)
        if box == 0 or steps.whole == 0:
            return first if box == 0 else 0.0
        # From a part so small that its change is in proportion to its travel.
        smallest = smear(axis, MOST_PARTS) * MOST_PARTS
        travels.append(TRAVEL_PER_MEAN * smallest / change_rate(steps, box) / box)
        crossed = BOX_EDGES * (travels[axis] * box / steps.cell_mm + BOUNDARIES_BESIDE)
        kinks += crossed * steps.next * travels[axis] / KINK
    whole = max(bounds.steps[layer, axis].whole for axis in (0, 1))
    curvature = 2 * whole * travels[0] * travels[1]
    return min(first, (kinks + curvature / CURVATURE) / parts**2)


def _count_parts(
    change: Callable[[int], float],
    allowance: float,
    effect: str,
    tolerance: float,
    most: int = MOST_PARTS,
) -> int:
    """Smallest power of 2, or half between two, whose change is within the allowance."""
    parts = [n for n in sorted((*POWERS, *(3 * n // 2 for n in POWERS))) if n <= most]
    enough = bisect_left(parts, True, key=lambda n: change(n) <= allowance)
    if enough == len(parts):
        raise InputError(
            f"tolerance {tolerance:g} cannot be met: {effect} would need more than "
            f"{most} parts; allow more, or force {effect} off."
        )
    return parts[enough]


def _traced(kept: set[str], changes: dict[str, float], bounds: SceneBounds) -> tuple[str, ...]:
    """Kept effects that arise and that weigh or shift the rays of one bundle unevenly."""
    alone = all(
        not layer.thickness_mm and not bounds.behind[layer]
        for layer in bounds.layers
        if layer.optical_thickness.any()
    )
    candidates = set(kept) - ({"self_absorption"} if alone else set())
    return tuple(name for name in (*MATTER, *RAYS) if name in candidates and changes[name] > 0)


def optical_passes(camera: PlenopticCamera, plan: EffectPlan) -> list[OpticalPass]:
    """Set up the camera as a plan leaves it: a pass for each colour."""
    kept = plan.kept
    angle = camera.lenslet_rotation_rad if "lenslet_rotation" in plan.traced else 0.0
    scale = 1 + (camera.lenslet_pitch_error if "lenslet_pitch_error" in kept else 0.0)
    stops: list[tuple[float, float]] = []
    width = camera.aperture_mm
    if "round_aperture" in plan.traced:
        if "f_number_mismatch" in plan.traced:
            width = camera.aperture_diameter_mm or width
        stops.append((0.0, width / 2))
    if "vignetting" in plan.traced and camera.rim_diameter_mm is not None:
        stops.append((camera.rim_distance_mm, camera.rim_diameter_mm / 2))
    ideal = OpticalPass(
        camera,
        share=1 / plan.colours,
        defocus="defocus" in kept,
        falloff="cos4" in kept and not camera.falloff_corrected,
        lenslet_scale=scale * math.cos(angle),
        lenslet_skew=scale * math.sin(angle),
        stops=tuple(stops),
        every_lenslet=angle != 0 or scale != 1 or width > camera.aperture_mm,
        round_aperture="round_aperture" in plan.traced,
    )
    middles = (np.arange(plan.colours) + 0.5) / plan.colours - 0.5
    focal = [camera.main_lens_focal_mm * (1 + camera.chromatic_shift * place) for place in middles]
    return [replace(ideal, focal_mm=focal_mm) for focal_mm in focal]


def _compare_costs(scene, camera, tolerance, kept: set[str], slabs, traced) -> dict[str, float]:
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


def _estimate_seconds(bounds, kept: set[str], slabs, colours: int, costs, integrator: str) -> dict:
    """Roughly how long each effect takes, on one core."""
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
