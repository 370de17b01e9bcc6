"""The effect plan: which physical effects a scene calls for, and how the image will be made.

`lf_flame.simulation.planning.decisions` makes it.
"""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field

from tabulate import tabulate

from lf_flame.simulation.planning.assumptions import CAUSES
from lf_flame.simulation.planning.effects import MATTER, NOT_SEPARABLE, RAYS


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
    """Plan of the effects that are simulated and left out, with reasons; `print` shows a table.

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
        `lf_flame.simulation.planning.assumptions.typical_bounds`. Empty unless asked for.
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
        """Effects, each with the reason, for which refocused images need a light field.

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


def _short(number: float | None) -> str:
    return "" if number is None else f"{number:.2g}"
