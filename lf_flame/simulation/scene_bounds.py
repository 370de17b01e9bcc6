"""What several effects' criteria need to know of a scene before a camera, without rendering it.

Bounds on how bright pixels are, on how much light changes from place to place on a layer, and on
how far imperfections move a pixel's bundle.
"""

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from scipy.ndimage import uniform_filter

from lf_flame._common.arrays import centred
from lf_flame.optics import diffraction
from lf_flame.optics.camera import PlenopticCamera
from lf_flame.optics.ray_bundle import trace_footprint, trace_stop
from lf_flame.scenes.scene import Layer, Scene
from lf_flame.simulation.exact import band_weights
from lf_flame.simulation.slabs import self_absorbed

GRID = 48
"""Points along each axis of a bundle by which the share that passes a stop is counted."""


@dataclass(frozen=True)
class _Steps:
    """How a layer's light can change from place to place along one axis.

    whole: largest change anywhere; next: largest change between neighbouring cells of `cell_mm`.
    """

    whole: float
    next: float
    cell_mm: float


class Survey:
    """Numbers about a scene before a camera that several criteria need.

    Parameters
    ----------
    scene : Scene
    camera : PlenopticCamera

    Raises
    ------
    InputError
        If a layer stands behind the main lens.
    """

    def __init__(self, scene: Scene, camera: PlenopticCamera):
        self.camera = camera
        self.layers = scene.front_to_back
        self._footprints = {
            (layer, axis): trace_footprint(camera, layer.depth_mm, axis)
            for layer in self.layers
            for axis in (0, 1)
        }
        self._steps = {}

    def footprint(self, layer: Layer, axis: int):
        """Bundles of all pixels on a layer along an axis."""
        return self._footprints[layer, axis]

    @cached_property
    def radiance(self) -> float:
        """Upper bound on any pixel: the brightest cells of all layers, one behind the other."""
        return float(sum(layer.texture.max() for layer in self.layers))

    @cached_property
    def brightest_raw(self) -> float:
        """Upper bound on a pixel with the light that comes through neighbouring lenslets."""
        camera, crosstalk = self.camera, 0.0
        if camera.aperture_diameter_mm is not None:
            excess = max(0.0, camera.aperture_diameter_mm - camera.aperture_mm) / 2
            crosstalk = min(4 * excess / camera.view_step_mm, (1 + 2 * neighbours(camera)) ** 2 - 1)
        return self.radiance * (1 + crosstalk)

    @cached_property
    def peak(self) -> float:
        """Lower bound on the brightest pixel, from the pixels that look at each layer's peak."""
        peak, clear = 0.0, self._clear_of_stops() * self._undiffracted()
        for layer in self.layers:
            glow = layer.texture * self_absorbed(layer.optical_thickness)
            near = self._nearest(layer, glow)
            peak = max(peak, clear * self._brightest(layer, glow, near) * self._seen(layer, near))
        sensor = self.camera.sensor
        return peak if sensor is None else min(peak, sensor.full_well_e / sensor.exposure_e)

    def _nearest(self, layer: Layer, glow: np.ndarray) -> list[slice]:
        """Find nine lenslets that look at the brightest patch of a layer, in the central view."""
        sizes, near = [], []
        for axis in (0, 1):
            edges = layer.cell_edges_mm(axis)
            patch = 2 * self.footprint(layer, axis).half_width_mm / (edges[1] - edges[0])
            sizes.append(int(np.clip(math.ceil(patch), 1, glow.shape[axis])))
        cell = np.unravel_index(uniform_filter(glow, sizes, mode="constant").argmax(), glow.shape)
        for axis in (0, 1):
            edges = layer.cell_edges_mm(axis)
            middle = (edges[cell[axis]] + edges[cell[axis] + 1]) / 2
            centres = self.footprint(layer, axis).centres_mm[self.camera.views // 2]
            nearest = int(np.abs(centres - middle).argmin())
            near.append(slice(max(nearest - 1, 0), nearest + 2))
        return near

    def _seen(self, layer: Layer, near: list[slice]) -> float:
        """Share of a layer's light that reaches some pixels through what stands before it."""
        share, view = 1.0, self.camera.views // 2
        for front in self.layers:
            before = (
                front.depth_mm - front.thickness_mm / 2 < layer.depth_mm + layer.thickness_mm / 2
            )
            if front is layer or not before:
                continue
            meets = True
            for axis in (0, 1):
                low, high = front.extent_mm(front.optical_thickness + front.hides, axis)
                footprint = self.footprint(front, axis)
                centres = footprint.centres_mm[view, near[axis]]
                reach = footprint.half_width_mm + self._thick_shift(front, axis)
                meets &= bool(np.any((centres + reach > low) & (centres - reach < high)))
            if meets:
                share *= 1 - np.max(front.hides)
                share *= math.exp(-front.optical_thickness.max())
        return share

    def _brightest(self, layer: Layer, glow: np.ndarray, near: list[slice]) -> float:
        """Integrate some pixels of the central view; the brightest of them, at its dimmest."""
        dimmest = min(self._unshaded(near[axis], axis) for axis in (0, 1))
        pixels = [self._pixels(layer, glow, near, *place) for place in self.places(layer)]
        return float(np.mean(pixels, axis=0).max()) * dimmest**2

    def places(self, layer: Layer) -> list[tuple[float, float]]:
        """Depths and focal lengths over which the light of a layer spreads."""
        camera = self.camera
        depth_steps = np.linspace(-0.5, 0.5, 5) if layer.thickness_mm else [0.0]
        focal_steps = np.linspace(-0.5, 0.5, 3) if camera.chromatic_shift else [0.0]
        return [
            (
                layer.depth_mm + layer.thickness_mm * depth,
                camera.main_lens_focal_mm * (1 + camera.chromatic_shift * focal),
            )
            for depth in depth_steps
            for focal in focal_steps
        ]

    def _pixels(self, layer: Layer, glow, near: list[slice], depth_mm: float, focal_mm: float):
        """Integrate some pixels of the central view, looking at a layer at a depth."""
        bands = []
        for axis in (0, 1):
            footprint = trace_footprint(self.camera, depth_mm, axis, focal_mm)
            centres = footprint.centres_mm[self.camera.views // 2, near[axis]]
            widths = abs(footprint.lenslet_width_mm), abs(footprint.pixel_width_mm)
            bands.append(band_weights(layer.cell_edges_mm(axis), centres, *widths))
        (rows, row_weight), (columns, column_weight) = bands
        rows = rows[:, None] + np.arange(row_weight.shape[1])
        columns = columns[:, None] + np.arange(column_weight.shape[1])
        cells = glow[rows[:, None, :, None], columns[None, :, None, :]]
        return np.einsum("ti,tsij,sj->ts", row_weight, cells, column_weight)

    def _unshaded(self, lenslets: slice, axis: int) -> float:
        """cos^2 of a ray tilted along both axes as the lenslets' rays are along one."""
        camera = self.camera
        place = np.abs(centred(camera.lenslets[axis])[lenslets]).max()
        height = place * camera.lenslet_pitch_mm + camera.view_step_mm / 2
        return 1 / (1 + 2 * (height / camera.image_distance_mm) ** 2)

    def _clear_of_stops(self) -> float:
        """Share of the central view's light that the stops let pass, at the edge of the field."""
        stops = [stop for stop in self.stops if stop is not None]
        return max(0.0, 1 - sum(self.cut(*stop, self.camera.views // 2) for stop in stops))

    def _undiffracted(self) -> float:
        """Share of a point's light that stays where it would be without diffraction."""
        if self.camera.wavelength_nm is None:
            return 1.0
        kernels = lenslet_kernel(self.camera), main_lens_kernel(self.camera)
        return math.prod(1 - diffraction.share_leaving(kernel) for kernel in kernels)

    @cached_property
    def stops(self) -> tuple:
        """Distance and radius of the main lens's aperture and of the rim, or None, in mm."""
        camera = self.camera
        aperture = camera.aperture_diameter_mm and (0.0, camera.aperture_diameter_mm / 2)
        rim = camera.rim_diameter_mm and (camera.rim_distance_mm, camera.rim_diameter_mm / 2)
        return aperture, rim

    @cached_property
    def misplaced_mm(self) -> tuple[float, float]:
        """How far rotation and pitch error can move a lenslet along each axis."""
        turned, stretched = rotation_shifts(self.camera), pitch_shifts(self.camera)
        return turned[0] + stretched[0], turned[1] + stretched[1]

    def cut(self, distance_mm: float, radius_mm: float, view: int | None = None) -> float:
        """Share of the worst bundle that a round stop cuts off, of all views or of one.

        The worst bundle lies farthest from the axis along both. Counted on a grid of points,
        with a margin for the grid cells that the stop's edge crosses.
        """
        places = []
        for axis in (0, 1):
            footprint = trace_stop(self.camera, distance_mm, axis)
            centres = np.abs(footprint.centres_mm)
            farthest = centres.max() if view is None else centres[view].max()
            farthest += abs(footprint.shift_per_lenslet_shift) * self.misplaced_mm[axis]
            half = footprint.half_width_mm
            places.append(np.linspace(farthest - half, farthest + half, GRID))
        if np.hypot(places[0][-1], places[1][-1]) <= radius_mm:
            return 0.0
        outside = np.add.outer(places[0] ** 2, places[1] ** 2) > radius_mm**2
        return float(min(1.0, outside.mean() + 4 / GRID))

    def relative(self, change: float) -> float:
        """Express a change of radiance relative to the brightest pixel."""
        if change == 0:
            return 0.0
        return change / self.peak if self.peak > 0 else math.inf

    def stopped_inside(self, layer: Layer) -> float:
        """Bound on the share of a thick layer's light that stands behind matter inside it."""
        inside = 0.0
        for other in self.layers:
            apart = abs(other.depth_mm - layer.depth_mm)
            if other is layer or apart < (other.thickness_mm + layer.thickness_mm) / 2:
                inside += float(np.max(other.hides)) - math.expm1(-other.optical_thickness.max())
        return min(inside, 1.0)

    def behind(self, layer: Layer) -> float:
        """Radiance that a layer can hide or dim: of the layers whose light has to cross it."""
        found, front = 0.0, layer.depth_mm - layer.thickness_mm / 2
        for other in self.layers:
            reaches_behind = other.depth_mm + other.thickness_mm / 2 > front
            if other is layer or not reaches_behind:
                continue
            if all(self._crosses(layer, other, axis) for axis in (0, 1)):
                found += other.texture.max()
        return float(found)

    def _crosses(self, front: Layer, other: Layer, axis: int) -> bool:
        """Whether the bundle of some pixel meets both layers, along one axis."""
        meets = True
        matter = front.optical_thickness + front.hides
        for layer, cells in ((front, matter), (other, other.texture)):
            low, high = layer.extent_mm(cells, axis)
            footprint = self.footprint(layer, axis)
            reach = footprint.half_width_mm + self._thick_shift(layer, axis)
            centres = footprint.centres_mm
            meets = meets & (centres + reach > low) & (centres - reach < high)
        return bool(np.any(meets))

    def _thick_shift(self, layer: Layer, axis: int) -> float:
        """How far the bundles of a thick layer wander from its middle to its faces."""
        faces = [layer.depth_mm + sign * layer.thickness_mm / 2 for sign in (-1, 1)]
        return max(
            (self.moved(layer, axis, depth) for depth in faces if layer.thickness_mm), default=0
        )

    def steps(self, layer: Layer, axis: int) -> _Steps:
        """Largest changes of what a layer adds to or takes from the light, borders included."""
        if (layer, axis) not in self._steps:
            whole, nearest = layer.texture.max(), _largest_step(layer.texture, axis)
            if layer.opaque or layer.optical_thickness.any():
                stopped = layer.hides + -np.expm1(-layer.optical_thickness)
                behind = self.behind(layer)
                whole = whole + stopped.max() * behind
                nearest += _largest_step(stopped, axis) * behind
            edges = layer.cell_edges_mm(axis)
            found = _Steps(float(whole), nearest, float(edges[1] - edges[0]))
            self._steps[layer, axis] = found
        return self._steps[layer, axis]

    def displaced(self, layer: Layer, axis: int, shift_mm: float, box_mm: float) -> float:
        """Bound on the change of a pixel when its bundle moves on a layer.

        A box of width a that moves by d over cells of width c crosses, per boundary, a share d/a
        of itself, and there are at most a/c + 1 boundaries: the change is at most
        ``d * min(whole / a, next * (1/c + 1/a))``. Any wider kernel averages such boxes.
        """
        steps = self.steps(layer, axis)
        if box_mm <= 0:
            return steps.whole if shift_mm > 0 else 0.0
        rate = min(steps.whole / box_mm, steps.next * (1 / steps.cell_mm + 1 / box_mm))
        return min(steps.whole, shift_mm * rate)

    def box(self, layer: Layer, axis: int) -> float:
        """Take the wider of the two boxes that a pixel's trapezoid is made of, in mm."""
        footprint = self.footprint(layer, axis)
        return max(abs(footprint.lenslet_width_mm), abs(footprint.pixel_width_mm))

    def moved(
        self, layer: Layer, axis: int, depth_mm: float, focal_mm: float | None = None
    ) -> float:
        """Farthest that a ray moves if a layer stood elsewhere or the lens had another focus."""
        here = self.footprint(layer, axis)
        there = trace_footprint(self.camera, depth_mm, axis, focal_mm)
        widening = abs(there.lenslet_width_mm - here.lenslet_width_mm)
        widening += abs(there.pixel_width_mm - here.pixel_width_mm)
        return float(np.abs(there.centres_mm - here.centres_mm).max()) + widening / 2

    def smeared(
        self, layer: Layer, axis: int, depth_mm: float = 0.0, focal_mm: float = 0.0
    ) -> float:
        """Bound on the change of a pixel if light spread over depth or colour stood at its middle.

        depth_mm, focal_mm: the whole spread. The mean of what it moves, as an upper sum over
        quarters.
        """
        box, total = self.box(layer, axis), 0.0
        for part in (-0.5, -0.375, -0.25, -0.125, 0.125, 0.25, 0.375, 0.5):
            depth = layer.depth_mm + part * depth_mm
            moved = self.moved(layer, axis, depth, self.camera.main_lens_focal_mm + part * focal_mm)
            total += self.displaced(layer, axis, moved, box) / 8
        return total

    def lenslet_shift(self, shifts_mm: tuple[float, float]) -> float:
        """Bound on the change when the lenslets move by up to `shifts_mm` over the sensor."""
        change = 0.0
        for layer in self.layers:
            for axis in (0, 1):
                footprint, box = self.footprint(layer, axis), self.box(layer, axis)
                shift = abs(footprint.shift_per_lenslet_shift) * shifts_mm[axis]
                stretch = shifts_mm[axis] / self.camera.lenslets[axis]  # of the lenslet itself
                shift += stretch * abs(footprint.lenslet_width_mm) / self.camera.lenslet_pitch_mm
                change += self.displaced(layer, axis, shift, box)
        for stop in self.stops:
            if stop is not None:
                change += self.brightest_raw * self._stop_shift(stop[0], shifts_mm)
        return self.relative(change)

    def _stop_shift(self, distance_mm: float, shifts_mm: tuple[float, float]) -> float:
        """Share of a bundle that a moving lenslet can carry across the edge of a stop."""
        moved = 0.0
        for axis in (0, 1):
            footprint = trace_stop(self.camera, distance_mm, axis)
            shift = abs(footprint.shift_per_lenslet_shift) * shifts_mm[axis]
            moved += 2 * shift / max(footprint.half_width_mm, 1e-300)
        return min(1.0, moved)


def _largest_step(cells: np.ndarray, axis: int) -> float:
    """Largest difference of neighbouring cells along an axis; outside there is nothing."""
    border = [(0, 0), (0, 0)]
    border[axis] = (1, 1)
    return float(np.abs(np.diff(np.pad(cells, border), axis=axis)).max())


def neighbours(camera: PlenopticCamera) -> int:
    """How many lenslets away light can come from, through the round aperture."""
    if camera.aperture_diameter_mm is None:
        return 0
    spread = camera.aperture_diameter_mm / 2 + camera.view_step_mm * camera.views / 2
    spread += camera.lenslet_pitch_mm
    period = camera.micro_image_pitch_mm * camera.image_distance_mm / camera.lenslet_focal_mm
    return max(0, math.ceil(spread / period) - 1)


@lru_cache(maxsize=16)
def lenslet_kernel(camera: PlenopticCamera) -> np.ndarray:
    """Diffraction of a lenslet in pixels."""
    spread = camera.wavelength_nm * 1e-6 * camera.lenslet_focal_mm / camera.lenslet_pitch_mm
    return diffraction.square_kernel(spread, camera.pixel_mm, 1e-3)


@lru_cache(maxsize=16)
def main_lens_kernel(camera: PlenopticCamera) -> np.ndarray:
    """Diffraction of the main lens in lenslets: an Airy pattern if its aperture is round."""
    length = camera.wavelength_nm * 1e-6 * camera.image_distance_mm
    if camera.aperture_diameter_mm is None:
        spread = length / camera.aperture_mm
        return diffraction.square_kernel(spread, camera.lenslet_pitch_mm, 1e-3)
    spread = length / camera.aperture_diameter_mm
    return diffraction.round_kernel(spread, camera.lenslet_pitch_mm, 1e-3)


def rotation_shifts(camera: PlenopticCamera) -> tuple[float, float]:
    """How far a rotated array moves its corner lenslets along y and x, in mm."""
    turn = abs(camera.lenslet_rotation_rad)
    height, width = (n * camera.lenslet_pitch_mm / 2 for n in camera.lenslets)
    sine, versine = math.sin(turn), 2 * math.sin(turn / 2) ** 2
    return sine * width + versine * height, sine * height + versine * width


def pitch_shifts(camera: PlenopticCamera) -> tuple[float, float]:
    """How far an error of the pitch moves the outermost lenslets along y and x, in mm."""
    error = abs(camera.lenslet_pitch_error)
    return tuple(error * n * camera.lenslet_pitch_mm / 2 for n in camera.lenslets)
