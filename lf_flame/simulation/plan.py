"""The effect plan: which physical effects a scene calls for, and how the image will be made.

An effect is left out only if all that is left out together changes the image by less than a
quarter of the tolerance; the rest is for the slabs of thick flames, the colours of a chromatic lens
and the finite number of rays. A tighter tolerance so never drops an effect.
"""

import math
from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass, field, replace

import numpy as np
from tabulate import tabulate

from lf_flame.errors import InputError
from lf_flame.optics.camera import PlenopticCamera
from lf_flame.scenes.scene import Scene
from lf_flame.simulation.assumptions import CAUSES, is_stated, typical_bounds
from lf_flame.simulation.effects import EFFECTS, MATTER, NOT_SEPARABLE, RAYS, Estimate
from lf_flame.simulation.optical_pass import OpticalPass
from lf_flame.simulation.part_counts import count_colours, count_slabs
from lf_flame.simulation.scene_bounds import SceneBounds, bound_scene
from lf_flame.simulation.time_estimates import compare_integrators, estimate_seconds

LEFT_OUT_SHARE = 0.25
"""Share of the tolerance that all effects left out may use up together."""


RAYS_SHARE = 0.5
"""Share of the tolerance for the finite number of rays."""


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
    stated : bool
        Whether the camera states what the effect follows from. Where it does not, the bound of 0
        says nothing about how large the effect is.
    """

    name: str
    bound: float
    kept: bool
    forced: bool
    criterion: str
    seconds: float
    stated: bool = True


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
    typical : mapping of str to float
        Bounds of effects that are not stated, each at its typical value; see
        `lf_flame.simulation.assumptions.typical_bounds`. Empty unless asked for.
    measured : mapping of str to float
        Measured changes of the image, see `lf_flame.simulation.measuring`. Empty unless asked for.
    seconds : mapping of str to float
        Estimate of the time that "exact" and "rays" take for the image, on one core.
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
    typical: Mapping[str, float] = field(default_factory=dict)
    measured: Mapping[str, float] = field(default_factory=dict)
    seconds: Mapping[str, float] = field(default_factory=dict)

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
        """Bound on the relative change of the image by all that the plan itself left out.

        Effects whose causes are not stated are not counted.
        """
        return sum(e.bound for e in self.effects if not e.kept and not e.forced)

    def __getitem__(self, name: str) -> PlannedEffect:
        """Look up one effect by name."""
        return next(effect for effect in self.effects if effect.name == name)

    def _repr_html_(self) -> str:
        """Show the plan in a notebook, as `print` does."""
        from lf_flame._common.notebook_html import paragraph, table

        rows = [
            (e.name, self._bound(e), "kept" if e.kept else "left out", self._criterion(e))
            for e in self.effects
        ]
        words = f"tolerance {self.tolerance:g}, integrator: {self.integrator}"
        return table(("effect", "bound", "decision", "criterion"), rows) + paragraph(words)

    def to_json(self) -> dict:
        """Values for a record beside an image or a data set."""
        lines = [
            {**asdict(e), "bound": e.bound if math.isfinite(e.bound) and e.stated else None}
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
                self._bound(effect),
                *([_short(self.measured.get(effect.name))] if self.measured else []),
                ("kept" if effect.kept else "left out") + (", forced" if effect.forced else ""),
                self._criterion(effect),
                f"{effect.seconds:.2g}" if effect.seconds else "",
            )
            for effect in self.effects
        ]
        measured = ["measured"] if self.measured else []
        columns = ["effect", "bound", *measured, "decision", "criterion", "adds (s)"]
        table = tabulate(rows, headers=columns, tablefmt="simple", disable_numparse=True)
        notes = [
            f"tolerance {self.tolerance:g}: relative to the brightest pixel; what is stated and "
            f"left out changes the image by at most {self.left_out_bound:.2g}",
            *self._not_stated(),
            f"integrator: {self.integrator}; on one core it takes about "
            f"{self.seconds[self.integrator]:.2g} s",
            *self._way_to_images(),
        ]
        if max(self.slabs) > 1:
            notes.append(f"slabs of each layer: {', '.join(map(str, self.slabs))}")
        if self.colours > 1:
            notes.append(f"colours over the band: {self.colours}")
        return f"{table}\n\n" + "\n".join(notes)

    def _not_stated(self) -> list[str]:
        """Say how many effects nothing is known about, and how to state them."""
        unknown = [effect for effect in self.effects if not effect.stated]
        if not unknown:
            return []
        return [
            f"not stated, hence not in that number: {len(unknown)} effects, whose causes the "
            f"camera does not give; state them in its table, or try --assume 550nm,round,12bit "
            f"or --assume typical"
        ]

    @staticmethod
    def _bound(effect: PlannedEffect) -> str:
        return f"{effect.bound:.2g}" if effect.stated else "not stated"

    def _criterion(self, effect: PlannedEffect) -> str:
        """Words on an effect, with what one that is not stated would typically be."""
        if effect.name not in self.typical:
            return effect.criterion
        typical = self.typical[effect.name]
        return f"{effect.criterion}; {CAUSES[effect.name].words}: up to {typical:.2g}"

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


def _short(number: float | None) -> str:
    return "" if number is None else f"{number:.2g}"


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
