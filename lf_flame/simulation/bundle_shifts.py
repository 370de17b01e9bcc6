"""Displacement of bundles by thick layers, chromatic lenses and misplaced lenslets."""

import math

import numpy as np

from lf_flame.optics.camera import PlenopticCamera
from lf_flame.optics.ray_bundle import Footprint, trace_footprint
from lf_flame.scenes.scene import Layer


def rotation_shifts_mm(camera: PlenopticCamera) -> tuple[float, float]:
    """Displacement of the corner lenslets of a rotated array along y and x, in mm."""
    angle = abs(camera.lenslet_rotation_rad)
    height, width = (n * camera.lenslet_pitch_mm / 2 for n in camera.lenslets)
    sine, versine = math.sin(angle), 2 * math.sin(angle / 2) ** 2
    return sine * width + versine * height, sine * height + versine * width


def pitch_shifts_mm(camera: PlenopticCamera) -> tuple[float, float]:
    """Displacement of the outermost lenslets by a pitch error, along y and x, in mm."""
    error = abs(camera.lenslet_pitch_error)
    height, width = (error * n * camera.lenslet_pitch_mm / 2 for n in camera.lenslets)
    return height, width


def misplaced_mm(camera: PlenopticCamera) -> tuple[float, float]:
    """Largest displacement by rotation and pitch error together, along y and x, in mm."""
    rotated, stretched = rotation_shifts_mm(camera), pitch_shifts_mm(camera)
    return rotated[0] + stretched[0], rotated[1] + stretched[1]


def true_pitch_mm(camera: PlenopticCamera) -> float:
    """Pitch of the lenslets with its error."""
    return camera.lenslet_pitch_mm * (1 + camera.lenslet_pitch_error)


def aside_mm(camera: PlenopticCamera) -> tuple[float, float]:
    """Largest displacement of the lenslet nearest to a micro-image, along y and x, in mm.

    A lenslet that is farther off than half a pitch leaves the micro-image to another one.
    """
    half = camera.lenslet_pitch_mm * (1 + max(camera.lenslet_pitch_error, 0)) / 2
    half *= 1 + abs(math.tan(camera.lenslet_rotation_rad))  # of a square that is turned
    y, x = misplaced_mm(camera)
    return min(y, half), min(x, half)


def focus_spread(camera: PlenopticCamera, layer: Layer) -> list[tuple[float, float]]:
    """Depths and focal lengths, in mm, over which the light of a layer spreads."""
    depth_steps = np.linspace(-0.5, 0.5, 5) if layer.depth_extent_mm else [0.0]
    focal_steps = np.linspace(-0.5, 0.5, 3) if camera.chromatic_shift else [0.0]
    return [
        (
            layer.depth_mm + layer.depth_extent_mm * depth,
            camera.main_lens_focal_mm * (1 + camera.chromatic_shift * focal),
        )
        for depth in depth_steps
        for focal in focal_steps
    ]


def farthest_move_mm(
    camera: PlenopticCamera,
    here: Footprint,
    axis: int,
    depth_mm: float,
    focal_mm: float | None = None,
) -> float:
    """Largest displacement of a ray if the layer had another depth or the lens another focus.

    Parameters
    ----------
    camera : PlenopticCamera
    here : Footprint
        Bundles on the layer as it stands.
    axis : int
    depth_mm : float
    focal_mm : float, optional
        Default: that of the camera.
    """
    there = trace_footprint(camera, depth_mm, axis, focal_mm)
    widening = abs(there.lenslet_width_mm - here.lenslet_width_mm)
    widening += abs(there.pixel_width_mm - here.pixel_width_mm)
    beyond = abs(there.shift_per_lenslet_shift - here.shift_per_lenslet_shift) * beyond_mm(camera)
    return float(np.abs(there.centres_mm - here.centres_mm).max()) + widening / 2 + beyond


def beyond_mm(camera: PlenopticCamera) -> float:
    """Largest distance of lit pixels beyond the nominal ones of a micro-image, in mm.

    It is above 0 where lenslets are not where the sensor is read, or the aperture is wide.
    """
    lens_to_sensor = camera.lenslet_focal_mm / camera.exit_distance_mm
    widest = camera.on_exit_pupil(max(camera.aperture_diameter_mm or 0.0, camera.aperture_mm))
    wider = (widest - camera.on_exit_pupil(camera.aperture_mm)) / 2 * lens_to_sensor
    moved = max(misplaced_mm(camera)) * (1 + lens_to_sensor)
    corner = 1 + abs(math.tan(camera.lenslet_rotation_rad)) + abs(camera.lenslet_pitch_error)
    half = (widest + camera.lenslet_pitch_mm) / 2 * lens_to_sensor
    most = corner * (half + camera.pixel_mm / 2) - (camera.views - 1) / 2 * camera.pixel_mm
    return min(wider + moved, most)


def reach_mm(camera: PlenopticCamera, layer: Layer, here: Footprint, axis: int) -> float:
    """Half of a bundle's extent on a layer, plus its displacement at a thick layer's faces."""
    faces = [layer.depth_mm + sign * layer.depth_extent_mm / 2 for sign in (-1, 1)]
    wandering = (farthest_move_mm(camera, here, axis, depth) for depth in faces)
    return here.half_width_mm + (max(wandering) if layer.depth_extent_mm else 0)
