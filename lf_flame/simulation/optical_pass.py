"""A pass of light through the camera, and the orders in which an image stores its pixels.

At the end, how far lenslets are displaced that are not where the sensor is read, how much rays are
tilted, and what round stops cut.

Images are sub-aperture views, the raw image, or chosen lines: arrays ``[a, b, c, d]``. The position
of a pixel along y is (a, c), along x (b, d): views are ``[v, u, t, s]``, and the raw lenslet image
has a = b = 0. One kernel therefore writes all layouts.
"""

import itertools
import math
from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from lf_flame._common.arrays import centred
from lf_flame.optics.camera import PlenopticCamera
from lf_flame.optics.ray_bundle import (
    ArrayPart,
    Footprint,
    lenslet_places_mm,
    trace_footprint,
    trace_stop,
)
from lf_flame.simulation.slabs import Plane


class Lines(NamedTuple):
    """Rows and columns at whose crossings the pixels of an image are chosen; a = b = 0.

    Attributes
    ----------
    rows, columns : ndarray of int64
        Line ``view * lenslets + lenslet`` of each, along y and along x.
    """

    rows: np.ndarray
    columns: np.ndarray


Layout = str | Lines
"""Order of pixels: "views", "raw" or chosen lines."""


def as_views(image: np.ndarray, camera: PlenopticCamera) -> np.ndarray:
    """Show a raw image as ``[v, u, t, s]``, without a copy."""
    lines, columns = camera.lenslets
    raw = image.reshape(lines, camera.views, columns, camera.views)
    return raw.transpose(1, 3, 0, 2)


def arrange(table: np.ndarray, layout: Layout, axis: int) -> np.ndarray:
    """Bring a table [view, lenslet, ...] of an axis into the order of an image."""
    if isinstance(layout, Lines):
        return table.reshape(1, -1, *table.shape[2:])[:, layout[axis]]
    if layout == "views":
        return table
    raw = np.swapaxes(table, 0, 1)
    return raw.reshape(1, raw.shape[0] * raw.shape[1], *raw.shape[2:])


@dataclass(frozen=True)
class OpticalPass:
    """Camera with the effects that are simulated, for one colour: one pass of light.

    Parameters
    ----------
    camera : PlenopticCamera
    focal_mm : float, optional
        Focal length of the main lens for the colour of this pass.
    share : float, optional
        Fraction of the light in this pass.
    defocus : bool, optional
        Whether light is integrated over the width of a pixel, that is, over a patch of the main
        lens.
    falloff : bool, optional
        Whether pixels are darkened by cos^4.
    lenslet_scale, lenslet_skew : float, optional
        Diagonal and off-diagonal element of the matrix that rotates and stretches the grid of
        lenslets; if they are not 1 and 0, `every_lenslet` must be set.
    stops : tuple of (float, float), optional
        Distance in front of the main lens and radius of each round stop, in mm; at most two.
    neighbour : (int, int), optional
        Rows and columns from a pixel's own lenslet to the one through which its light comes.
    neighbours : tuple of (int, int), optional
        Such offsets of all lenslets that light some pixel, if the array is not rotated.
    every_lenslet : bool, optional
        Whether light through all lenslets that can reach a pixel adds up. Default: a pixel receives
        light through one lenslet only, as with an ideal aperture and an ideal lenslet array.
    round_aperture : bool, optional
        Whether the first stop is the aperture, which limits the micro-images. Otherwise the
        aperture is an ideal square, matched to the array: micro-images are squares that tile the
        sensor, each centred on its lenslet's image of the centre of the main lens.
    part : ArrayPart, optional
        Part of a hexagonal array through which the light comes.
    """

    camera: PlenopticCamera
    focal_mm: float | None = None
    share: float = 1.0
    defocus: bool = True
    falloff: bool = False
    lenslet_scale: float = 1.0
    lenslet_skew: float = 0.0
    stops: tuple[tuple[float, float], ...] = ()
    neighbour: tuple[int, int] = (0, 0)
    neighbours: tuple[tuple[int, int], ...] = ((0, 0),)
    every_lenslet: bool = False
    round_aperture: bool = False
    part: ArrayPart | None = None

    def footprint(self, depth_mm: float, axis: int) -> Footprint:
        """Bundles of all pixels on a layer."""
        return trace_footprint(self.camera, depth_mm, axis, *self._grid(axis))

    def strip_gain(self, plane: Plane, axis: int) -> tuple[np.ndarray, float]:
        """Factor of a strip's light in each pixel, shape (view, lenslet); 1 if it does not lean.

        A ray of slope t meets a share ``1 + t lean`` of the sheet per share of the strips. Also
        returns the change of the factor per mm by which a lenslet moves and its pixel does not.
        """
        if not plane.lean[axis]:
            return np.ones((self.camera.views, self.camera.lenslets[axis])), 0.0
        step = 1e-3 * self.camera.focus_distance_mm
        near, far = (self.footprint(plane.depth_mm + side * step, axis) for side in (-1, 1))
        per_slope = -plane.lean[axis] / (2 * step)
        moved = far.shift_per_lenslet_shift - near.shift_per_lenslet_shift
        return 1 + per_slope * (far.centres_mm - near.centres_mm), per_slope * moved

    def stop(self, distance_mm: float, axis: int) -> Footprint:
        """Bundles of all pixels on a stop."""
        return trace_stop(self.camera, distance_mm, axis, *self._grid(axis))

    def _grid(self, axis: int) -> tuple:
        return self.focal_mm, self.lenslet_scale, self.neighbour[axis], self.part

    def _nominal_mm(self, axis: int) -> np.ndarray:
        """Centres of the lenslets, as the sensor is read."""
        return lenslet_places_mm(self.camera, axis, self.part)

    @property
    def _lens_to_sensor(self) -> float:
        """Distance on the sensor per distance on the exit pupil."""
        return self.camera.lenslet_focal_mm / self.camera.exit_distance_mm

    def skew_mm(self, axis: int) -> np.ndarray:
        """Displacement of each lenslet along `axis` by a rotated array."""
        other = 1 - axis
        count = self.camera.lenslets[other]
        place = np.arange(count) - (count - 1) / 2 + self.neighbour[other]
        sign = 1 if axis == 0 else -1
        return sign * self.lenslet_skew * self.camera.lenslet_pitch_mm * place

    @property
    def lenslet_pitch_mm(self) -> float:
        """True pitch of the lenslets."""
        return self.camera.lenslet_pitch_mm * math.hypot(self.lenslet_scale, self.lenslet_skew)

    @property
    def lenslet_tangent(self) -> float:
        """Tangent of the angle by which the array is rotated."""
        return self.lenslet_skew / self.lenslet_scale

    @property
    def micro_image_mm(self) -> float:
        """Side of a square micro-image: the true lenslet pitch, seen from the exit pupil."""
        return self.lenslet_pitch_mm * (1 + self._lens_to_sensor)

    @property
    def square_micro_images(self) -> bool:
        """Whether light through every lenslet is used, and no round aperture bounds it."""
        return self.every_lenslet and not self.round_aperture

    @property
    def micro_image_reach_mm(self) -> float:
        """Distance along the array's axes from a micro-image's centre where light ends.

        The distance of pixels' centres: farther off none gets any light of the lenslet.
        """
        camera, turned = self.camera, 1 + abs(self.lenslet_tangent)
        half = self.micro_image_mm / 2
        if self.round_aperture:
            radius = camera.on_exit_pupil(self.stops[0][1])
            half = (radius + self.lenslet_pitch_mm / 2 * turned) * self._lens_to_sensor
        return half + camera.pixel_mm / 2 * turned

    def lit_neighbours(self) -> tuple[tuple[int, int], ...]:
        """Find the `neighbours` of a pass through every lenslet."""
        # Squares that only touch do not meet.
        reach = self.micro_image_reach_mm / self.micro_image_mm - 1e-9
        rows, columns = (
            range(math.ceil(offsets.min() - reach), math.floor(offsets.max() + reach) + 1)
            for offsets in (self.offsets_mm(axis) / self.micro_image_mm for axis in (0, 1))
        )
        return tuple(itertools.product(rows, columns))

    def offsets_mm(self, axis: int) -> np.ndarray:
        """Pixel centres from the centres of the lenslet's micro-images, shape (view, lenslet).

        Along one axis, as if the array were not rotated.
        """
        camera, nominal = self.camera, self._nominal_mm(axis)
        further = self.neighbour[axis] * self.lenslet_scale * camera.lenslet_pitch_mm
        moved = nominal * (self.lenslet_scale - 1) + further
        return centred(camera.views)[:, None] * camera.pixel_mm - moved * (1 + self._lens_to_sensor)

    def lit_parts(self, axis: int) -> tuple[np.ndarray, np.ndarray]:
        """Part of each pixel that lies in the lenslet's micro-image, where that is a square.

        Returns its centre from the pixel's own, in mm, and its width over the pixel's, 0 to 1; both
        of shape (view, lenslet).
        """
        offsets, pixel, half = self.offsets_mm(axis), self.camera.pixel_mm, self.micro_image_mm / 2
        low = np.clip(-half - offsets, -pixel / 2, pixel / 2)
        high = np.clip(half - offsets, -pixel / 2, pixel / 2)
        return (low + high) / 2, (high - low) / pixel

    def tangents(self, axis: int) -> np.ndarray:
        """Tangent of each pixel's central ray behind the main lens, shape (view, lenslet).

        It is that of the ray through the lenslet's centre: the pixel's distance from the lenslet's
        axis over the lenslet's focal length, as if the array were not rotated.
        """
        camera, nominal = self.camera, self._nominal_mm(axis)
        further = self.neighbour[axis] * self.lenslet_scale * camera.lenslet_pitch_mm
        towards_lenslet = (nominal * self.lenslet_scale + further) / camera.exit_distance_mm
        return towards_lenslet + self.offsets_mm(axis) / camera.lenslet_focal_mm


def optical_passes(
    camera: PlenopticCamera, kept: Collection[str], traced: Collection[str], colours: int
) -> list[OpticalPass]:
    """Set up a camera with the effects that are kept: a pass for each colour.

    traced: kept effects that treat the rays of one bundle differently, see `EffectPlan`.
    """
    angle = camera.lenslet_rotation_rad if "lenslet_rotation" in traced else 0.0
    scale = 1 + (camera.lenslet_pitch_error if "lenslet_pitch_error" in kept else 0.0)
    stops: list[tuple[float, float]] = []
    width = camera.aperture_mm
    if "round_aperture" in traced:
        if "f_number_mismatch" in traced:
            width = camera.aperture_diameter_mm or width
        stops.append((camera.aperture_before_lens_mm, width / 2))
    if "vignetting" in traced and camera.rim_diameter_mm is not None:
        stops.append((camera.rim_distance_mm, camera.rim_diameter_mm / 2))
    ideal = OpticalPass(
        camera,
        share=1 / colours,
        defocus="defocus" in kept,
        falloff="cos4" in kept and not camera.falloff_corrected,
        lenslet_scale=scale * math.cos(angle),
        lenslet_skew=scale * math.sin(angle),
        stops=tuple(stops),
        every_lenslet=angle != 0 or scale != 1 or width > camera.aperture_mm,
        round_aperture="round_aperture" in traced,
    )
    if ideal.every_lenslet:
        ideal = replace(ideal, neighbours=ideal.lit_neighbours())
    middles = (np.arange(colours) + 0.5) / colours - 0.5
    focal = [camera.main_lens_focal_mm * (1 + camera.chromatic_shift * place) for place in middles]
    return [replace(ideal, focal_mm=focal_mm) for focal_mm in focal]


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
    half *= 1 + abs(math.tan(camera.lenslet_rotation_rad))  # of a rotated square
    y, x = misplaced_mm(camera)
    return min(y, half), min(x, half)


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


def squared_tangent(camera: PlenopticCamera) -> float:
    """Largest mean squared tangent of the angle between a pixel's rays and the optical axis.

    It is that of the outermost pixel at the corner of the array, and the variance over its patch of
    the main lens; displaced or neighbouring lenslets send light from anywhere in a wide aperture.
    """
    step, pitch_mm, farther = camera.on_exit_pupil(camera.view_step_mm), true_pitch_mm(camera), 0.0
    seen = (camera.views - 1) * step
    if max(misplaced_mm(camera)) > 0 or neighbours(camera):
        widest = max(camera.aperture_diameter_mm or 0.0, camera.aperture_mm)
        widest = camera.on_exit_pupil(widest) + step
        seen = widest * (1 + abs(camera.lenslet_pitch_error)) + 2 * pitch_mm
        farther = pitch_mm
    height = [
        ((lenslets - 1) * camera.lenslet_pitch_mm + seen) / 2 + farther
        for lenslets in camera.lenslets
    ]
    patch = 2 * step**2 / 12
    return (height[0] ** 2 + height[1] ** 2 + patch) / camera.exit_distance_mm**2


def round_stops(camera: PlenopticCamera) -> list[tuple[float, float]]:
    """Distance in front of the main lens and radius, in mm, of its aperture and rim, if any."""
    stops = []
    if camera.aperture_diameter_mm is not None:
        stops.append((camera.aperture_before_lens_mm, camera.aperture_diameter_mm / 2))
    if camera.rim_diameter_mm is not None:
        stops.append((camera.rim_distance_mm, camera.rim_diameter_mm / 2))
    return stops


def share_cut(camera: PlenopticCamera, distance_mm: float, radius_mm: float) -> float:
    """Share that a round stop cuts off the worst bundle: it lies farthest from the axis along both.

    Counted on a grid of points, with a margin for the grid cells that the stop's edge crosses.
    """
    points, places = 48, []
    for axis in (0, 1):
        shift, focal_mm = camera.chromatic_shift / 2, camera.main_lens_focal_mm
        ends = {focal_mm * (1 - shift), focal_mm * (1 + shift)}
        seen = [trace_stop(camera, distance_mm, axis, focal) for focal in ends]
        farthest, half = (
            max(
                np.abs(one.centres_mm).max()
                + abs(one.shift_per_lenslet_shift) * aside_mm(camera)[axis]
                for one in seen
            ),
            max(one.half_width_mm for one in seen),
        )
        places.append(np.linspace(farthest - half, farthest + half, points))
    if np.hypot(places[0][-1], places[1][-1]) <= radius_mm:
        return 0.0
    outside = np.add.outer(places[0] ** 2, places[1] ** 2) > radius_mm**2
    return float(min(1.0, outside.mean() + 4 / points))


def share_moved(camera: PlenopticCamera, distance_mm: float) -> float:
    """Share of a bundle that may cross a stop's edge from one colour of the band to another."""
    share, shift = 0.0, camera.chromatic_shift / 2
    for axis in (0, 1):
        focals = (camera.main_lens_focal_mm * (1 + colour) for colour in (-shift, shift))
        one, other = (trace_stop(camera, distance_mm, axis, focal) for focal in focals)
        moved = float(np.abs(one.centres_mm - other.centres_mm).max())
        wider = abs(one.half_width_mm - other.half_width_mm)
        share += (moved / 2 + wider) / min(abs(one.half_width_mm), abs(other.half_width_mm))
    return share * (1 + crosstalk(camera))


def share_vignetted(camera: PlenopticCamera) -> float:
    """Share of a pixel's light that the rim cuts; 1 is the light of its own lenslet.

    Light through neighbouring lenslets passes the lens outside the bundles of a pixel's own: the
    rim may cut all of it, unless it is wider than all rays between the aperture and the field.
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


def crosstalk(camera: PlenopticCamera) -> float:
    """Light that comes through other lenslets, relative to that of a pixel that one lights.

    Square micro-images and matched round ones do not overlap. A wider aperture lights a ring of
    each neighbour; inside a square of side w an arc is at most 2 w long, and four may meet in it. A
    single view sees the whole ring.
    """
    if camera.aperture_diameter_mm is None:
        return 0.0
    matched = camera.aperture_mm * (1 + camera.lenslet_pitch_error)
    widest = max(camera.aperture_diameter_mm, camera.aperture_mm)
    excess = 4 * max(0.0, widest - matched) / 2 / camera.view_step_mm
    if camera.views == 1:
        excess = math.pi / 4 * max(0.0, widest**2 - matched**2) / camera.view_step_mm**2
    return min(excess, (1 + 2 * neighbours(camera)) ** 2 - 1)


def share_crossing(
    camera: PlenopticCamera, distance_mm: float, radius_mm: float, shifts_mm: tuple[float, float]
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
