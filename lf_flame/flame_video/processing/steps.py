"""Steps of processing: functions of one frame."""

import zlib
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np

from lf_flame.errors import InputError
from lf_flame.flame_video.flame_series import Measures
from lf_flame.flame_video.flame_shape import (
    APART,
    BRIGHT_DARK,
    CEILING,
    CUT,
    DARK,
    SPARK,
    SPECK,
    FlameShape,
    check_measures,
    measure_flame,
)
from lf_flame.lightfield import AXES, LightField
from lf_flame.refocus import farthest_slope, shift_and_sum

if TYPE_CHECKING:
    from lf_flame.tomography import Emission as Reconstruction

DOUBTS = {"dark": DARK, "speck": SPECK, "cut": CUT, "ceiling": CEILING, "apart": APART,
          "spark": SPARK, "bright_dark": BRIGHT_DARK}  # fmt: skip
"""Sentences on a flame's shape by the names of their bits in the array ``doubts``."""

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
    emissions : tuple of Reconstruction
        Emission of this frame in each colour, once it is found; empty before.
    """

    light_field: LightField
    image: np.ndarray = field(init=False)
    warnings: list[str] = field(default_factory=list)
    before: dict[str, Any] = field(default_factory=dict)
    emissions: tuple["Reconstruction", ...] = ()

    def __post_init__(self):
        self.image = Measures().image(self.light_field)
        self._shapes: dict[tuple, FlameShape] = {}

    def shape(self, level: float, burner_row: float | None = None) -> FlameShape:
        """Measure the flame in pixels, once for each image and options."""
        key = (id(self.image), level, burner_row)
        if key not in self._shapes:
            self._shapes[key] = measure_flame(self.image, level=level, burner_row=burner_row)
        return self._shapes[key]


def fingerprint(image: np.ndarray) -> dict[str, Values]:
    """Give a checksum of a picture, by which frames that repeat the one before are found.

    It is NaN for a picture of one value: dark frames that are clipped at 0 are alike, too.
    """
    checksum = zlib.crc32(image.tobytes()) if np.ptp(image) else np.nan
    return {"fingerprint": Values(np.float64(checksum))}


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
