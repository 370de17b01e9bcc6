"""What is to be refocused, and how: checked before any work is done."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from lf_flame.errors import InputError
from lf_flame.formats.images import white_level
from lf_flame.lightfield import LightField
from lf_flame.optics.camera import PlenopticCamera
from lf_flame.refocus import (
    annular_aperture,
    f_number_aperture,
    farthest_slope,
    refocus,
    round_aperture,
)


@dataclass(frozen=True, eq=False)
class RefocusJob:
    """A light field, and how its refocused images are made.

    Attributes
    ----------
    light_field : LightField
    options : dict
        `interpolation`, `method` and `weights` of `lf_flame.refocus.refocus`.
    network : optional
        A system of `lf_flame.systems` that refocuses instead, from values from 0 to 1.
    """

    light_field: LightField
    options: dict[str, Any] = field(default_factory=dict)
    network: Any = None

    @cached_property
    def white(self) -> float:
        """Radiance shown as white."""
        return white_level(self.light_field.views)

    @property
    def views_to_white(self) -> np.ndarray:
        """Views from 0 to 1, as networks take them."""
        views = self.light_field.views
        return views if self.white == 1 else views / np.float32(self.white)

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
    """Refuse what cannot be done.

    Parameters
    ----------
    job : RefocusJob
    slopes, sweep, slope_map : sequence of float
        To refocus at, and first and last of a sweep and of a slope map; none: not asked for.

    Raises
    ------
    InputError
        If a slope shifts views by more than the image, a sweep or a slope map has no length, or the
        network cannot take the light field or a slope.
    """
    limit = farthest_slope(job.light_field.views)
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
        job.network.check(job.light_field.views, [*slopes, *sweep])


def aperture_weights(
    views: tuple[int, int],
    diameter: float | None = None,
    ring: float | None = None,
    f_number: float | None = None,
    camera: PlenopticCamera | None = None,
) -> np.ndarray | None:
    """Weights of the views for an aperture as a user states it.

    Parameters
    ----------
    views : (int, int)
    diameter : float, optional
        Of a round aperture, in widths of the full one. Default: the full one, or of a ring 1.
    ring : float, optional
        Diameter of the middle that is covered.
    f_number : float, optional
        In place of a diameter; needs the camera.
    camera : PlenopticCamera, optional

    Returns
    -------
    ndarray, shape (v, u), or None for all views alike
    """
    if f_number is not None:
        if diameter is not None or ring is not None:
            raise InputError("An f-number and a diameter of the aperture cannot both be given.")
        if camera is None:
            raise InputError(f"An f-number needs the camera, got f_number={f_number} alone.")
        if views != (camera.views, camera.views):
            raise InputError(
                f"The camera has {camera.views} x {camera.views} views, "
                f"but the light field {views[0]} x {views[1]}."
            )
        return f_number_aperture(camera, f_number)
    if ring is not None:
        return annular_aperture(views, ring, 1.0 if diameter is None else diameter)
    return None if diameter is None else round_aperture(views, diameter)
