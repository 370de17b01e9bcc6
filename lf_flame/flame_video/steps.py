"""Steps of processing the frames of a video: functions of one frame, chosen by name.

Tomography is imported where it is used, as it doubles the time that other steps take to start.
"""

from collections.abc import Callable, Sequence
from contextvars import copy_context
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from lf_flame.errors import InputError
from lf_flame.flame_video.flame_shape import DOUBTS, measure_flame
from lf_flame.lightfield import AXES, LightField
from lf_flame.optics.lens import Lens
from lf_flame.refocus import farthest_slope, shift_and_sum
from lf_flame.refocus._arguments import refuse_excluded
from lf_flame.refocus.unknown_pixels import WARN


class Values(NamedTuple):
    """Array that a step gives for a frame, with the names of its axes and its attributes.

    An array with the name of its only axis is a coordinate, the same for all frames.
    """

    values: Any
    axes: tuple[str, ...] = ()
    attributes: dict[str, Any] = {}  # noqa: RUF012 - never changed


Step = Callable[["Frame"], dict[str, Values]]
"""Function of a frame: arrays by name, of the same axes and shapes for every frame. Its ``repr``
states all its options."""


@dataclass
class Frame:
    """A light field on its way through the steps.

    `before` is what steps keep of the frame before in the same task, `image` that in which the
    flame is measured: of the last refocusing, or None for the central view.
    """

    light_field: LightField
    before: dict[str, Any] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    image: np.ndarray | None = None

    def take(self, steps: Sequence[Step]) -> dict[str, Values]:
        """Take steps one after the other; return the arrays of all."""
        return {name: values for step in steps for name, values in step(self).items()}


@dataclass(frozen=True)
class Views:
    """Keep the decoded light field itself: ``views``, unknown pixels filled, and ``weights``."""

    def __call__(self, frame: Frame) -> dict[str, Values]:
        """Return the views and their weights, 1 where there are none."""
        views, weights = frame.light_field.filled, frame.light_field.weights
        weights = np.ones(views.shape[:2], np.float32) if weights is None else weights
        return {"views": Values(views, AXES[: views.ndim]), "weights": Values(weights, AXES[:2])}


@dataclass(frozen=True)
class Refocus:
    """Refocus at a slope, that of a depth if there is one; later steps measure this image."""

    slope: float
    depth_mm: float | None = None
    kept: bool = field(default=True, repr=False)  # whether the image itself is a result

    def __call__(self, frame: Frame) -> dict[str, Values]:
        """Return the refocused image, ``refocus_10mm`` or ``refocus_0.5``, in colour if it is."""
        light_field, slope, depth = frame.light_field, self.slope, self.depth_mm
        limit = farthest_slope(light_field)
        if not abs(slope) <= limit:
            raise InputError(
                f"The slope must lie from {-limit:g} to {limit:g}, beyond which views are shifted "
                f"by more than the image, got {slope:g}."
            )
        context = copy_context()
        context.run(WARN.set, frame.warnings.append)  # those of frames are counted
        image = frame.image = context.run(shift_and_sum, light_field, [slope])[0]
        if not self.kept:
            return {}
        # As many digits as a decimal number keeps: two slopes never share a name.
        name = f"refocus_{slope:.15g}" if depth is None else f"refocus_{depth:.15g}mm"
        known = {"slope": slope, "depth_mm": depth}
        return {name: Values(image, ("y", "x", "channel")[: image.ndim], known)}


@dataclass(frozen=True)
class Height:
    """Measure height, tip, width, area, brightness and contour, as `measure_flame` does."""

    level: float = 0.5
    pixel_mm: float | None = None
    burner_row: float | None = None

    def __call__(self, frame: Frame) -> dict[str, Values]:
        """Return the measures, NaN without a flame, and a bit for each doubt."""
        image = frame.image
        if image is None:
            v, u = ((count - 1) // 2 for count in frame.light_field.shape[:2])
            refuse_excluded(frame.light_field, [(v, u)], "The step height without refocusing")
            image = frame.light_field.filled[v, u]
        grey = image.mean(axis=2, dtype=float) if image.ndim == 3 else image
        side, unit = (1.0, "px") if self.pixel_mm is None else (self.pixel_mm, "mm")
        shape = measure_flame(grey, level=self.level, pixel_mm=side, burner_row=self.burner_row)
        masks = {name: 1 << k for k, name in enumerate(DOUBTS)}
        known = {"flag_masks": list(masks.values()), "flag_meanings": " ".join(masks)}
        options = {"units": unit, "level": self.level, "pixel_mm": self.pixel_mm}
        points = _even_points(shape.contour).astype(np.float32)
        return {
            "height": Values(np.float64(shape.height), (), options),
            "tip_row": Values(np.float64(shape.tip_row)),
            "width": Values(np.float64(shape.width), (), {"units": unit}),
            "area": Values(np.float64(shape.area), (), {"units": f"{unit}2"}),
            "brightness": Values(np.float64(shape.brightness)),
            "contour": Values(points, ("point", "row_column"), {"units": "px"}),
            "doubts": Values(np.uint8(sum(masks[name] for name in shape.doubts)), (), known),
        }


def _even_points(contour: np.ndarray) -> np.ndarray:
    """Take 256 points of a contour at equal distances along it; NaN if there is none."""
    if not len(contour):
        return np.full((256, 2), np.nan)
    along = np.append(0, np.cumsum(np.linalg.norm(np.diff(contour, axis=0), axis=1)))
    places = np.linspace(0, along[-1], 256)
    return np.stack([np.interp(places, along, line) for line in contour.T], axis=1)


@dataclass(frozen=True, eq=False)  # hashed as an object, as a camera may contain tables
class Emission:
    """Reconstruct the emission on depth planes, as `lf_flame.tomography.reconstruct` does.

    With a stated strength a fit starts from that of the frame before in the same task, which takes
    a third of the time. Without, frames are independent.
    """

    camera: Lens
    depths_mm: tuple[float, ...]
    block: int
    options: dict[str, Any]  # noise, strength and background of a `ReconstructionPlan`

    def __call__(self, frame: Frame) -> dict[str, Values]:
        """Return emission, noise of a pixel, and number of warnings."""
        plan, weights = _plan(self, frame.light_field.shape), frame.light_field.weights
        same = np.array_equal(np.asarray(weights), np.asarray(frame.before.get("weights")))
        start = frame.before.get("emission") if same else None
        found = plan.reconstruct(frame.light_field, start=start)
        if self.options["strength"] is not None:
            frame.before |= {"emission": found, "weights": weights}
        frame.warnings += found.warnings
        axes = ("depth", "y", "x") if self.block == 1 else ("depth", "y_block", "x_block")
        return {
            "depth": Values(np.array(self.depths_mm), ("depth",), {"units": "mm"}),
            "emission": Values(found.emission, axes),
            "emission_noise": Values(np.float32(found.noise)),
            "emission_warnings": Values(np.uint8(len(found.warnings))),
        }


@lru_cache(maxsize=2)
def _plan(step: Emission, shape: tuple[int, ...]):
    """Plan for light fields of a shape, once in each process, because plans are large."""
    from lf_flame.tomography import FrustumGrid, ReconstructionPlan

    grid = FrustumGrid(step.camera.for_light_field(shape), step.depths_mm, step.block)
    return ReconstructionPlan(grid, **step.options)


def find_steps(
    names: str,
    *,
    camera: Lens | None = None,
    depths_mm: tuple[float, ...] = (),
    block: int = 1,
    noise: float | None = None,
    strength: float | None = None,
    background: str = "fit",
    level: float = 0.5,
    pixel_mm: float | None = None,
    burner_row: float | None = None,
) -> tuple[Step, ...]:
    """Make steps from their names.

    Parameters
    ----------
    names : str
        Names with commas between them: ``decode`` (frames are decoded anyway; alone, it keeps the
        views), ``refocus@10mm`` (a depth) or ``refocus@0.5`` (a slope), ``emission``, and
        ``height`` (with contour, width, area and brightness), of the image of the last refocusing
        before it, or the central view.
    camera : Lens, optional
        Camera; needed for depths.
    depths_mm : tuple of float, optional
        Depths of the planes of ``emission``.
    block, noise, strength, background
        Options of ``emission``, as for `FrustumGrid` and `reconstruct`.
    level, pixel_mm, burner_row
        Options of ``height``, as for `measure_flame`. Default of `pixel_mm`: by the
        camera at the depth of the refocusing before it; without one, lengths are in pixels.

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
    if len(set(words)) < len(words) or "decode" in words[1:]:
        raise InputError(f"Each step may be named once, and decode only first, got {names!r}.")
    steps, side = list[Step](), pixel_mm
    for word in words:
        if word == "decode":
            steps += [Views()] if len(words) == 1 else []
        elif word.startswith("refocus@"):
            focus = find_focus(word.removeprefix("refocus@"), camera)
            steps.append(focus)
            side = pixel_mm
            if pixel_mm is None and camera is not None and focus.depth_mm is not None:
                side = camera.field_mm(focus.depth_mm)[0] / camera.lenslets[0]
        elif word == "emission":
            if camera is None or not depths_mm:
                raise InputError("The step emission needs the camera, and depths of its planes.")
            options = {"noise": noise, "strength": strength, "background": background}
            steps.append(Emission(camera, tuple(map(float, depths_mm)), block, options))
        elif word == "height":
            steps.append(Height(level, side, burner_row))
        else:
            raise InputError(
                f"Steps must be among decode, refocus@10mm, refocus@0.5, emission, height, got "
                f"{word!r}."
            )
    return tuple(steps)


def find_focus(place: str, camera: Lens | None) -> Refocus:
    """Make a refocusing at a depth as ``10mm``, which needs the camera, or a slope as ``0.5``."""
    try:
        number = float(place.removesuffix("mm"))
    except ValueError:
        raise InputError(
            f"A refocusing must be at a depth, such as refocus@10mm, or a slope, such as "
            f"refocus@0.5, got {place!r}."
        ) from None
    if not place.endswith("mm"):
        return Refocus(number)
    if camera is None:
        raise InputError(f"refocus@{place} needs the camera; or give a slope, such as refocus@0.5.")
    camera.check_depths(number)
    return Refocus(float(camera.depth_to_slope(number)), number)
