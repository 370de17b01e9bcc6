"""Effects whose causes a camera does not state, and their size at typical values.

Without a wavelength, no diffraction is simulated; without a sensor, no noise. Such an effect is
left out because its cause is unknown, not because it is small. A plan says so, and `typical_bounds`
estimates the size of the effect at a typical value.
"""

import re
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass, replace
from typing import Any

from lf_flame.errors import InputError
from lf_flame.optics.camera import PlenopticCamera
from lf_flame.optics.sensor import Sensor
from lf_flame.simulation.planning.effects import EFFECTS
from lf_flame.simulation.planning.scene_bounds import SceneBounds, assuming

TYPICAL_SENSOR = Sensor(exposure_e=8_000.0, full_well_e=10_000.0, bits=12, read_noise_e=2.0)
"""Sensor of an industrial camera: full well and noise as in EMVA 1288 data sheets of small pixels,
with an exposure of four fifths of the full well."""


@dataclass(frozen=True)
class Cause:
    """Cause of an effect: a field of a camera.

    Attributes
    ----------
    field : str
        Name of the field.
    unstated : object
        Value of the field that means "not stated": its default.
    typical : callable, optional
        Function of the camera that returns a typical value; None if there is none.
    words : str
        Description of the typical value.
    """

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


def is_stated(camera: PlenopticCamera, effect: str, stated: Collection[str] = ()) -> bool:
    """Whether a camera states the cause of an effect.

    Parameters
    ----------
    camera : PlenopticCamera
    effect : str
        Name of the effect.
    stated : collection of str, optional
        Fields that count as stated although they have the default value, because a file names them.
    """
    cause = CAUSES.get(effect)
    if cause is None or getattr(camera, cause.field) != cause.unstated:
        return True
    return cause.unstated is not None and cause.field in stated


def typical_bounds(bounds: SceneBounds, stated: Collection[str] = ()) -> dict[str, float]:
    """Bound each effect whose cause a camera does not state, at a typical value of that cause.

    Parameters
    ----------
    bounds : SceneBounds
        Bounds of the scene in front of its camera.
    stated : collection of str, optional
        As in `is_stated`.

    Returns
    -------
    dict of str to float
        Bound on the relative change of the image, as in a plan, by effect. Effects without a
        typical value are missing.
    """
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
