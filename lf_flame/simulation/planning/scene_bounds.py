"""Bounds on the light of a scene in front of a camera, which the estimates of effects share.

They bound the brightness of pixels, the change of light from point to point on a layer, and the
change of a pixel if its bundle of rays moves over a layer. Nothing is rendered.
"""

import math
from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from lf_flame.optics.camera import PlenopticCamera
from lf_flame.optics.ray_bundle import Footprint, trace_footprint
from lf_flame.scenes.scene import Layer, Scene
from lf_flame.simulation.diffraction import tiled_sensor
from lf_flame.simulation.optical_pass import (
    beyond_mm,
    crosstalk,
    misplaced_mm,
    neighbours,
    round_stops,
    share_crossing,
    true_pitch_mm,
)
from lf_flame.simulation.planning.chosen_pixels import ChosenPixels, has_matter
from lf_flame.simulation.slabs import check_field, self_absorbed


class LightSteps(NamedTuple):
    """Largest changes of radiance on a layer along one axis, and the width of its cells."""

    whole: float  # between any two points
    next: float  # between neighbouring cells; outside the layer it is 0
    cell_mm: float


@dataclass(frozen=True, eq=False)
class SceneBounds:
    """Bounds on the light of a scene in front of a camera; `bound_scene` computes them.

    Attributes
    ----------
    layers : tuple of Layer
        Layers of the scene, nearest to the main lens first.
    footprints : mapping of (Layer, int) to Footprint
        Intersection of all pixels' bundles of rays with each layer, along axis 0 (y) and 1 (x).
    radiance, brightest_raw : float
        Upper bound on the radiance of a pixel: the sum of the brightest cells of all layers;
        `brightest_raw` includes light through neighbouring lenslets.
    pixels : ChosenPixels
    peak : float
        Radiance of the brightest of these, with all that the camera and the scene state; what
        diffraction may take from it is subtracted.
    behind : mapping of Layer to float
        Upper bound on the radiance that a layer can occlude or attenuate, from layers behind it.
    steps : mapping of (Layer, int) to LightSteps
        Largest changes of the light that a layer adds or stops, along each axis.
    defocus : bool
        Whether the blur of defocus is certain; it smooths the changes by other effects.
    """

    camera: PlenopticCamera
    layers: tuple[Layer, ...]
    footprints: Mapping[tuple[Layer, int], Footprint]
    radiance: float
    brightest_raw: float
    pixels: ChosenPixels
    peak: float
    behind: Mapping[Layer, float]
    steps: Mapping[tuple[Layer, int], LightSteps]
    defocus: bool = True

    @property
    def overlap(self) -> float:
        """Light of a pixel through all lenslets, relative to that through its own, at most."""
        return 1 + crosstalk(self.camera)

    def relative(self, change: float) -> float:
        """Ratio of a change of radiance to the brightest pixel; infinite if that may be dark."""
        if change == 0:
            return 0.0
        return change / self.peak if self.peak > 0 else math.inf


def bound_scene(scene: Scene, camera: PlenopticCamera) -> SceneBounds:
    """Bound the light of a scene in front of a camera."""
    check_field(scene, camera)
    layers, pixels = scene.front_to_back, ChosenPixels(scene, camera)
    peak = pixels.peak()
    footprints = {
        (layer, axis): trace_footprint(camera, layer.depth_mm, axis)
        for layer in layers
        for axis in (0, 1)
    }
    behind = {layer: _light_behind(camera, layers, layer, footprints) for layer in layers}
    radiance = float(sum(layer.texture.max() for layer in layers))
    return SceneBounds(
        camera=camera,
        layers=layers,
        footprints=footprints,
        radiance=radiance,
        brightest_raw=_brightest_raw(camera, radiance),
        pixels=pixels,
        peak=peak,
        behind=behind,
        steps={
            (layer, axis): _light_steps(layer, axis, behind[layer])
            for layer in layers
            for axis in (0, 1)
        },
    )


def assuming(bounds: SceneBounds, camera: PlenopticCamera) -> SceneBounds:
    """Bound the light in front of the same camera with further properties."""
    pixels = copy(bounds.pixels)
    pixels.camera = camera
    raw = _brightest_raw(camera, bounds.radiance)
    return replace(bounds, camera=camera, pixels=pixels, brightest_raw=raw)


def _brightest_raw(camera: PlenopticCamera, radiance: float) -> float:
    # Diffraction brings light from between the pixels.
    lit = camera if camera.wavelength_nm is None else tiled_sensor(camera, limited=False)
    return radiance * (1 + crosstalk(lit))


def measured_change(bounds: SceneBounds, effect: str) -> float:
    """Measure the change of the chosen pixels if all light had its central depth or colour.

    Returns twice the largest change of a pixel, in the unit of the textures, as other pixels are
    not measured; infinite where light does not only add up, or reaches a pixel through other
    lenslets. A stop may leave a part of a bundle, in the limit a point, which blurs nothing: the
    change is the larger one with and without that blur.
    """
    camera = bounds.camera
    matter = any(has_matter(layer) for layer in bounds.layers)
    if matter or any(misplaced_mm(camera)) or neighbours(camera):
        return math.inf
    slabs = [SPREAD if layer.depth_extent_mm else 1 for layer in bounds.pixels.scene.layers]
    many = {"slabs": slabs} if effect == "thickness" else {"colours": SPREAD}
    changes = []
    for blurs in (True,) if bounds.defocus and not round_stops(camera) else (True, False):
        kept = {"defocus"} if blurs else set()
        few, fine = (bounds.pixels.render(kept, (), **options) for options in ({}, many))
        changes.append(float(np.abs(few - fine).max()))
    return 2 * max(changes)


SPREAD = 8
"""Number of slabs or colours with which the change by a single one is measured: with ever more it
would be a sixtieth larger at most."""


def _light_behind(camera, layers, layer: Layer, footprints) -> float:
    """Upper bound on the radiance from other layers that must cross the matter of a layer."""
    found, front = 0.0, layer.depth_mm - layer.depth_extent_mm / 2
    if not has_matter(layer):
        return 0.0
    for k, other in enumerate(layers):
        back = other.depth_mm + other.depth_extent_mm / 2
        # At one depth, light meets the layers in their order.
        reaches_behind = back > front or (back == front and k > layers.index(layer))
        if other is layer or not reaches_behind:
            continue
        if all(_crosses(camera, layer, other, footprints, axis) for axis in (0, 1)):
            found += other.texture.max()
    return float(found)


def _crosses(camera, front: Layer, other: Layer, footprints, axis: int) -> bool:
    """Whether the rays of some pixel meet the matter of one layer and the light of another."""
    meets = True
    matter = front.optical_thickness + front.opacity
    for layer, cells in ((front, matter), (other, other.texture)):
        low, high = layer.extent_mm(cells, axis)
        footprint = footprints[layer, axis]
        reach, centres = reach_mm(camera, layer, footprint, axis), footprint.centres_mm
        meets = meets & (centres + reach > low) & (centres - reach < high)
    return bool(np.any(meets))


def _light_steps(layer: Layer, axis: int, behind: float) -> LightSteps:
    """Largest changes of the light that a layer adds, and of the light behind that it stops."""
    whole, nearest = layer.texture.max(), _largest_step(layer.texture, axis)
    if has_matter(layer):
        stopped = layer.opacity + -np.expm1(-layer.optical_thickness)
        whole = whole + stopped.max() * behind
        nearest += _largest_step(stopped, axis) * behind
        nearest += (
            _largest_step(1 - self_absorbed(layer.optical_thickness), axis) * layer.texture.max()
        )
    edges = layer.cell_edges_mm[axis]
    return LightSteps(float(whole), nearest, float(edges[1] - edges[0]))


def _largest_step(cells: np.ndarray, axis: int) -> float:
    """Largest difference between neighbouring cells along an axis; outside they are 0."""
    border = [(0, 0), (0, 0)]
    border[axis] = (1, 1)
    return float(np.abs(np.diff(np.pad(cells, border), axis=axis)).max())


def mixed_inside(bounds: SceneBounds, layer: Layer) -> float:
    """Bound on the radiance that matter stops at depths within a thick layer.

    As one plane the layer is entirely in front of that matter, or behind it.
    """
    stopped, behind = [], 0.0
    mine = np.max(layer.opacity) - math.expm1(-layer.optical_thickness.max())
    for other in bounds.layers:
        apart = abs(other.depth_mm - layer.depth_mm)
        if other is layer or apart <= (other.depth_extent_mm + layer.depth_extent_mm) / 2:
            stopped.append(np.max(other.opacity) - math.expm1(-other.optical_thickness.max()))
            behind += 0.0 if other is layer else float(other.texture.max())
    own = min(sum(stopped), 1.0) * float(layer.texture.max())
    return own + mine * behind


def box_mm(bounds: SceneBounds, layer: Layer, axis: int) -> float:
    """Width of a pixel's bundle on a layer in mm: the image of the lenslet or that of the pixel.

    The weight of a point on the layer is a trapezoid, the convolution of both boxes.
    """
    footprint = bounds.footprints[layer, axis]
    pixel = abs(footprint.pixel_width_mm) if bounds.defocus else 0.0
    return max(abs(footprint.lenslet_width_mm), pixel)


def displaced(bounds: SceneBounds, layer: Layer, axis: int, shift_mm: float, box: float) -> float:
    """Bound on the change of a pixel if its bundle, a box of this width in mm, moves on a layer.

    If a box of width a moves by d over cells of width c, a fraction d/a of it crosses each boundary
    between cells, and there are at most ``a/c + 1`` boundaries. The change is therefore at most
    ``d * min(whole / a, next * (1/c + 1/a))``. Wider weights are averages of such boxes.
    """
    steps = bounds.steps[layer, axis]
    if box <= 0:
        return steps.whole if shift_mm > 0 else 0.0
    rate = min(steps.whole / box, steps.next * (1 / steps.cell_mm + 1 / box))
    return min(steps.whole, shift_mm * rate)


def smeared(
    bounds: SceneBounds, layer: Layer, axis: int, depth_mm: float = 0.0, focal_mm: float = 0.0
) -> float:
    """Bound on the change of a pixel if all light came from the centre of a spread.

    The spread, in mm, is one of depth (a thick layer) or of focal length (chromatic shift). It is
    divided into eight parts; for each, the farthest move of the bundle within it is taken.
    """
    box, changes, here = box_mm(bounds, layer, axis), [], bounds.footprints[layer, axis]
    for part in (-0.5, -0.375, -0.25, -0.125, 0.125, 0.25, 0.375, 0.5):
        depth = layer.depth_mm + part * depth_mm
        focal = bounds.camera.main_lens_focal_mm + part * focal_mm
        moved = farthest_move_mm(bounds.camera, here, axis, depth, focal)
        changes.append(displaced(bounds, layer, axis, moved, box))
    # The front of dense matter alone may stop all the light.
    return max(changes) if depth_mm and has_matter(layer) else sum(changes) / 8


def lenslets_moved(bounds: SceneBounds, shifts_mm: tuple[float, float]) -> float:
    """Bound on the relative change if lenslets move over the sensor by up to `shifts_mm` (y, x).

    Through its own lenslet a pixel then sees another point of a layer, and where the micro-image of
    a neighbouring lenslet covers a part of it, a point that is one more pitch away.
    """
    camera, change, pitch_mm = bounds.camera, 0.0, true_pitch_mm(bounds.camera)
    for layer in bounds.layers:
        for axis in (0, 1):
            footprint, box = bounds.footprints[layer, axis], box_mm(bounds, layer, axis)
            aside = min(shifts_mm[axis], pitch_mm)
            seen = (
                trace_footprint(camera, depth, axis, focal)
                for depth, focal in focus_spread(camera, layer)
            )
            gain = max(abs(one.shift_per_lenslet_shift) for one in seen)
            stretch = shifts_mm[axis] / camera.lenslets[axis]  # change of the lenslet's own width
            shift = gain * aside + stretch * abs(footprint.lenslet_width_mm) / pitch_mm
            moved = displaced(bounds, layer, axis, shift, box)
            exchanged = _share_exchanged(camera, shifts_mm[axis])
            moved += exchanged * displaced(bounds, layer, axis, gain * pitch_mm, box)
            change += min(moved, bounds.steps[layer, axis].whole)
    for distance_mm, radius_mm in round_stops(camera):
        crossing = share_crossing(camera, distance_mm, radius_mm, shifts_mm)
        change += min(1.0, crossing) * bounds.brightest_raw
    return bounds.relative(change)


def _share_exchanged(camera: PlenopticCamera, shift_mm: float) -> float:
    """Fraction of an outermost pixel that a neighbouring micro-image covers after a shift."""
    ratio = 1 + camera.lenslet_focal_mm / camera.exit_distance_mm
    gap_mm = (camera.micro_image_pitch_mm - camera.views * camera.pixel_mm) / 2
    return min(1.0, max(0.0, shift_mm * ratio - gap_mm) / camera.pixel_mm)


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

    here: bundles on the layer as it is. focal_mm: that of the camera by default.
    """
    there = trace_footprint(camera, depth_mm, axis, focal_mm)
    widening = abs(there.lenslet_width_mm - here.lenslet_width_mm)
    widening += abs(there.pixel_width_mm - here.pixel_width_mm)
    beyond = abs(there.shift_per_lenslet_shift - here.shift_per_lenslet_shift) * beyond_mm(camera)
    return float(np.abs(there.centres_mm - here.centres_mm).max()) + widening / 2 + beyond


def reach_mm(camera: PlenopticCamera, layer: Layer, here: Footprint, axis: int) -> float:
    """Half of a bundle's extent on a layer, plus its displacement by depth, colour and lenslet."""
    wandering = (farthest_move_mm(camera, here, axis, *at) for at in focus_spread(camera, layer))
    moved = sum(misplaced_mm(camera))
    # A pixel sees through neighbouring lenslets too if lenslets are moved or the aperture is wide.
    aside = moved + max(neighbours(camera), moved > 0) * true_pitch_mm(camera)
    return here.half_width_mm + max(wandering) + abs(here.shift_per_lenslet_shift) * aside
