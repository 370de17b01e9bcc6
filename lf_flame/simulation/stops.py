"""The round stops of a camera: what they cut off, and from how far off they let light come."""

import math

import numpy as np

from lf_flame.optics.camera import PlenopticCamera
from lf_flame.optics.ray_bundle import trace_stop
from lf_flame.simulation.bundle_shifts import misplaced_mm

GRID = 48
"""Points along each axis of a bundle by which the share that passes a stop is counted."""


def round_stops(camera: PlenopticCamera) -> list[tuple[float, float]]:
    """Distance in front of the main lens and radius, in mm: its aperture and the rim, if any."""
    stops = []
    if camera.aperture_diameter_mm is not None:
        stops.append((0.0, camera.aperture_diameter_mm / 2))
    if camera.rim_diameter_mm is not None:
        stops.append((camera.rim_distance_mm, camera.rim_diameter_mm / 2))
    return stops


def share_cut(
    camera: PlenopticCamera, distance_mm: float, radius_mm: float, view: int | None = None
) -> float:
    """Share of the worst bundle that a round stop cuts off, of all views or of one.

    The worst bundle lies farthest from the axis along both. Counted on a grid of points,
    with a margin for the grid cells that the stop's edge crosses.
    """
    places, misplaced = [], misplaced_mm(camera)
    for axis in (0, 1):
        footprint = trace_stop(camera, distance_mm, axis)
        centres = np.abs(footprint.centres_mm)
        farthest = centres.max() if view is None else centres[view].max()
        farthest += abs(footprint.shift_per_lenslet_shift) * misplaced[axis]
        half = footprint.half_width_mm
        places.append(np.linspace(farthest - half, farthest + half, GRID))
    if np.hypot(places[0][-1], places[1][-1]) <= radius_mm:
        return 0.0
    outside = np.add.outer(places[0] ** 2, places[1] ** 2) > radius_mm**2
    return float(min(1.0, outside.mean() + 4 / GRID))


def share_crossing(
    camera: PlenopticCamera, distance_mm: float, shifts_mm: tuple[float, float]
) -> float:
    """Share of a bundle that lenslets which move by `shifts_mm` can carry across a stop's edge."""
    moved = 0.0
    for axis in (0, 1):
        footprint = trace_stop(camera, distance_mm, axis)
        shift = abs(footprint.shift_per_lenslet_shift) * shifts_mm[axis]
        moved += 2 * shift / max(footprint.half_width_mm, 1e-300)
    return min(1.0, moved)


def neighbours(camera: PlenopticCamera) -> int:
    """How many lenslets away light can come from, through the round aperture."""
    if camera.aperture_diameter_mm is None:
        return 0
    spread = camera.aperture_diameter_mm / 2 + camera.view_step_mm * camera.views / 2
    spread += camera.lenslet_pitch_mm
    period = camera.micro_image_pitch_mm * camera.image_distance_mm / camera.lenslet_focal_mm
    return max(0, math.ceil(spread / period) - 1)
