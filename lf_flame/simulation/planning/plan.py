"""Effect plan: which optical effects are simulated for a scene, and how its image is rendered.

`lf_flame.simulation.planning.decisions` makes plans. An effect whose cause a camera does not state
(no wavelength: no diffraction; no sensor: no noise) is left out because it is unknown, not because
it is small. A plan says so; `typical_bounds` estimates it at a typical value of the cause.
"""

import math
import re
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any, NamedTuple

from tabulate import tabulate

from lf_flame.errors import InputError
from lf_flame.optics.camera import PlenopticCamera
from lf_flame.optics.sensor import Sensor
from lf_flame.simulation.planning.effects import EFFECTS, MATTER, NOT_SEPARABLE, RAYS
from lf_flame.simulation.planning.scene_bounds import SceneBounds, assuming

LEFT_OUT_SHARE = 0.25
"""Fraction of the tolerance that all effects that are left out may use together."""

TYPICAL_SENSOR = Sensor(exposure_e=8_000.0, full_well_e=10_000.0, bits=12, read_noise_e=2.0)
"""Sensor of an industrial camera: full well and noise as in EMVA 1288 data sheets of small pixels,
with an exposure of four fifths of the full well."""


class Cause(NamedTuple):
    """Cause of an effect: a field of a camera, its value if not stated, and a typical one."""

    field: str
    unstated: Any
    typical: Callable[[PlenopticCamera], Any] | None
    words: str


_SENSOR = Cause("sensor", None, lambda camera: TYPICAL_SENSOR, "10,000 electrons, 12 bits")
_WAVELENGTH = Cause("wavelength_nm", None, lambda camera: 550.0, "550 nm")

CAUSES = {
    "cos4": Cause("falloff_corrected", True, lambda camera: False, "without a white image"),
    "round_aperture": Cause(
        "aperture_diameter_mm", None, lambda camera: camera.aperture_mm, "a round, matched stop"
    ),
    "f_number_mismatch": Cause(
        "aperture_diameter_mm", None, lambda camera: 1.05 * camera.aperture_mm, "a stop 5 % wider"
    ),
    "vignetting": Cause("rim_diameter_mm", None, None, ""),
    "lenslet_diffraction": _WAVELENGTH,
    "main_lens_diffraction": _WAVELENGTH,
    # Calibration files of two Lytro cameras state 0.54 and 0.86 mrad, 0.034 and 0.037 %.
    "lenslet_rotation": Cause("lenslet_rotation_rad", 0.0, lambda camera: 7e-4, "0.7 mrad"),
    "lenslet_pitch_error": Cause("lenslet_pitch_error", 0.0, lambda camera: 3.5e-4, "0.035 %"),
    # Secondary spectrum of an achromat: W. J. Smith, Modern Optical Engineering.
    "chromatic": Cause("chromatic_shift", 0.0, lambda camera: 1 / 2400, "an achromat"),
    "shot_noise": _SENSOR,
    "read_noise": _SENSOR,
    "quantisation": _SENSOR,
    "saturation": _SENSOR,
}
"""Causes of the effects that follow from a camera's optional fields; other effects follow from the
scene."""


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
        `lf_flame.simulation.planning.plan.typical_bounds`. Empty unless requested.
    measured : mapping of str to float
        Measured changes of the image, see `measure_changes`. Empty unless requested.
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


def is_stated(camera: PlenopticCamera, effect: str, stated: Collection[str] = ()) -> bool:
    """Whether a camera, or a list of fields that a file names, states the cause of an effect."""
    cause = CAUSES.get(effect)
    if cause is None or getattr(camera, cause.field) != cause.unstated:
        return True
    return cause.unstated is not None and cause.field in stated


def typical_bounds(bounds: SceneBounds, stated: Collection[str] = ()) -> dict[str, float]:
    """Bound each effect whose cause a camera does not state, at its typical value, if any."""
    camera, found = bounds.camera, {}
    for name, cause in CAUSES.items():
        if is_stated(camera, name, stated) or cause.typical is None:
            continue
        assumed = replace(camera, **{cause.field: cause.typical(camera)})
        found[name] = EFFECTS[name](assuming(bounds, assumed)).bound
    return found


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
        f"What to assume must be 550nm, round, f/4, 12bit (any numbers), falloff or typical, "
        f"separated by commas, got {word!r}."
    )
