"""What is to be refocused, and how: checked before any work is done."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from lf_flame.errors import InputError
from lf_flame.formats.images import to_levels, white_level
from lf_flame.lightfield import LightField
from lf_flame.optics.camera import PlenopticCamera
from lf_flame.refocus import aperture_weights, f_number_aperture, farthest_slope, refocus


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
    camera : PlenopticCamera, optional
        Gives the depths, in mm, of slopes in file names, figures and the record.
    gain, gamma : float
        Of the pictures to look at, see `preview`; from 1e-6 to 1e6, and from 0.01 to 100.
    """

    light_field: LightField
    options: dict[str, Any] = field(default_factory=dict)
    network: Any = None
    camera: PlenopticCamera | None = None
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
        """Light field from 0 to 1, as networks take it."""
        if self.white == 1:
            return self.light_field
        return replace(self.light_field, views=self.light_field.views / np.float32(self.white))

    def preview(self, image: np.ndarray) -> np.ndarray:
        """Levels of 8 bits to look at: ``(gain image / white) ** (1 / gamma)``, white at most."""
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


@dataclass(frozen=True)
class Aperture:
    """An aperture as a user states it; nothing stated: all views alike.

    Attributes
    ----------
    width : float, optional
        In widths of the full aperture. Default: the full one, or of a ring 1.
    ring : float, optional
        Width of the middle that is covered.
    square : bool
        Square, and not round.
    viewpoint : (float, float), optional
        Where its centre is, in views from the middle one.
    f_number : float, optional
        In place of a width; needs the camera.
    """

    width: float | None = None
    ring: float | None = None
    square: bool = False
    viewpoint: tuple[float, float] | None = None
    f_number: float | None = None

    def weights(
        self, views: tuple[int, int], camera: PlenopticCamera | None = None
    ) -> np.ndarray | None:
        """Give the weights of the views, shape (v, u), or None for all views alike."""
        if self.f_number is not None:
            return f_number_aperture(self._camera_of(views, camera), self.f_number)
        if self == Aperture():
            return None
        return aperture_weights(
            views,
            1.0 if self.width is None else self.width,
            self.ring or 0.0,
            "square" if self.square else "round",
            self.viewpoint or (0.0, 0.0),
        )

    def _camera_of(self, views: tuple[int, int], camera: PlenopticCamera | None) -> PlenopticCamera:
        """Give the camera that an f-number is of."""
        if self != Aperture(f_number=self.f_number):
            raise InputError("An f-number and another aperture cannot both be given.")
        if camera is None:
            raise InputError(f"An f-number needs the camera, got f_number={self.f_number} alone.")
        camera.check_views(views)
        return camera
