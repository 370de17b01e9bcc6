"""Light field and options of a refocusing, checked before any work is done."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from lf_flame.calibration.camera_law import CameraLaw
from lf_flame.errors import InputError
from lf_flame.formats.images import to_levels, white_level
from lf_flame.lightfield import LightField
from lf_flame.optics.camera import PlenopticCamera
from lf_flame.refocus import farthest_slope, refocus


@dataclass(frozen=True, eq=False)
class RefocusJob:
    """A light field, and the options of its refocused images.

    Attributes
    ----------
    light_field : LightField
    options : dict
        `interpolation`, `method` and `weights` of `lf_flame.refocus.refocus`.
    network : optional
        System of `lf_flame.systems` that refocuses instead, from values from 0 to 1.
    camera : PlenopticCamera or CameraLaw, optional
        Camera, which gives the depths, in mm, of slopes in file names, figures and the record.
    gain, gamma : float
        Gain (1e-6 to 1e6) and gamma (0.01 to 100) of the pictures for display, see `preview`.
    """

    light_field: LightField
    options: dict[str, Any] = field(default_factory=dict)
    network: Any = None
    camera: PlenopticCamera | CameraLaw | None = None
    gain: float = 1.0
    gamma: float = 1.0

    def __post_init__(self):
        for name, low, high in (("gain", 1e-6, 1e6), ("gamma", 0.01, 100)):
            if not low <= (got := getattr(self, name)) <= high:
                raise InputError(f"{name} must be from {low:g} to {high:g}, got {got:g}.")

    @cached_property
    def white(self) -> float:
        """Radiance shown as white."""
        return white_level(self.light_field.views)

    @property
    def views_to_white(self) -> LightField:
        """Light field with values from 0 to 1, as input of networks."""
        if self.white == 1:
            return self.light_field
        return replace(self.light_field, views=self.light_field.views / np.float32(self.white))

    def preview(self, image: np.ndarray) -> np.ndarray:
        """Give 8-bit levels for display, ``(gain image / white) ** (1 / gamma)``, clipped."""
        shown = np.clip(image / np.float32(self.white / self.gain), 0, 1)
        return to_levels(shown if self.gamma == 1 else shown ** np.float32(1 / self.gamma), 8)

    def refocus(self, slopes: Sequence[float]) -> np.ndarray:
        """Refocus at some slopes: float32, shape (n, t, s) or with a last axis of channels."""
        if self.network is None:
            return refocus(self.light_field, slopes, **self.options)
        return self.white * self.network.refocus(self.views_to_white, slopes)


def check_job(
    job: RefocusJob,
    slopes: Sequence[float],
    sweep: Sequence[float] = (),
    slope_map: Sequence[float] = (),
) -> None:
    """Refuse options that cannot be carried out.

    Parameters
    ----------
    job : RefocusJob
    slopes, sweep, slope_map : sequence of float
        Slopes to refocus at, and first and last slope of a sweep and of a slope map; empty: none.

    Raises
    ------
    InputError
        If a slope shifts views by more than the image, a sweep or a slope map has no length, or the
        network cannot take the light field or a slope.
    """
    limit = farthest_slope(job.light_field)
    wrong = [slope for slope in (*slopes, *sweep, *slope_map) if not abs(slope) <= limit]
    if wrong:
        raise InputError(
            f"Slopes must be finite and from {-limit:g} to {limit:g}, beyond which views are "
            f"shifted by more than the image, got {wrong[0]:g}."
        )
    if sweep and sweep[0] == sweep[1]:
        raise InputError(f"A sweep needs two slopes, got {sweep[0]} twice.")
    if slope_map and not slope_map[0] < slope_map[1]:
        raise InputError(
            f"A slope map needs the lower slope first, got {slope_map[0]} and {slope_map[1]}."
        )
    if job.network is not None:
        job.network.check(job.light_field, [*slopes, *sweep])
