"""Lower bound on the brightest pixel of an image, without rendering it."""

import itertools
import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.ndimage import minimum_filter, uniform_filter

from lf_flame._common.arrays import centred
from lf_flame.optics.camera import PlenopticCamera
from lf_flame.optics.ray_bundle import Footprint, trace_footprint
from lf_flame.scenes.scene import Layer
from lf_flame.simulation.bundle_shifts import aside_mm, focus_spread, misplaced_mm
from lf_flame.simulation.exact import band_weights
from lf_flame.simulation.lenslet_blur import lenslet_share_leaving
from lf_flame.simulation.main_lens_blur import blur_layer, main_lens_share_leaving
from lf_flame.simulation.slabs import self_absorbed
from lf_flame.simulation.stops import round_stops, share_cut

Footprints = Mapping[tuple[Layer, int], Footprint]
"""Intersection of all pixels' bundles of rays with each layer, along each axis."""


def peak_radiance(
    camera: PlenopticCamera, layers: tuple[Layer, ...], footprints: Footprints
) -> float:
    """Lower bound on the radiance of the brightest pixel.

    A few pixels of the central view that see the brightest place of each layer are integrated, at
    the most unfavourable position of the bundles; then losses by stops, diffraction, occlusion and
    absorption are subtracted as upper bounds.

    Parameters
    ----------
    camera : PlenopticCamera
    layers : tuple of Layer
        Layers of the scene.
    footprints : mapping of (Layer, int) to Footprint
        Intersection of the pixels' bundles with each layer along axis 0 (y) and 1 (x).

    Returns
    -------
    float
        Radiance, 0 or above, in the unit of the textures; at most the full well of a sensor.
    """
    peak, clear = 0.0, _clear_of_stops(camera) * _undiffracted(camera, layers)
    for layer in layers:
        glow = layer.texture * self_absorbed(layer.optical_thickness)
        places = [_nearest(camera, layer, glow, footprints)]
        if any(_before(front, layer) and _dims(front) for front in layers):
            places.append(_least_hidden(camera, layers, layer, glow, footprints))
        for near in places:
            brightest = _brightest(camera, *_blurred(camera, layers, layer, glow, near), near)
            peak = max(peak, clear * brightest * _seen(camera, layers, layer, near))
    sensor = camera.sensor
    return peak if sensor is None else min(peak, sensor.full_well_e / sensor.exposure_e)


def _clear_of_stops(camera: PlenopticCamera) -> float:
    """Fraction of the central view's light that all stops transmit, at the edge of the field.

    If the lenslets are displaced, the central view is the one that sees the middle of the aperture,
    to within half a pixel.
    """
    y, x = aside_mm(camera)
    aside = min(y, camera.pixel_mm / 2), min(x, camera.pixel_mm / 2)
    cut = sum(share_cut(camera, *stop, camera.views // 2, aside) for stop in round_stops(camera))
    return max(0.0, 1 - cut)


def _undiffracted(camera: PlenopticCamera, layers: tuple[Layer, ...]) -> float:
    """Fraction of a point's light that diffraction leaves in place.

    Diffraction by the main lens is included only with layers that occlude or absorb; otherwise
    `_blurred` treats it as a blur of the layers.
    """
    if camera.wavelength_nm is None:
        return 1.0
    main_lens = main_lens_share_leaving(camera) if any(map(_dims, layers)) else 0.0
    return (1 - lenslet_share_leaving(camera)) * (1 - main_lens)


def _blurred(
    camera: PlenopticCamera,
    layers: tuple[Layer, ...],
    layer: Layer,
    glow: np.ndarray,
    near: list[slice],
) -> tuple[Layer, np.ndarray]:
    """Blur a layer by diffraction at the main lens, around the place that some pixels see.

    Returns
    -------
    Layer
        Layer with the blurred cells.
    ndarray
        Light of these cells.
    """
    if camera.wavelength_nm is None or any(map(_dims, layers)):
        return layer, glow
    (top, bottom), (left, right) = (
        _looked_at_mm(camera, layer, near[axis], axis) for axis in (0, 1)
    )
    blurred = blur_layer(layer, glow, camera, layer.depth_mm, ((top, bottom), (left, right)))
    return replace(blurred, thickness_mm=layer.thickness_mm), blurred.texture


def _before(front: Layer, layer: Layer) -> bool:
    """Whether light of `layer` may have to cross `front`."""
    nearest, farthest = front.depth_mm - front.thickness_mm / 2, layer.depth_mm
    return front is not layer and nearest < farthest + layer.thickness_mm / 2


def _dims(layer: Layer) -> bool:
    return layer.opaque or bool(layer.optical_thickness.any())


def _least_hidden(
    camera: PlenopticCamera,
    layers: tuple[Layer, ...],
    layer: Layer,
    glow: np.ndarray,
    footprints: Footprints,
) -> list[slice]:
    """Find the lenslet that sees most light of a layer through those in front, in the central view.

    Returns
    -------
    list of slice
        Row and column of the lenslet, as slices of length 1.
    """
    light = _at_lenslets(camera, layer, glow, uniform_filter, 0.0, footprints)
    for front in layers:
        if _before(front, layer) and _dims(front):
            passes = np.exp(-front.optical_thickness) * (1 - front.opacity)
            light = light * _at_lenslets(camera, front, passes, minimum_filter, 1.0, footprints)
    row, column = np.unravel_index(light.argmax(), light.shape)
    return [slice(int(row), int(row) + 1), slice(int(column), int(column) + 1)]


def _at_lenslets(camera, layer: Layer, cells, over_patch, outside: float, footprints) -> np.ndarray:
    """Filter the cells of a layer over the patch that each lenslet sees, shape (t, s)."""
    sizes, places = [], []
    for axis in (0, 1):
        edges, footprint = layer.cell_edges_mm(axis), footprints[layer, axis]
        patch = 2 * footprint.half_width_mm / (edges[1] - edges[0])
        sizes.append(int(np.clip(math.ceil(patch), 1, cells.shape[axis])))
        centres = footprint.centres_mm[camera.views // 2]
        places.append(np.searchsorted(edges, centres, side="right"))
    found = over_patch(cells, sizes, mode="constant", cval=outside)
    return np.pad(found, 1, constant_values=outside)[np.ix_(*places)]


def _nearest(
    camera: PlenopticCamera, layer: Layer, glow: np.ndarray, footprints: Footprints
) -> list[slice]:
    """Find nine lenslets that see the brightest patch of a layer, in the central view.

    Returns
    -------
    list of slice
        Their rows and columns.
    """
    sizes, near = [], []
    for axis in (0, 1):
        edges = layer.cell_edges_mm(axis)
        patch = 2 * footprints[layer, axis].half_width_mm / (edges[1] - edges[0])
        sizes.append(int(np.clip(math.ceil(patch), 1, glow.shape[axis])))
    cell = np.unravel_index(uniform_filter(glow, sizes, mode="constant").argmax(), glow.shape)
    for axis in (0, 1):
        edges = layer.cell_edges_mm(axis)
        middle = (edges[cell[axis]] + edges[cell[axis] + 1]) / 2
        centres = footprints[layer, axis].centres_mm[camera.views // 2]
        nearest = int(np.abs(centres - middle).argmin())
        near.append(slice(max(nearest - 1, 0), nearest + 2))
    return near


def _brightest(camera: PlenopticCamera, layer: Layer, glow: np.ndarray, near: list[slice]) -> float:
    """Radiance of the brightest of some pixels of the central view, at its smallest.

    The smallest is taken over the positions that misplaced lenslets can give to the bundles.
    """
    dimmest = min(_cos2(camera, near[axis], axis) for axis in (0, 1))
    brightest = []
    for moved in _moves(camera):
        pixels = [
            _integrate_pixels(camera, layer, glow, near, moved, *place)
            for place in focus_spread(camera, layer)
        ]
        brightest.append(np.mean(pixels, axis=0).max())
    return float(min(brightest)) * dimmest**2


def _moves(camera: PlenopticCamera) -> list[tuple[float, float]]:
    """Possible displacements of the bundles by misplaced lenslets, along y and x.

    They are given as fractions of the largest displacement, from -1 to 1; zeros for an ideal array.
    """
    parts = (-1.0, -0.5, 0.0, 0.5, 1.0)
    y, x = (parts if aside > 0 else (0.0,) for aside in misplaced_mm(camera))
    return list(itertools.product(y, x))


def _cos2(camera: PlenopticCamera, lenslets: slice, axis: int) -> float:
    """Lower bound on cos^2 of the rays' tilt, for some lenslets.

    The tilt along both axes is taken to be the largest along the given one.
    """
    place = np.abs(centred(camera.lenslets[axis])[lenslets]).max()
    step = camera.on_exit_pupil(camera.view_step_mm)
    height = place * camera.lenslet_pitch_mm + step / 2
    if max(misplaced_mm(camera)) > 0:  # the central view may be that of a neighbouring lenslet
        height += step / 2 + camera.lenslet_pitch_mm
    return 1 / (1 + 2 * (height / camera.exit_distance_mm) ** 2)


def _integrate_pixels(
    camera: PlenopticCamera,
    layer: Layer,
    glow: np.ndarray,
    near: list[slice],
    moved: tuple[float, float],
    depth_mm: float,
    focal_mm: float,
) -> np.ndarray:
    """Integrate some pixels of the central view over a layer, placed at a depth.

    Returns
    -------
    ndarray of float64, shape (rows, columns)
        Radiance of the pixels.
    """
    bands = []
    for axis in (0, 1):
        footprint = trace_footprint(camera, depth_mm, axis, focal_mm)
        centres = footprint.centres_mm[camera.views // 2, near[axis]]
        centres = centres + moved[axis] * _most_moved_mm(camera, footprint, axis)
        widths = abs(footprint.lenslet_width_mm), abs(footprint.pixel_width_mm)
        bands.append(band_weights(layer.cell_edges_mm(axis), centres, *widths))
    (rows, row_weight), (columns, column_weight) = bands
    rows = rows[:, None] + np.arange(row_weight.shape[1])
    columns = columns[:, None] + np.arange(column_weight.shape[1])
    cells = glow[rows[:, None, :, None], columns[None, :, None, :]]
    return np.einsum("ti,tsij,sj->ts", row_weight, cells, column_weight)


def _most_moved_mm(camera: PlenopticCamera, footprint: Footprint, axis: int) -> float:
    """Largest distance on a layer from an ideal bundle to the nearest one of a misplaced array.

    It is at most the displacement by the lenslets, and at most half the distance to the next
    lenslet's bundle plus half the width of a pixel's.
    """
    moved = abs(footprint.shift_per_lenslet_shift) * misplaced_mm(camera)[axis]
    centres = footprint.centres_mm[camera.views // 2]
    spacing = abs(centres[1] - centres[0]) if centres.size > 1 else math.inf
    return min(moved, (spacing + abs(footprint.pixel_width_mm)) / 2)


def _seen(
    camera: PlenopticCamera,
    layers: tuple[Layer, ...],
    layer: Layer,
    near: list[slice],
) -> float:
    """Lower bound on the fraction of a layer's light that reaches some pixels through others."""
    share = 1.0
    for front in layers:
        if not (_before(front, layer) and _dims(front)):
            continue
        cells = tuple(_met(camera, front, near[axis], axis) for axis in (0, 1))
        opacity = np.broadcast_to(front.opacity, front.texture.shape)[cells]
        share *= 1 - np.max(opacity, initial=0.0)
        share *= math.exp(-np.max(front.optical_thickness[cells], initial=0.0))
    return share


def _met(camera: PlenopticCamera, front: Layer, near: slice, axis: int) -> slice:
    """Cells of a layer, along one axis, that some pixels of the central view can see."""
    edges, (low, high) = front.cell_edges_mm(axis), _looked_at_mm(camera, front, near, axis)
    first = np.searchsorted(edges, low, side="left") - 1
    last = np.searchsorted(edges, high, side="right")
    return slice(max(int(first), 0), max(int(last), 0))


def _looked_at_mm(
    camera: PlenopticCamera, layer: Layer, near: slice, axis: int
) -> tuple[float, float]:
    """Range of a layer in mm, along one axis, that some pixels of the central view can see."""
    places = []
    # Rays are straight between the faces of a layer, so the ends of the range are at a face.
    for depth_mm, focal_mm in focus_spread(camera, layer):
        footprint = trace_footprint(camera, depth_mm, axis, focal_mm)
        centres = footprint.centres_mm[camera.views // 2, near]
        reach = footprint.half_width_mm + _most_moved_mm(camera, footprint, axis)
        places += [centres.min() - reach, centres.max() + reach]
    return float(min(places)), float(max(places))
