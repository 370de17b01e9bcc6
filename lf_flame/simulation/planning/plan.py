"""Effect plan: which optical effects are simulated for a scene, and how its image is rendered.

`lf_flame.simulation.planning.decisions` makes plans.
"""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field

from tabulate import tabulate

from lf_flame.simulation.planning.assumptions import CAUSES
from lf_flame.simulation.planning.effects import MATTER, NOT_SEPARABLE, RAYS

LEFT_OUT_SHARE = 0.25
"""Fraction of the tolerance that all effects that are left out may use together."""


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
        Whether the user made the decision, not the bound.
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
        `lf_flame.simulation.planning.assumptions.typical_bounds`. Empty unless requested.
    measured : mapping of str to float
        Measured changes of the image, see `lf_flame.simulation.measuring`. Empty unless requested.
    seconds : float
        Estimated time in seconds for the whole image on this machine.
    tolerance_by_noise : bool
        Whether the tolerance follows from the noise of the sensor, because none was stated.
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

    @property
    def integrator(self) -> str:
        """Name of the integrator that renders the scene: "rays" if any effect needs rays."""
        return "rays" if self.traced else "exact"

    @property
    def not_separable(self) -> dict[str, str]:
        """Kept effects for which refocused images need a light field, each with the reason.

        If it is empty, light only adds up, and its sums along y and along x are independent:
        refocused images can then be computed directly from the scene (`lf_flame.projection`).
        """
        acts = {name for name in self.kept if name not in (*MATTER, *RAYS)} | set(self.traced)
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
        """JSON values of the plan, for a record beside an image or a data set."""
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
        rows = [
            (
                effect.name,
                self._bound(effect),
                *([_short(self.measured.get(effect.name))] if self.measured else []),
                ("kept" if effect.kept else "left out") + (", forced" if effect.forced else ""),
                self._criterion(effect),
            )
            for effect in self.effects
        ]
        measured = ["measured"] if self.measured else []
        columns = ["effect", "bound", *measured, "decision", "criterion"]
        table = tabulate(rows, headers=columns, tablefmt="simple", disable_numparse=True)
        notes = [
            f"tolerance {self.tolerance:.3g} of the brightest pixel"
            f"{', a quarter of the noise' if self.tolerance_by_noise else ''}, "
            f"{LEFT_OUT_SHARE:.0%} of it for "
            f"effects that are left out, smallest first; those that are stated change the image by "
            f"at most {self.left_out_bound:.2g}",
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

    @staticmethod
    def _bound(effect: PlannedEffect) -> str:
        return f"{effect.bound:.2g}" if effect.stated else "not stated"

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


def _short(number: float | None) -> str:
    return "" if number is None else f"{number:.2g}"
