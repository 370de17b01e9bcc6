"""Steps of processing, chosen by name."""

from typing import TYPE_CHECKING

import numpy as np

from lf_flame.errors import InputError
from lf_flame.flame_video.processing.emission_steps import Emission, Temperature
from lf_flame.flame_video.processing.steps import Contour, Height, Refocus, Step, Views
from lf_flame.optics.lens import Lens

if TYPE_CHECKING:
    from lf_flame.tomography import ColourCalibration

NAMES = (
    "decode",
    "refocus@10mm",
    "refocus@0.5",
    "emission",
    "temperature",
    "height",
    "contour",
)
"""Names of steps, as examples."""


def find_steps(
    names: str,
    *,
    camera: Lens | None = None,
    depths_mm: tuple[float, ...] = (),
    block: int = 1,
    noise: float | None = None,
    strength: float | None = None,
    background: str = "fit",
    colours: "ColourCalibration | None" = None,
    soot_exponent: float = 1.0,
    level: float = 0.5,
    pixel_mm: float | None = None,
    burner_row: float | None = None,
) -> tuple[Step, ...]:
    """Make steps of their names.

    Parameters
    ----------
    names : str
        Names with commas between them: ``decode`` (frames are decoded anyway; alone, it keeps the
        views), ``refocus@10mm`` (a depth) or ``refocus@0.5`` (a slope), ``emission``,
        ``temperature`` (of the emission before it), ``height`` and ``contour``. The last two
        measure the image of the last refocusing before them, or the central view.
    camera : Lens, optional
        Camera; needed for depths.
    depths_mm : tuple of float, optional
        Depths of the planes of ``emission``.
    block, noise, strength, background
        Options of ``emission``, see `Emission`.
    colours : ColourCalibration, optional
        Calibration of the channels of frames in colour: ``emission`` is then found in each colour.
        Needed for ``temperature``.
    soot_exponent : float, optional
        Exponent a of soot's absorption for ``temperature``, ``wavelength^-a``, from -1 to 5.
    level, pixel_mm, burner_row
        Options of ``height`` and ``contour``, see `Height`. Default of `pixel_mm`: by the camera at
        the depth of the refocusing before it; without one, lengths are in pixels.

    Returns
    -------
    tuple of Step

    Raises
    ------
    InputError
        If a name is unknown or repeated, or an option that a step needs is missing.

    Examples
    --------
    >>> from lf_flame.flame_video import find_steps
    >>> find_steps("decode,refocus@0.5,height")
    (Refocus(slope=0.5, depth_mm=None), Height(level=0.5, pixel_mm=None, burner_row=None))
    """
    words = [word.strip() for word in names.split(",")]
    steps: list[Step] = []
    side = pixel_mm
    for number, word in enumerate(words):
        if word in words[:number]:
            raise InputError(f"Each step may be named once, got {word!r} twice.")
        if word == "decode":
            if number:
                raise InputError("decode must be the first step.")
            if len(words) == 1:
                steps.append(Views())
        elif word.startswith("refocus@"):
            focus = _find_focus(word.removeprefix("refocus@"), camera)
            steps.append(focus)
            side = _pixel_side(focus, camera) if pixel_mm is None else pixel_mm
        elif word == "emission":
            if camera is None or not depths_mm:
                raise InputError("The step emission needs the camera, and depths of its planes.")
            channels = () if colours is None else colours.responses.names
            fit = (tuple(depths_mm), block, noise, strength, background, channels)
            steps.append(Emission(camera, *fit))
        elif word == "temperature":
            steps.append(_find_temperature(colours, soot_exponent, words[:number]))
        elif word == "height":
            steps.append(Height(level, side, burner_row))
        elif word == "contour":
            steps.append(Contour(level, burner_row))
        else:
            raise InputError(f"Steps must be of {', '.join(NAMES)}, got {word!r}.")
    return tuple(steps)


def _pixel_side(focus: Refocus, camera: Lens | None) -> float | None:
    """Side of a pixel in mm at the depth of a refocusing; None without a depth or a camera."""
    if camera is None or focus.depth_mm is None:
        return None
    return camera.field_mm(focus.depth_mm)[0] / camera.lenslets[0]


def _find_temperature(
    colours: "ColourCalibration | None", soot_exponent: float, before: list[str]
) -> Temperature:
    """Make the step temperature, if the steps before it find the emission."""
    if colours is None or "emission" not in before:
        raise InputError(
            "The step temperature needs the step emission before it, and a calibration of "
            "the colours."
        )
    return Temperature(colours, soot_exponent)


def _find_focus(place: str, camera: Lens | None) -> Refocus:
    """Make a refocusing of a depth as ``10mm``, or a slope as ``0.5``."""
    try:
        number = float(place.removesuffix("mm"))
    except ValueError:
        number = np.nan
    if not np.isfinite(number):
        raise InputError(
            f"A refocusing must be at a depth, as refocus@10mm, or a slope, as refocus@0.5, got "
            f"{place!r}."
        )
    if not place.endswith("mm"):
        return Refocus(number)
    if camera is None:
        raise InputError(f"refocus@{place} needs the camera; or give a slope, as refocus@0.5.")
    camera.check_depths(number)
    return Refocus(float(camera.depth_to_slope(number)), number)
