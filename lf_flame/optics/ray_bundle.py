"""Ray transfer matrices, and the bundles of rays that they trace from sensor pixels to a layer.

A ray is the column vector ``(y, theta)``: height in mm and angle in rad at a plane. A matrix, 2 x 2
in float64, maps the ray at one plane to the ray at a later plane; all have determinant 1.

In one dimension a pixel collects all rays that cross its lenslet at ``h + delta`` and reach the
sensor within the pixel's width. On a layer they cover the segment
``centre + lenslet_width * a + pixel_width * b`` with a and b uniform in [-1/2, 1/2]: a trapezoid.
Both axes have this form; with square lenslets and square pixels they are independent.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from lf_flame.errors import InputError
from lf_flame.optics.camera import ROW_SPACING, PlenopticCamera


def free_space(distance_mm: float) -> np.ndarray:
    """Propagation over a distance along the axis: ``[[1, d], [0, 1]]`` (paper, equation 4).

    A negative distance leads back to a virtual plane.

    Examples
    --------
    >>> from lf_flame.optics import free_space
    >>> free_space(2.0).tolist()
    [[1.0, 2.0], [0.0, 1.0]]
    """
    return np.array([[1.0, distance_mm], [0.0, 1.0]])


def thin_lens(focal_mm: float) -> np.ndarray:
    """Thin lens: ``[[1, 0], [-1/f, 1]]`` (paper, equation 5); f > 0 converges, infinity is none.

    Examples
    --------
    >>> from lf_flame.optics import thin_lens
    >>> thin_lens(2.0).tolist()
    [[1.0, 0.0], [-0.5, 1.0]]
    """
    return np.array([[1.0, 0.0], [-1.0 / focal_mm, 1.0]])


def chain(*elements: np.ndarray) -> np.ndarray:
    """Matrix of several elements, given in the order in which light passes them.

    Examples
    --------
    >>> from lf_flame.optics import chain, free_space, thin_lens
    >>> system = chain(free_space(4.0), thin_lens(2.0), free_space(4.0))
    >>> float(system[0, 1])  # object and image stand at twice the focal length
    0.0
    """
    system = np.eye(2)
    for element in elements:
        system = element @ system
    return system


def inverse(system: np.ndarray) -> np.ndarray:
    """Inverse ``[[D, -B], [-C, A]]`` of ``[[A, B], [C, D]]``: from the ray behind to that before.

    It is not the matrix of the reversed system, ``[[D, B], [C, A]]``, where angles change their
    sign. It is exact for determinant 1. Nothing is divided, so it holds for imaging (B = 0), afocal
    (C = 0) and telecentric (A or D = 0) systems.

    Examples
    --------
    >>> from lf_flame.optics import free_space, inverse
    >>> inverse(free_space(2.0)).tolist()
    [[1.0, -2.0], [-0.0, 1.0]]
    """
    (a, b), (c, d) = system
    return np.array([[d, -b], [-c, a]])


def object_to_array(
    camera: PlenopticCamera, depth_mm: float, focal_mm: float | None = None
) -> np.ndarray:
    """Ray transfer matrix from a depth to the focal plane, which is imaged on the microlens array.

    focal_mm: focal length of the main lens for light of another colour; the array stays.

    The product free space, lens, free space is equal, but there the element B of a layer near the
    focal plane would be a rounded difference of long distances.
    """
    f, a0, i0 = camera.main_lens_focal_mm, camera.focus_distance_mm, camera.image_distance_mm
    imaging = np.array([[-i0 / a0, 0.0], [-1 / f, -a0 / i0]])
    if focal_mm is not None and focal_mm != f:
        weak_lens = np.array([[i0, i0 * a0], [1.0, a0]])  # free space, power 1, free space
        imaging = imaging - (1 / focal_mm - 1 / f) * weak_lens
    return chain(free_space(depth_mm), imaging)


@dataclass(frozen=True)
class Footprint:
    """Ray bundles of all pixels along one axis, on one layer; widths are signed."""

    centres_mm: np.ndarray  # (views, lenslets): central ray of each, from the axis, upright
    lenslet_width_mm: float  # width of the lenslet's image on the layer
    pixel_width_mm: float
    shift_per_lenslet_shift: float  # shift on the layer if a lenslet moves and its pixel does not
    half_width_mm: float  # half of a bundle's full width


@dataclass(frozen=True)
class ArrayPart:
    """Equal boxes at equal distances, along y and x: a part of each lenslet of every other row."""

    first_mm: tuple[float, float]  # centre of the first lenslet
    spacing_mm: tuple[float, float]
    size_mm: tuple[float, float]
    aside_mm: tuple[float, float]  # position of a box from the centre of its lenslet


def lenslet_places_mm(
    camera: PlenopticCamera, axis: int, part: ArrayPart | None = None
) -> np.ndarray:
    """Nominal centres of the lenslets along an axis, in mm, shape (lenslets,)."""
    count = camera.lenslets[axis]
    if part is None:
        pitch_mm = camera.lenslet_pitch_mm * ROW_SPACING[camera.layout]
        return (np.arange(count) - (count - 1) / 2) * pitch_mm
    return part.first_mm[axis] + np.arange(count) * part.spacing_mm[axis]


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
    if not camera.focus_distance_mm + depth_mm > 0:
        raise InputError(
            f"A layer must be in front of the main lens, at a depth above "
            f"{-camera.focus_distance_mm} mm, got {depth_mm} mm."
        )
    return _trace(camera, depth_mm, axis, focal_mm, lenslet_scale, neighbour, part)


def trace_stop(camera: PlenopticCamera, distance_mm: float, axis: int, *grid: Any) -> Footprint:
    """Trace the ray bundles to a stop at a distance in front of the main lens; 0 is the lens.

    grid: further arguments of `trace_footprint`.
    """
    return _trace(camera, distance_mm - camera.focus_distance_mm, axis, *grid)


@lru_cache(maxsize=256)  # the scenes of a data set use the same depths, all planes the same stops
def _trace(
    camera, depth_mm, axis: int, focal_mm=None, lenslet_scale=1.0, neighbour=0, part=None
) -> Footprint:
    """Compose the affine maps of the bundles.

    With ``q`` the sensor position relative to the lenslet's axis and S the lenslet-to-sensor
    matrix, the ray's angle is ``(q - S00 * delta) / S01``; the inverse of the object-to-array
    matrix maps height and angle to the layer. Micro-images are centred on the chief ray.
    """
    back = inverse(object_to_array(camera, depth_mm, focal_mm))
    focal = camera.lenslet_focal_mm
    # [[0, f], [-1/f, 1]]: a pixel collects a range of angles, over the whole lenslet.
    (s_height, s_angle), _ = chain(thin_lens(focal), free_space(focal))
    nominal = lenslet_places_mm(camera, axis, part)
    chief = nominal * camera.lenslet_focal_mm / camera.exit_distance_mm
    # True position of the lenslet, as a difference from nominal: 0 stays 0 without rounding.
    moved = (nominal * (lenslet_scale - 1)) + neighbour * lenslet_scale * camera.lenslet_pitch_mm
    views = np.arange(camera.views) - (camera.views - 1) / 2
    pixel = (chief - moved)[None, :] + views[:, None] * camera.pixel_mm
    # The sensor is rotated by 180 degrees: images are upright.
    centres = -(back[0, 0] * (nominal + moved)[None, :] + back[0, 1] * pixel / s_angle)
    per_place = back[0, 0] - back[0, 1] * s_height / s_angle
    lenslet_mm = camera.lenslet_pitch_mm * lenslet_scale
    if part is not None:
        lenslet_mm = part.size_mm[axis]
        centres -= per_place * part.aside_mm[axis]
    elif axis == 0:
        lenslet_mm *= ROW_SPACING[camera.layout]
    centres.flags.writeable = False  # the cache shares it
    lenslet, pixel_mm = per_place * lenslet_mm, back[0, 1] / s_angle * camera.pixel_mm
    return Footprint(
        centres_mm=centres,
        lenslet_width_mm=lenslet,
        pixel_width_mm=pixel_mm,
        shift_per_lenslet_shift=-(back[0, 0] - back[0, 1] / s_angle),
        half_width_mm=(abs(lenslet) + abs(pixel_mm)) / 2,
    )
