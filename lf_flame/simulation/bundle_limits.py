"""Where bundles of rays end: what round stops block of them, and how far they are displaced.

By thick layers, by colours of the main lens, and by lenslets that are not where the sensor is read.
"""

import math

import numpy as np

from lf_flame._common.arrays import centred
from lf_flame.optics.camera import ROW_SPACING, PlenopticCamera
from lf_flame.optics.ray_bundle import Footprint, trace_footprint, trace_stop
from lf_flame.scenes.scene import Layer

GRID = 48
"""Number of points along each axis of a bundle that count the share passing a stop."""


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

    here: bundles on the layer as it stands. focal_mm: that of the camera by default.
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


def round_stops(camera: PlenopticCamera) -> list[tuple[float, float]]:
    """Distance before the main lens and radius, in mm, of its aperture and rim, if any."""
    stops = []
    if camera.aperture_diameter_mm is not None:
        stops.append((camera.aperture_before_lens_mm, camera.aperture_diameter_mm / 2))
    if camera.rim_diameter_mm is not None:
        stops.append((camera.rim_distance_mm, camera.rim_diameter_mm / 2))
    return stops


def share_cut(
    camera: PlenopticCamera,
    distance_mm: float,
    radius_mm: float,
    view: int | None = None,
    aside: tuple[float, float] | None = None,
) -> float:
    """Share that a round stop cuts off the worst bundle of all views or of one.

    The worst bundle lies farthest from the axis along both. Counted on a grid of points,
    with a margin for the grid cells that the stop's edge crosses.

    aside: displacement of lenslets along y and x, in mm; default: the camera's.
    """
    places, misplaced = [], aside_mm(camera) if aside is None else aside
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


def share_vignetted(camera: PlenopticCamera) -> float:
    """Share of a pixel's light that the rim cuts; 1 is the light of its own lenslet.

    Light through neighbouring lenslets passes the lens outside the bundles of the own one: the rim
    may cut all of it, unless it is wider than all rays between the aperture and the field.
    """
    distance_mm, radius_mm = camera.rim_distance_mm, (camera.rim_diameter_mm or math.inf) / 2
    share, other = share_cut(camera, distance_mm, radius_mm), crosstalk(camera)
    if not other:
        return share
    field_mm = (math.hypot(*camera.lenslets) / 2 + 1 + neighbours(camera)) * (
        camera.lenslet_in_focus_mm * (1 + abs(camera.lenslet_pitch_error))
    )
    apart_mm = camera.focus_distance_mm - camera.aperture_before_lens_mm
    beyond = abs(distance_mm - camera.aperture_before_lens_mm) / apart_mm
    before = abs(camera.focus_distance_mm - distance_mm) / apart_mm
    widest = max(camera.aperture_diameter_mm or 0.0, camera.aperture_mm) / 2
    return share + (other if widest * before + field_mm * beyond > radius_mm else 0.0)


def whole_views(camera: PlenopticCamera, stops: list[tuple[float, float]]) -> np.ndarray | None:
    """Weights of views that stops leave: 1 for whole ones of one lenslet, 0 for others.

    A view counts if its part of each stop lies wholly inside, seen through the middle of the array,
    and if no light of a neighbouring lenslet reaches it. Where no view is whole, those that see
    most of the aperture count.

    Returns float32 of shape (v, u), or None if all count.
    """
    shares = np.ones((camera.views, camera.views))
    for distance_mm, radius_mm in stops:
        rows, columns = (trace_stop(camera, distance_mm, axis) for axis in (0, 1))
        middle = [n // 2 for n in camera.lenslets]
        places = [
            footprint.centres_mm[:, lenslet, None]
            + np.linspace(-0.5, 0.5, GRID) * footprint.pixel_width_mm
            for footprint, lenslet in zip((rows, columns), middle, strict=True)
        ]
        y, x = places[0][:, None, :, None], places[1][None, :, None, :]
        inside = np.hypot(y, x) <= radius_mm * (1 + 1e-9)
        shares = np.minimum(shares, inside.mean(axis=(2, 3)))
    counted = (shares == 1) & _own_light(camera, stops)
    if not counted.any():
        counted = shares == shares.max()
    return None if counted.all() else counted.astype(np.float32)


def _own_light(camera: PlenopticCamera, stops: list[tuple[float, float]]) -> np.ndarray:
    """Whether no light of a neighbouring lenslet reaches a view, through an aperture too wide."""
    own = np.ones((camera.views, camera.views), bool)
    aperture = [radius for distance, radius in stops if distance == camera.aperture_before_lens_mm]
    if not aperture:
        return own
    far = (np.abs(centred(camera.views)) + 0.5) * camera.view_step_mm
    period = camera.micro_image_pitch_mm / camera.pixel_mm * camera.view_step_mm
    neighbours: tuple[tuple[float, float], ...] = ((0.0, 1.0), (1.0, 0.0), (1.0, 1.0))
    if camera.layout == "hexagonal":
        neighbours = ((0.0, 1.0), (ROW_SPACING["hexagonal"], 0.5))
    for down, right in neighbours:
        y = np.maximum(down * period - far, 0.0) if down else 0 * far
        x = np.maximum(right * period - far, 0.0) if right else 0 * far
        own &= np.hypot(y[:, None], x) >= aperture[0] * (1 - 1e-9)
    return own


def share_crossing(
    camera: PlenopticCamera,
    distance_mm: float,
    radius_mm: float,
    shifts_mm: tuple[float, float],
) -> float:
    """Change of a pixel's light, in bundles, as lenslets move by `shifts_mm` behind a stop.

    The edge of each micro-image moves over the pixel; inside a square of side w an arc is at most
    2 w long. Several micro-images may meet in one pixel.
    """
    moved, edges = 0.0, 1
    for axis in (0, 1):
        footprint = trace_stop(camera, distance_mm, axis)
        shift = abs(footprint.shift_per_lenslet_shift) * shifts_mm[axis]
        moved += 2 * shift / max(abs(footprint.pixel_width_mm), 1e-300)
        spacing = abs(footprint.shift_per_lenslet_shift) * true_pitch_mm(camera)
        edges *= 1 + math.floor(2 * (radius_mm + footprint.half_width_mm) / max(spacing, 1e-300))
    return edges * moved


def crosstalk(camera: PlenopticCamera) -> float:
    """Light that comes through other lenslets, relative to that of a pixel that one lights.

    Square micro-images and matched round ones do not overlap. A wider aperture lights a ring of
    each neighbour; inside a square of side w an arc is at most 2 w long, and four may meet in it.
    """
    if camera.aperture_diameter_mm is None:
        return 0.0
    matched = camera.aperture_mm * (1 + camera.lenslet_pitch_error)
    widest = max(camera.aperture_diameter_mm, camera.aperture_mm)
    excess = max(0.0, widest - matched) / 2
    return min(4 * excess / camera.view_step_mm, (1 + 2 * neighbours(camera)) ** 2 - 1)


def neighbours(camera: PlenopticCamera) -> int:
    """Largest distance, in lenslets, from which light comes through the round aperture."""
    if camera.aperture_diameter_mm is None:
        return 0
    widest = max(camera.aperture_diameter_mm, camera.aperture_mm)
    spread = camera.on_exit_pupil(widest + camera.view_step_mm * camera.views) / 2
    from_sensor = camera.exit_distance_mm / camera.lenslet_focal_mm
    spread += camera.lenslet_pitch_mm / 2 + max(aside_mm(camera)) * from_sensor
    period = camera.micro_image_pitch_mm * from_sensor
    period *= 1 + camera.lenslet_pitch_error
    return max(0, math.ceil(spread / period - 1e-9) - 1)
