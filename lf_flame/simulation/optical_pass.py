"""A pass of light through the camera: the effects that are kept, one colour, one lenslet."""

import math
from dataclasses import dataclass, field

import numpy as np

from lf_flame._common.arrays import centred
from lf_flame.optics.camera import PlenopticCamera
from lf_flame.optics.ray_bundle import Footprint, trace_footprint, trace_stop
from lf_flame.simulation.layouts import arrange
from lf_flame.simulation.ray_tables import FalloffSkew, FalloffTable


@dataclass(frozen=True)
class OpticalPass:
    """A camera as the kept effects leave it, for one colour and one neighbouring lenslet.

    Parameters
    ----------
    camera : PlenopticCamera
    focal_mm : float, optional
        Focal length of the main lens for the colour of this pass.
    share : float, optional
        Share of the light in this pass.
    defocus : bool, optional
        Whether a pixel's own width, hence a patch of the main lens, is integrated over.
    falloff : bool, optional
        Whether pixels dim by cos^4.
    lenslet_scale, lenslet_skew : float, optional
        Diagonal and other element of the lenslet grid's rotation and stretch.
    stops : tuple of (float, float), optional
        Distance in front of the main lens and radius of round stops, in mm.
    neighbour : (int, int), optional
        Light that comes through the lenslet this many rows and columns further on.
    square_micro_images : bool, optional
        Whether a pixel gets light of a lenslet only where it lies in the lenslet's micro-image,
        the square about the point on the sensor that the lenslet images the middle of the main
        lens on. These squares tile the sensor: an ideal square aperture, for an array that does
        not stand as the sensor is read. Where it does, pixels lie in their own micro-images.
    """

    camera: PlenopticCamera
    focal_mm: float | None = None
    share: float = 1.0
    defocus: bool = True
    falloff: bool = False
    lenslet_scale: float = 1.0
    lenslet_skew: float = 0.0
    stops: tuple[tuple[float, float], ...] = ()
    neighbour: tuple[int, int] = field(default=(0, 0))
    square_micro_images: bool = False

    def footprint(self, depth_mm: float, axis: int) -> Footprint:
        """Bundles of all pixels on a layer."""
        return trace_footprint(self.camera, depth_mm, axis, *self._grid(axis))

    def stop(self, distance_mm: float, axis: int) -> Footprint:
        """Bundles of all pixels on a stop."""
        return trace_stop(self.camera, distance_mm, axis, *self._grid(axis))

    def _grid(self, axis: int) -> tuple:
        return self.focal_mm, self.lenslet_scale, self.neighbour[axis]

    def skew_mm(self, axis: int) -> np.ndarray:
        """How far the rotated array moves each lenslet along `axis`, by its place on the other."""
        other = 1 - axis
        place = centred(self.camera.lenslets[other]) + self.neighbour[other]
        sign = 1 if axis == 0 else -1
        return sign * self.lenslet_skew * self.camera.lenslet_pitch_mm * place

    @property
    def lenslet_pitch_mm(self) -> float:
        """True pitch of the lenslets."""
        return self.camera.lenslet_pitch_mm * math.hypot(self.lenslet_scale, self.lenslet_skew)

    @property
    def lenslet_tangent(self) -> float:
        """Tangent of the angle by which the array is turned."""
        return self.lenslet_skew / self.lenslet_scale

    @property
    def micro_image_mm(self) -> float:
        """Side of a square micro-image: the true lenslet pitch, seen from the main lens."""
        camera = self.camera
        return self.lenslet_pitch_mm * (1 + camera.lenslet_focal_mm / camera.image_distance_mm)

    @property
    def micro_image_reach_mm(self) -> float:
        """Distance along each axis from a micro-image's middle beyond which no pixel gets light.

        Infinite where neither squares nor a round aperture end the micro-images.
        """
        camera, corner = self.camera, 1 + abs(self.lenslet_tangent)  # of a square that is turned
        radii = [radius for distance, radius in self.stops if distance == 0]
        if self.square_micro_images:
            half = self.micro_image_mm / 2 * corner
        elif radii:
            widest = min(radii) + self.lenslet_pitch_mm / 2 * corner
            half = widest * camera.lenslet_focal_mm / camera.image_distance_mm
        else:
            return math.inf
        return half + camera.pixel_mm / 2

    @property
    def displaced(self) -> bool:
        """Whether the pass's lenslets stand elsewhere than the sensor is read by."""
        return bool(self.lenslet_skew) or self.lenslet_scale != 1 or any(self.neighbour)

    def lit_neighbours(self) -> list[tuple[int, int]]:
        """Lenslets through which light reaches some pixel: rows and columns from its own."""
        camera = self.camera
        reach = self.micro_image_reach_mm + (camera.views - 1) / 2 * camera.pixel_mm
        if not math.isfinite(reach):
            return [(0, 0)]
        moved = []
        for axis in (0, 1):
            own = -self.offsets_mm(axis).mean(axis=0)
            skew = -self.offset_skew_mm(axis)
            moved.append(np.add.outer(own, skew) if axis == 0 else np.add.outer(skew, own))
        pitch, turned = self.micro_image_mm, math.atan(self.lenslet_tangent)
        down, right = pitch * math.cos(turned), pitch * math.sin(turned)
        farthest = max(np.abs(part).max() for part in moved) * math.sqrt(2) + reach
        steps = range(-math.ceil(farthest / down), math.ceil(farthest / down) + 1)
        closest = reach - 1e-9 * pitch  # squares that only touch do not meet
        return [
            (row, column)
            for row in steps
            for column in steps
            if np.any(
                (np.abs(moved[0] + row * down + column * right) < closest)
                & (np.abs(moved[1] + column * down - row * right) < closest)
            )
        ]

    def offsets_mm(self, axis: int) -> np.ndarray:
        """Pixel centres from the middles of the lenslet's micro-images, shape (view, lenslet).

        Along one axis, as if the array were not turned; `offset_skew_mm` is the rest.
        """
        camera = self.camera
        chief = camera.lenslet_focal_mm / camera.image_distance_mm
        nominal = centred(camera.lenslets[axis]) * camera.lenslet_pitch_mm
        further = self.neighbour[axis] * self.lenslet_scale * camera.lenslet_pitch_mm
        moved = nominal * (self.lenslet_scale - 1) + further
        return centred(camera.views)[:, None] * camera.pixel_mm - moved * (1 + chief)

    def offset_skew_mm(self, axis: int) -> np.ndarray:
        """Add this to `offsets_mm` for a turned array, by the lenslet's place on the other axis."""
        camera = self.camera
        return -self.skew_mm(axis) * (1 + camera.lenslet_focal_mm / camera.image_distance_mm)

    def lit_parts(self, axis: int) -> tuple[np.ndarray, np.ndarray]:
        """Part of each pixel that lies in the lenslet's micro-image, where that is a square.

        Returns
        -------
        middle_mm : ndarray of float64, shape (view, lenslet)
            Middle of the part, from the pixel's own.
        share : ndarray of float64, shape (view, lenslet)
            Width of the part over the pixel's, 0 to 1.
        """
        offsets, pixel, half = self.offsets_mm(axis), self.camera.pixel_mm, self.micro_image_mm / 2
        low = np.clip(-half - offsets, -pixel / 2, pixel / 2)
        high = np.clip(half - offsets, -pixel / 2, pixel / 2)
        return (low + high) / 2, (high - low) / pixel

    def tangents(self, axis: int) -> np.ndarray:
        """Tangent of each pixel's central ray behind the main lens, shape (view, lenslet).

        Of the ray through the lenslet's middle: the pixel's place from the lenslet's axis over
        the lenslet's focal length, as if the array were not turned.
        """
        camera = self.camera
        nominal = centred(camera.lenslets[axis]) * camera.lenslet_pitch_mm
        further = self.neighbour[axis] * self.lenslet_scale * camera.lenslet_pitch_mm
        towards_lenslet = (nominal * self.lenslet_scale + further) / camera.image_distance_mm
        offsets = self.offsets_mm(axis)
        if self.square_micro_images and not self.lenslet_skew:
            offsets = offsets + self.lit_parts(axis)[0]
        return towards_lenslet + offsets / camera.lenslet_focal_mm

    def falloff_table(self, layout: str) -> FalloffTable | None:
        """Tangents in the order of an image, or None without cos^4.

        The patch of the main lens that a pixel sees is `view_step_mm` wide along both axes, and
        the mean of the squared tangents over it is that of its middle and a twelfth of its squared
        width for each axis.
        """
        if not self.falloff:
            return None
        tangents = [arrange(self.tangents(axis), layout) for axis in (0, 1)]
        if self.lenslet_skew:
            return FalloffTable(*tangents)
        return FalloffTable(tangents[0] ** 2 + self._patch, tangents[1] ** 2)

    def falloff_skew(self, layout: str) -> FalloffSkew | None:
        """Add to the tangents what a turned array does; None without cos^4 or skew."""
        if not (self.falloff and self.lenslet_skew):
            return None
        views, focal_mm = self.camera.views, self.camera.lenslet_focal_mm
        skew = [
            arrange(np.tile(-self.skew_mm(axis) / focal_mm, (views, 1)), layout) for axis in (0, 1)
        ]
        return FalloffSkew(skew[0], skew[1], self._patch)

    @property
    def _patch(self) -> float:
        """Mean of the squared tangents over a pixel's patch of the main lens, from its middle."""
        return 2 * (self.camera.pixel_mm / self.camera.lenslet_focal_mm) ** 2 / 12
