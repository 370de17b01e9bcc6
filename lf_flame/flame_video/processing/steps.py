"""Steps of processing: functions of one frame, chosen by name."""

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple, Protocol

import numpy as np

from lf_flame.errors import InputError
from lf_flame.flame_video.flame_shape import (
    APART,
    CEILING,
    CUT,
    DARK,
    SPARK,
    SPECK,
    FlameShape,
    check_measures,
    measure_flame,
)
from lf_flame.flame_video.output import Measures
from lf_flame.lightfield import AXES, LightField
from lf_flame.optics.lens import Lens
from lf_flame.refocus import farthest_slope, shift_and_sum

DOUBTS = {"dark": DARK, "speck": SPECK, "cut": CUT, "ceiling": CEILING, "apart": APART,
          "spark": SPARK}  # fmt: skip
"""Sentences on a flame's shape by the names of their bits in the array ``doubts``."""

ALIKE = 2.0
"""Largest ratio of the light of two frames of which one takes the strength of the penalty, and the
dependence of noise on brightness, from the other: a dark frame knows neither."""

POINTS = 256
"""Number of points of a stored contour, at equal distances along it."""


class Values(NamedTuple):
    """Array that a step gives for a frame, with the names of its axes and its attributes.

    An array with the name of its only axis is a coordinate, the same for all frames.
    """

    values: Any
    axes: tuple[str, ...] = ()
    attributes: dict[str, Any] = {}  # noqa: RUF012 - never changed


@dataclass
class Frame:
    """A light field on its way through the steps.

    Attributes
    ----------
    light_field : LightField
    image : ndarray, shape (t, s)
        Grey image in which the flame is measured: the central view, or the last refocused image.
    warnings : list of str
        Sentences on what makes the results doubtful.
    before : dict
        Results of the frame before in the same task that steps keep, by their names.
    """

    light_field: LightField
    image: np.ndarray = field(init=False)
    warnings: list[str] = field(default_factory=list)
    before: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self):
        self.image = Measures().image(self.light_field)
        self._shapes: dict[tuple, FlameShape] = {}

    def shape(self, level: float, burner_row: float | None = None) -> FlameShape:
        """Measure the flame in pixels, once for each image and options."""
        key = (id(self.image), level, burner_row)
        if key not in self._shapes:
            self._shapes[key] = measure_flame(self.image, level=level, burner_row=burner_row)
        return self._shapes[key]


class Step(Protocol):
    """Function of one frame; its ``repr`` states all its options.

    It returns arrays by name, which have the same axes and shapes for every frame.
    """

    def __call__(self, frame: Frame) -> dict[str, Values]: ...  # noqa: D102


@dataclass(frozen=True)
class Views:
    """Keep the decoded light field itself: ``views``, unknown pixels filled."""

    def __call__(self, frame: Frame) -> dict[str, Values]:
        """Give the views."""
        views = frame.light_field.filled
        return {"views": Values(views, AXES[: views.ndim])}


@dataclass(frozen=True)
class Refocus:
    """Refocus at a slope; later steps measure the flame in this image.

    Attributes
    ----------
    slope : float
    depth_mm : float, optional
        Depth of that slope, which names the array.
    """

    slope: float
    depth_mm: float | None = None

    @property
    def name(self) -> str:
        """Name of the array: ``refocus_10mm`` or ``refocus_0.5``."""
        return (
            f"refocus_{self.slope:g}" if self.depth_mm is None else f"refocus_{self.depth_mm:g}mm"
        )

    def __call__(self, frame: Frame) -> dict[str, Values]:
        """Give the refocused image, in colour if the frame is."""
        light_field = frame.light_field
        limit = farthest_slope(light_field)
        if not abs(self.slope) <= limit:
            raise InputError(
                f"The slope must lie from {-limit:g} to {limit:g}, beyond which views are shifted "
                f"by more than the image, got {self.slope:g}."
            )
        # Filled, so that no warning is repeated with each frame.
        filled = replace(light_field, views=light_field.filled, valid=None)
        image = shift_and_sum(filled, [self.slope])[0]
        frame.image = image.astype(np.float64)
        frame.image = frame.image.mean(axis=2) if image.ndim == 3 else frame.image
        known = {"slope": self.slope, "depth_mm": self.depth_mm}
        return {self.name: Values(image, ("y", "x", "channel")[: image.ndim], known)}


@dataclass(frozen=True)
class Emission:
    """Reconstruct the emission on depth planes, as `lf_flame.tomography.reconstruct` does.

    A frame's fit starts from that of the frame before in the same task, and takes its strength,
    unless its light differs by more than `ALIKE` from that for which the strength was chosen.

    Attributes
    ----------
    camera : Lens
    depths_mm : tuple of float
        Depths of the planes.
    block, noise, strength, background
        As for `FrustumGrid` and `reconstruct`.
    """

    camera: Lens = field(repr=False)
    depths_mm: tuple[float, ...]
    block: int = 1
    noise: float | None = None
    strength: float | None = None
    background: str | None = None

    def __getstate__(self):
        # Each process makes its own plan, which is large.
        return {name: value for name, value in vars(self).items() if name != "_plan"}

    @cached_property
    def _plan(self):
        from lf_flame.tomography import FrustumGrid, ReconstructionPlan

        return ReconstructionPlan(
            FrustumGrid(self.camera, self.depths_mm, self.block),
            noise=self.noise,
            strength=self.strength,
            background=self.background,
        )

    def __call__(self, frame: Frame) -> dict[str, Values]:
        """Give emission, noise of a pixel, and number of warnings."""
        last, light = frame.before.get("emission", (None, 0.0))
        found = self._plan.reconstruct(frame.light_field, start=last)
        now = float(found.emission.sum(dtype=np.float64))
        if not light / ALIKE <= now <= light * ALIKE:
            if last is not None:
                found = self._plan.reconstruct(frame.light_field)
            light = now
        frame.before["emission"] = found, light
        frame.warnings += found.warnings
        return {
            "depth": Values(np.array(self.depths_mm), ("depth",), {"units": "mm"}),
            "emission": Values(found.emission, ("depth", "y", "x")),
            "emission_noise": Values(np.float32(found.noise)),
            "emission_warnings": Values(np.uint8(min(len(found.warnings), 255))),
        }


@dataclass(frozen=True)
class Height:
    """Measure height, row of the tip, width, area and brightness of the flame.

    Attributes
    ----------
    level, pixel_mm, burner_row
        As for `measure_flame`.
    """

    level: float = 0.5
    pixel_mm: float | None = None
    burner_row: float | None = None

    def __post_init__(self):
        check_measures(self.level, 1.0 if self.pixel_mm is None else self.pixel_mm)

    def __call__(self, frame: Frame) -> dict[str, Values]:
        """Give the measures, NaN without a flame, and a bit for each doubt."""
        shape = frame.shape(self.level, self.burner_row)
        side, unit = (1.0, "px") if self.pixel_mm is None else (self.pixel_mm, "mm")
        masks = [1 << k for k in range(len(DOUBTS))]
        bits = {"flag_masks": masks, "flag_meanings": " ".join(DOUBTS)}
        doubts = sum(1 << k for k, said in enumerate(DOUBTS.values()) if said in shape.warnings)
        return {
            "height": Values(np.float64(shape.height * side), (), {"units": unit}),
            "tip_row": Values(np.float64(shape.tip_row)),
            "width": Values(np.float64(shape.width * side), (), {"units": unit}),
            "area": Values(np.float64(shape.area * side**2), (), {"units": f"{unit}2"}),
            "brightness": Values(np.float64(shape.brightness)),
            "doubts": Values(np.uint8(doubts), (), bits),
        }


@dataclass(frozen=True)
class Contour:
    """Trace the contour of the flame: rows and columns of `POINTS` points at equal distances."""

    level: float = 0.5
    burner_row: float | None = None

    def __post_init__(self):
        check_measures(self.level, 1.0)

    def __call__(self, frame: Frame) -> dict[str, Values]:
        """Give the contour in pixels, NaN without a flame; the last point equals the first."""
        shape = frame.shape(self.level, self.burner_row)
        points = np.full((POINTS, 2), np.nan)
        if shape.is_found:
            steps = np.linalg.norm(np.diff(shape.contour, axis=0), axis=1)
            along = np.concatenate([[0.0], np.cumsum(steps)])
            places = np.linspace(0, along[-1], POINTS)
            points = np.stack([np.interp(places, along, line) for line in shape.contour.T], axis=1)
        return {"contour": Values(points.astype(np.float32), ("point", "row_column"))}


NAMES = ("decode", "refocus@10mm", "refocus@0.5", "emission", "height", "contour")
"""Names of steps, as examples."""


def find_steps(
    names: str,
    *,
    camera: Lens | None = None,
    depths_mm: tuple[float, ...] = (),
    block: int = 1,
    noise: float | None = None,
    strength: float | None = None,
    background: str | None = None,
    level: float = 0.5,
    pixel_mm: float | None = None,
    burner_row: float | None = None,
) -> tuple[Step, ...]:
    """Make steps of their names.

    Parameters
    ----------
    names : str
        Names with commas between them: ``decode`` (frames are decoded anyway; alone, it keeps the
        views), ``refocus@10mm`` (a depth) or ``refocus@0.5`` (a slope), ``emission``, ``height``
        and ``contour``. The last two measure the image of the last refocusing before them, or the
        central view.
    camera : Lens, optional
        Camera; needed for depths.
    depths_mm : tuple of float, optional
        Depths of the planes of ``emission``.
    block, noise, strength, background
        Options of ``emission``, see `Emission`.
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
            if pixel_mm is None and camera is not None:
                depth = focus.depth_mm
                side = None if depth is None else camera.field_mm(depth)[0] / camera.lenslets[0]
        elif word == "emission":
            if camera is None or not depths_mm:
                raise InputError("The step emission needs the camera, and depths of its planes.")
            steps.append(Emission(camera, tuple(depths_mm), block, noise, strength, background))
        elif word == "height":
            steps.append(Height(level, side, burner_row))
        elif word == "contour":
            steps.append(Contour(level, burner_row))
        else:
            raise InputError(f"Steps must be of {', '.join(NAMES)}, got {word!r}.")
    return tuple(steps)


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
