"""Effect plan: which optical effects are simulated for a scene, how finely, and by what method.

All effects that are left out may change the image, together, by at most a quarter of the tolerance.
"""

import math
from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass, field, replace

import numpy as np
from tabulate import tabulate

from lf_flame.errors import InputError
from lf_flame.optics.camera import PlenopticCamera
from lf_flame.scenes.scene import Scene
from lf_flame.simulation.planning.chosen_pixels import LEFT_OUT_SHARE, find_counts
from lf_flame.simulation.planning.effects import (
    CAUSES,
    EFFECTS,
    MATTER,
    NOT_SEPARABLE,
    RAYS,
    is_stated,
    typical_bounds,
)
from lf_flame.simulation.planning.scene_bounds import SceneBounds, bound_scene

TOLERANCE = 1e-3
"""Tolerance of an image without noise, if none is stated."""

OF_NOISE = 0.25
"""Tolerance of a noisy image, if none is stated, in standard deviations of its noise: the error of
all pixels together then grows by a thirtieth at most."""


@dataclass(frozen=True)
class PlannedEffect:
    """Decision on one effect: one line of a plan.

    Attributes
    ----------
    name : str
        Name of the effect, one of `lf_flame.simulation.planning.effects.EFFECTS`.
    bound : float
        Upper bound on the change of the image if the effect is left out, relative to the brightest
        pixel. For optical effects it is the change of the light that reaches the sensor; for a
        stage of the sensor (noise, quantisation, saturation) the change by that stage alone. The
        converter of a sensor can turn a smaller change of light into one whole step.
    kept : bool
        Whether the effect is simulated.
    forced : bool
        Whether the user, not the bound, made the decision.
    criterion : str
        Reason for the bound, with its numbers.
    stated : bool
        Whether the camera states the cause of the effect. If not, the bound is 0 because the cause
        is unknown, not because the effect is small.
    """

    name: str
    bound: float
    kept: bool
    forced: bool
    criterion: str
    stated: bool = True


@dataclass(frozen=True)
class EffectPlan:
    """Plan of the effects that are simulated and left out, with reasons; `print` shows a table.

    Attributes
    ----------
    tolerance : float
        Largest acceptable error of the image, relative to its brightest pixel.
    effects : tuple of PlannedEffect
        Decisions on all known effects, in the order in which light meets them.
    slabs : tuple of int
        Number of planes that represent each layer of the scene, in the scene's order; 1 for flat
        layers.
    colours : int
        Number of focal lengths that represent the band of light; 1 without chromatic shift.
    traced : tuple of str
        Kept effects that treat the rays of one pixel's bundle differently, which only the ray
        integrator can render: stops, a rotated array, layers that occlude or absorb.
    rays : int or None
        Number of rays per pixel along each axis; None if the scene is integrated exactly.
    parts : int
        Number of parts along each axis into which pixels are cut for diffraction by the lenslets.
    typical : mapping of str to float
        Bounds of effects whose causes are not stated, each at a typical value; see
        `lf_flame.simulation.planning.effects.typical_bounds`. Empty unless requested.
    measured : mapping of str to float
        Measured changes of the image, see `measure_changes`. Empty unless requested.
    seconds : float
        Estimated time in seconds for the whole image on this machine.
    tolerance_by_noise : bool
        Whether the tolerance follows from the noise of the sensor, because none was stated.
    hexagonal : bool
        Whether the lenslets are hexagons, whose light is interpolated to the grid of the views.
    """

    tolerance: float
    effects: tuple[PlannedEffect, ...]
    slabs: tuple[int, ...]
    colours: int
    traced: tuple[str, ...]
    rays: int | None = None
    parts: int = 1
    typical: Mapping[str, float] = field(default_factory=dict)
    measured: Mapping[str, float] = field(default_factory=dict)
    seconds: float = 0.0
    tolerance_by_noise: bool = False
    hexagonal: bool = False

    @property
    def integrator(self) -> str:
        """Name of the integrator that renders the scene: "exact" or "rays"."""
        return "rays" if self.rays else "exact"

    @property
    def not_separable(self) -> dict[str, str]:
        """Causes for which refocused images need a light field, each with the reason.

        They are kept effects, and "layout" for an array of hexagons. If it is empty, light only
        adds up, and its sums along y and along x are independent: refocused images can then be
        computed directly from the scene (`lf_flame.projection`).
        """
        acts = {name for name in self.kept if name not in (*MATTER, *RAYS)} | set(self.traced)
        acts |= {"layout"} if self.hexagonal else set()
        return {name: why for name, why in NOT_SEPARABLE.items() if name in acts}

    @property
    def kept(self) -> frozenset[str]:
        """Names of the effects that are simulated."""
        return frozenset(effect.name for effect in self.effects if effect.kept)

    @property
    def left_out_bound(self) -> float:
        """Bound on the relative change of the image by all effects that the plan left out.

        Effects that the user forced off, and effects whose causes the camera does not state, are
        not included.
        """
        return sum(e.bound for e in self.effects if not e.kept and not e.forced)

    def __getitem__(self, name: str) -> PlannedEffect:
        """Decision on one effect, by name."""
        return next(effect for effect in self.effects if effect.name == name)

    def to_json(self) -> dict:
        """JSON values of the plan, for the record of an image or a data set."""
        lines = [
            {**asdict(e), "bound": e.bound if math.isfinite(e.bound) and e.stated else None}
            for e in self.effects
        ]
        return {
            "tolerance": self.tolerance,
            "integrator": self.integrator,
            "slabs": list(self.slabs),
            "colours": self.colours,
            "rays": self.rays,
            "parts": self.parts,
            "left_out_bound": self.left_out_bound,
            "not_separable": self.not_separable,
            "effects": lines,
        }

    def __str__(self) -> str:
        found = {name: f"{change:.2g}" for name, change in self.measured.items()}
        rows = [
            (
                effect.name,
                f"{effect.bound:.2g}" if effect.stated else "not stated",
                *([found.get(effect.name, "")] if found else []),
                ("kept" if effect.kept else "left out") + (", forced" if effect.forced else ""),
                self._criterion(effect),
            )
            for effect in self.effects
        ]
        columns = ["effect", "bound", *(["measured"] if found else []), "decision", "criterion"]
        table = tabulate(rows, headers=columns, tablefmt="simple", disable_numparse=True)
        notes = [
            f"tolerance {self.tolerance:.3g} of the brightest pixel"
            f"{', a quarter of the noise' if self.tolerance_by_noise else ''}, "
            f"{LEFT_OUT_SHARE:.0%} of it for "
            f"effects that are left out, smallest first; those stated, and not forced, change the "
            f"image by at most {self.left_out_bound:.2g}",
            *self._not_stated(),
            f"integrator: {self.integrator}; it takes about {self.seconds:.2g} s on this machine",
            *self._way_to_images(),
        ]
        if max(self.slabs) > 1:
            notes.append(f"slabs of each layer: {', '.join(map(str, self.slabs))}")
        if self.rays:
            notes.append(f"rays of each pixel: {self.rays} x {self.rays}")
        if self.parts > 1:
            notes.append(f"parts of each pixel: {self.parts} x {self.parts}")
        if self.colours > 1:
            notes.append(f"colours over the band: {self.colours}")
        return f"{table}\n\n" + "\n".join(notes)

    def _not_stated(self) -> list[str]:
        """Say how many effects have causes that are not stated, and how to state them."""
        unknown = [effect for effect in self.effects if not effect.stated]
        if not unknown:
            return []
        return [
            f"not stated, and not included in that number: {len(unknown)} effects whose causes the "
            f"camera does not give; state them in the camera's table, or try --assume "
            f"550nm,round,12bit or --assume typical"
        ]

    def _criterion(self, effect: PlannedEffect) -> str:
        """Reason for an effect's bound; if not stated, also its size at a typical value."""
        if effect.name not in self.typical:
            return effect.criterion
        typical = self.typical[effect.name]
        return f"{effect.criterion}; {CAUSES[effect.name].words}: up to {typical:.2g}"

    def _way_to_images(self) -> list[str]:
        """Say whether refocused images need the light field, and why."""
        if not self.not_separable:
            return ["refocused images: directly from the scene, because light only adds up"]
        reasons = [f"  {name} {why}" for name, why in self.not_separable.items()]
        return ["refocused images: through the light field, because", *reasons]


def plan_effects(
    scene: Scene,
    camera: PlenopticCamera,
    tolerance: float | None = None,
    effects: Mapping[str, bool] | None = None,
    typical: bool = False,
    *,
    stated: Collection[str] = (),
    integrator: str = "auto",
    rays: int | None = None,
) -> EffectPlan:
    """Decide which optical effects to simulate for a scene, and how finely.

    For each effect, an upper bound is computed on how much the image would change if the effect
    were left out. Effects are left out, smallest bound first, while the sum of their bounds is
    within a quarter of the tolerance; the others are kept. Several hundred pixels are then rendered
    with ever more slabs, colours, parts of pixels and rays, until they change by less than the rest
    of the tolerance.

    Parameters
    ----------
    scene : Scene
        Scene to render.
    camera : PlenopticCamera
        Camera that records it.
    tolerance : float, optional
        Largest acceptable error of the image: root mean square, relative to its brightest pixel.
        Default: 1e-3, or a quarter of the noise of the camera's sensor, if that is more.
    effects : mapping of str to bool, optional
        Effects to simulate (True) or to leave out (False) regardless of their bounds, by name
        (`lf_flame.simulation.planning.effects.EFFECTS`).
    typical : bool, optional
        Whether also to estimate the effects whose causes the camera does not state, such as noise
        without a sensor, at typical values; see `EffectPlan.typical`.
    stated : collection of str, optional
        Names of fields of the camera that were set on purpose, although to the default value;
        effects that they cause are not among the typical ones.
    integrator, rays : optional
        Method of integration and number of rays, as in `lf_flame.render`.

    Returns
    -------
    EffectPlan
        Effects that are kept and left out, with bounds and reasons; `print` shows it as a table.

    Raises
    ------
    InputError
        If the tolerance is not above 0, an effect is unknown, the integrator cannot simulate one,
        or the tolerance would need too many slabs, colours, parts of pixels or rays.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame import PAPER_CAMERA, Layer, Scene, plan_effects
    >>> scene = Scene([Layer(np.ones((8, 8)), depth_mm=10.0, size_mm=(4.0, 4.0))])
    >>> sorted(plan_effects(scene, PAPER_CAMERA).kept)
    ['defocus']
    """
    if not isinstance(effects, Mapping | None):
        raise InputError(f"effects must map names to True or False, got {effects!r:.100}.")
    forced = dict(effects or {})
    _check_request(tolerance, forced, integrator, rays)
    bounds = bound_scene(scene, camera)
    noise = OF_NOISE * _noise(bounds, forced)
    by_noise = tolerance is None and noise > TOLERANCE
    tolerance = max(noise, TOLERANCE) if tolerance is None else tolerance
    bounds, planned = _decide(bounds, forced, LEFT_OUT_SHARE * tolerance, stated)
    acting = {one.name for one in planned if one.kept and one.bound > 0}
    if "f_number_mismatch" in acting:  # which is that of the round stop
        acting.add("round_aperture")
    traced = _traced(bounds, acting)
    if integrator == "exact" and traced:
        raise InputError(
            f"The exact integrator cannot simulate {', '.join(traced)} here; "
            f"use integrator='auto', or force them off."
        )
    plan = EffectPlan(
        tolerance, planned, (1,) * len(scene.layers), 1, traced, tolerance_by_noise=by_noise,
        hexagonal=camera.layout == "hexagonal",
    )  # fmt: skip
    by_rays = integrator == "rays" or bool(traced)
    counts = find_counts(bounds.pixels, plan.kept, traced, tolerance, by_rays, rays)
    seconds = bounds.pixels.time(plan.kept, traced, counts)
    found = typical_bounds(bounds, stated) if typical else {}
    return replace(plan, **counts._asdict(), seconds=seconds, typical=found)


def _noise(bounds: SceneBounds, forced: Mapping[str, bool]) -> float:
    """Find the noise of the brightest pixel: standard deviation, relative to it."""
    sensor = bounds.camera.sensor
    if sensor is None or not bounds.peak > 0:
        return 0.0
    electrons = bounds.peak * sensor.exposure_e
    shot = math.sqrt(electrons) if forced.get("shot_noise", True) else 0.0
    read = sensor.read_noise_e if forced.get("read_noise", True) else 0.0
    return math.hypot(shot, read) / electrons


def _decide(
    bounds: SceneBounds, forced: dict[str, bool], allowance: float, stated: Collection[str]
) -> tuple[SceneBounds, tuple[PlannedEffect, ...]]:
    """Decide on all effects; also returns the bounds as the decision on defocus leaves them."""
    # Where defocus may be left out, the blur that softens other changes may be missing.
    defocus = EFFECTS["defocus"](bounds).bound
    bounds = replace(bounds, defocus=forced.get("defocus", defocus > allowance))
    estimates = {name: find(bounds) for name, find in EFFECTS.items()}
    known = {name for name in EFFECTS if is_stated(bounds.camera, name, stated)}
    for name in (name for name, on in forced.items() if on and name not in known):
        if not estimates[name].bound:
            raise InputError(f"{name} cannot be forced on: {estimates[name].criterion}.")
    kept = _choose({name: found.bound for name, found in estimates.items()}, forced, allowance)
    planned = tuple(
        PlannedEffect(
            name, found.bound, name in kept, name in forced, found.criterion,
            stated=name in known or found.bound > 0,
        )
        for name, found in estimates.items()
    )  # fmt: skip
    return bounds, planned


def _check_request(tolerance, forced: Mapping[str, bool], integrator: str, rays) -> None:
    """Refuse values out of range, and effects that are unknown or not booleans."""
    if tolerance is not None and not (tolerance > 0 and math.isfinite(tolerance)):
        raise InputError(f"tolerance must be above 0, got {tolerance}.")
    unknown = [repr(name) for name in forced if name not in EFFECTS]
    if unknown:
        raise InputError(
            f"Unknown effect {', '.join(unknown)}; the known ones are {', '.join(EFFECTS)}."
        )
    for name, value in forced.items():
        if not isinstance(value, bool | np.bool_):
            raise InputError(f"Effect {name} must be forced by True or False, got {value!r}.")
    if integrator not in ("auto", "exact", "rays"):
        raise InputError(f"integrator must be auto, exact or rays, got {integrator!r}.")
    if rays is not None and (integrator != "rays" or rays < 1):
        raise InputError(
            f"rays must be at least 1 and needs integrator='rays', got {rays}, {integrator!r}."
        )


def _choose(changes: dict[str, float], forced: dict[str, bool], allowance: float) -> set[str]:
    """Leave out effects, smallest bound first, while their sum is small enough; keep the rest."""
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


def _traced(bounds: SceneBounds, kept: Collection[str]) -> tuple[str, ...]:
    """Kept effects that treat the rays of one pixel's bundle differently."""
    # A flat layer that absorbs, with nothing behind it, only becomes darker.
    alone = all(
        not layer.depth_extent_mm and not bounds.behind[layer]
        for layer in bounds.layers
        if layer.optical_thickness.any()
    )
    return tuple(
        name
        for name in (*MATTER, *RAYS)
        if name in kept and not (name == "self_absorption" and alone)
    )
