"""The part of a layer that a sensor pixel sees: its ray bundle, traced backward.

In one dimension a pixel collects all rays that cross its lenslet at ``h + delta`` and reach the
sensor within the pixel's width. On a layer they cover the segment
``centre + lenslet_width * a + pixel_width * b`` with a and b uniform in [-1/2, 1/2]: a trapezoid.
Both axes have this form; with square lenslets and square pixels they are independent.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from lf_flame._common.arrays import centred
from lf_flame.optics import ray_transfer
from lf_flame.optics.camera import ROW_SPACING, PlenopticCamera


@dataclass(frozen=True)
class Footprint:
    """Ray bundles of all pixels along one axis, on one layer; widths are signed."""

    centres_mm: np.ndarray  # (views, lenslets): central ray of each, from the axis, upright
    lenslet_width_mm: float  # width of the lenslet's image on the layer
    pixel_width_mm: float
    shift_per_lenslet_shift: float  # shift on the layer if a lenslet moves and its pixel does not

    @property
    def half_width_mm(self) -> float:
        """Half of the bundle's full width on the layer, in mm."""
        return (abs(self.lenslet_width_mm) + abs(self.pixel_width_mm)) / 2


@dataclass(frozen=True)
class ArrayPart:
    """Equal boxes at equal distances, along y and x: a part of each lenslet of every other row."""

    first_mm: tuple[float, float]  # centre of the first lenslet
    spacing_mm: tuple[float, float]
    size_mm: tuple[float, float]
    aside_mm: tuple[float, float]  # place of a box from the centre of its lenslet


def lenslet_places_mm(
    camera: PlenopticCamera, axis: int, part: ArrayPart | None = None
) -> np.ndarray:
    """Nominal centres of the lenslets along an axis, in mm, shape (lenslets,)."""
    count = camera.lenslets[axis]
    if part is None:
        return centred(count) * camera.grid_pitch_mm
    return part.first_mm[axis] + np.arange(count) * part.spacing_mm[axis]


@lru_cache(maxsize=32)  # the scenes of a data set use the same depths
def trace_footprint(
    camera: PlenopticCamera,
    depth_mm: float,
    axis: int,
    focal_mm: float | None = None,
    lenslet_scale: float = 1.0,
    neighbour: int = 0,
    part: ArrayPart | None = None,
) -> Footprint:
    """Trace the ray bundles of all pixels along one axis (0: v, t; 1: u, s) back to a layer.

    focal_mm: focal length of the main lens for light of another colour. lenslet_scale: true lenslet
    pitch over the nominal one, with which the sensor is read. neighbour: number of lenslets by
    which the light's lenslet is displaced from the pixel's own. part: part of a hexagonal array.
    """
    to_array = camera.object_to_array(depth_mm, focal_mm)
    return _trace(camera, to_array, axis, lenslet_scale, neighbour, part)


def trace_stop(
    camera: PlenopticCamera,
    distance_mm: float,
    axis: int,
    focal_mm: float | None = None,
    lenslet_scale: float = 1.0,
    neighbour: int = 0,
    part: ArrayPart | None = None,
) -> Footprint:
    """Trace the ray bundles to a stop at a distance in front of the main lens; 0 is the lens."""
    to_array = camera.plane_to_array(distance_mm, focal_mm)
    return _trace(camera, to_array, axis, lenslet_scale, neighbour, part)


def _trace(camera, to_array, axis: int, lenslet_scale: float, neighbour: int, part) -> Footprint:
    """Compose the affine maps of the bundles.

    With ``q`` the sensor position relative to the lenslet's axis and S the lenslet-to-sensor
    matrix, the ray's angle is ``(q - S00 * delta) / S01``; the inverse of the object-to-array
    matrix maps height and angle to the layer. Micro-images are centred on the chief ray.
    """
    back = ray_transfer.inverse(to_array)
    (s_height, s_angle), _ = camera.lenslet_to_sensor()
    nominal = lenslet_places_mm(camera, axis, part)
    chief = nominal * camera.lenslet_focal_mm / camera.exit_distance_mm
    # True place of the lenslet, as a difference from nominal: 0 stays 0 without rounding.
    moved = (nominal * (lenslet_scale - 1)) + neighbour * lenslet_scale * camera.lenslet_pitch_mm
    pixel = (chief - moved)[None, :] + centred(camera.views)[:, None] * camera.pixel_mm
    # The sensor is turned by 180 degrees: images are upright.
    centres = -(back[0, 0] * (nominal + moved)[None, :] + back[0, 1] * pixel / s_angle)
    per_place = back[0, 0] - back[0, 1] * s_height / s_angle
    lenslet_mm = camera.lenslet_pitch_mm * lenslet_scale
    if part is not None:
        lenslet_mm = part.size_mm[axis]
        centres -= per_place * part.aside_mm[axis]
    elif axis == 0:
        lenslet_mm *= ROW_SPACING[camera.layout]
    centres.flags.writeable = False  # the cache shares it
    return Footprint(
        centres_mm=centres,
        lenslet_width_mm=per_place * lenslet_mm,
        pixel_width_mm=back[0, 1] / s_angle * camera.pixel_mm,
        shift_per_lenslet_shift=-(back[0, 0] - back[0, 1] / s_angle),
    )
