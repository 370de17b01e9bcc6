"""Forward tracing, for comparison: rays leave the light source and fall where they fall.

An independent way to the image of `lf_flame.render`: no bundle, no trapezoid, no weight of a cell.
Each ray starts on a layer, crosses the main lens, and is pushed through the matrices as light is;
whichever lenslet and pixel it meets, gets its light. It converges far more slowly.
"""

import math
from collections.abc import Iterator

import numpy as np
from numba import njit

from lf_flame.errors import InputError
from lf_flame.optics.camera import PlenopticCamera
from lf_flame.scenes.scene import Scene
from lf_flame.simulation.slabs import Plane, slice_scene

CHUNK = 2**15
"""Rays that are drawn at a time, so that their numbers stay in the processor's cache."""

GOLDEN = 1.1673039782614187
"""Root of x^5 = x + 1, for an additive recurrence in 4 dimensions."""


def trace_forward(
    scene: Scene,
    camera: PlenopticCamera,
    rays: int,
    sequence: str = "random",
    seed: int = 0,
) -> np.ndarray:
    """Simulate the light field of flat layers with rays from the layers to the sensor.

    A ray starts uniformly over the rectangle of a layer and crosses the main lens uniformly over
    the square that all pixels see; layers in front take their share of its light. Layers get rays
    in proportion to the light that they send to the main lens.

    Parameters
    ----------
    scene : Scene
        Layers without a thickness.
    camera : PlenopticCamera
        Its stops, misalignment, colours, diffraction and sensor are left out, as by forcing these
        effects off, and cos^4 as well.
    rays : int
        Number of rays, at least 1; rounded up for each layer.
    sequence : {"random", "quasi"}, optional
        Independent random numbers (Monte Carlo; the error falls as ``rays**-0.5``), or an additive
        recurrence with a random start (quasi-Monte Carlo; Roberts' R sequence, after Weyl).
    seed : int, optional
        Of the random numbers; the same seed gives the same bits.

    Returns
    -------
    ndarray of float32, shape (v, u, t, s)
        A pixel holds the mean radiance over its ray bundle: a uniform layer that fills the field
        gives its own brightness in the mean.

    Raises
    ------
    InputError
        If there is no ray, the sequence is unknown, or a layer is thick or behind the main lens.
    """
    if rays < 1 or sequence not in ("random", "quasi"):
        raise InputError(
            f"rays must be at least 1 and sequence random or quasi, got {rays} and {sequence!r}."
        )
    if any(layer.thickness_mm for layer in scene.layers):
        raise InputError("Forward tracing takes layers of thickness_mm 0, got a thick one.")
    planes = slice_scene(scene, {}, absorption=True, dimming={"occlusion", "self_absorption"})
    to_array = [camera.object_to_array(plane.depth_mm) for plane in planes]
    powers = np.array([_power(plane, camera) for plane in planes])
    counts = np.ceil(rays * powers / max(powers.sum(), np.finfo(float).tiny)).astype(int)
    image = np.zeros((camera.views, camera.views, *camera.lenslets))
    for p in np.flatnonzero(counts).tolist():
        numbers = _draw(np.random.default_rng([seed, p]), counts[p], sequence)
        _send(planes[p], planes[:p], camera, to_array[p], numbers, 1 / counts[p], image)
    return image.astype(np.float32)


def _power(plane: Plane, camera: PlenopticCamera) -> float:
    """Light that a plane sends to the main lens, up to a factor."""
    area = math.prod(plane.layer.size_mm)
    return plane.emission.mean() * area / _distance_mm(plane, camera) ** 2


def _distance_mm(plane: Plane, camera: PlenopticCamera) -> float:
    return camera.focus_distance_mm + plane.depth_mm


def _draw(rng: np.random.Generator, count: int, sequence: str) -> Iterator[np.ndarray]:
    """Yield points of the unit cube in 4 dimensions, shape (up to CHUNK, 4), each below 1."""
    step, start = GOLDEN ** -np.arange(1.0, 5.0), rng.random(4)
    places = np.arange(min(CHUNK, count))[:, None] * step % 1
    for first in range(0, count, CHUNK):
        size = min(CHUNK, count - first)
        if sequence == "random":
            yield rng.random((size, 4))
        else:
            points = places[:size] + (first * step + start) % 1
            points -= points >= 1  # cheaper than a remainder
            yield points


def _send(plane: Plane, front: list[Plane], camera, to_array, numbers, share, image) -> None:
    """Send rays from a plane through those in front of it to the sensor.

    A pixel holds the mean over places on lenslet and pixel. With x the place on the layer and a
    that on the main lens, a ray has the slope ``(a - x) / distance``; all matrices but that to
    the sensor keep areas of (height, angle), so that an area of (lenslet, pixel) is that of
    (x, a) times ``lenslet focal length / distance``, for each axis.
    """
    layer, distance = plane.layer, _distance_mm(plane, camera)
    # All bundles on the main lens: each is as wide as a view step and a lenslet together.
    width = camera.view_step_mm * camera.views + camera.lenslet_pitch_mm
    to_sensor = camera.lenslet_to_sensor()
    jacobian = to_sensor[0, 1] / distance
    bundle = camera.lenslet_pitch_mm * camera.pixel_mm
    weight = share * math.prod(layer.size_mm) * (width * jacobian / bundle) ** 2
    source = (*(layer.cell_edges_mm(axis)[0] for axis in (0, 1)), *layer.size_mm, width, distance)
    array = (camera.lenslet_pitch_mm, camera.micro_image_pitch_mm, camera.pixel_mm)
    tables = (_screens(front, camera), (to_array, to_sensor), array)
    for chunk in numbers:
        splat(chunk, plane.emission, source, *tables, weight, image)


def _screens(front: list[Plane], camera: PlenopticCamera):
    """Tables of the planes that dim: their cells, the first cell of each, and where they lie.

    A row of the last table: upper edge, cells per mm and cells along y, the same along x, distance.
    """
    dimming = [(plane, plane.transmission) for plane in front if plane.transmission is not None]
    if not dimming:
        return None
    grids = []
    for plane, _ in dimming:
        edges = [plane.layer.cell_edges_mm(axis) for axis in (0, 1)]
        along = [(edge[0], 1 / (edge[1] - edge[0]), edge.size - 1) for edge in edges]
        grids.append([*along[0], *along[1], _distance_mm(plane, camera)])
    cells = np.concatenate([passing.ravel() for _, passing in dimming])
    first = np.cumsum([0, *(passing.size for _, passing in dimming)])[:-1]
    return cells, first, np.array(grids)


def _passes(screens, y, tilt_y, x, tilt_x, distance):
    """Share of a ray's light that passes the layers in front."""
    cells, first, grids = screens
    share = 1.0
    for k in range(first.size):
        grid = grids[k]
        way = distance - grid[6]
        row = np.floor((y + way * tilt_y - grid[0]) * grid[1])
        column = np.floor((x + way * tilt_x - grid[3]) * grid[4])
        if 0 <= row < grid[2] and 0 <= column < grid[5]:
            share *= cells[first[k] + int(row * grid[5] + column)]
    return share


def _catch(height, tilt, matrices, array, lenslets, views):
    """Lenslet and pixel that a ray meets along one axis; -1 where it meets no recorded one.

    The whole sensor is stored turned by 180 degrees, which negates the ray at the array.
    """
    to_array, to_sensor = matrices
    pitch, micro_image_pitch, pixel_mm = array
    at_array = -(to_array[0, 0] * height + to_array[0, 1] * tilt)
    angle = -(to_array[1, 0] * height + to_array[1, 1] * tilt)
    lenslet = np.floor(at_array / pitch + lenslets / 2)
    place = lenslet - (lenslets - 1) / 2
    axis = place * pitch
    on_sensor = axis + to_sensor[0, 0] * (at_array - axis) + to_sensor[0, 1] * angle
    pixel = np.floor((on_sensor - place * micro_image_pitch) / pixel_mm + views / 2)
    if 0 <= lenslet < lenslets and 0 <= pixel < views:
        return int(lenslet), int(pixel)
    return -1, -1


def _splat(numbers, emission, source, screens, matrices, array, weight, image):
    """Add the light of rays to the pixels that they meet, image[v, u, t, s] of float64.

    numbers[k]: place of ray k on the layer (y, x) and on the main lens (y, x), in [0, 1).
    source: upper left corner, height and width of the layer, width of the square on the main
    lens, distance between them, all in mm.
    screens: tables of the planes in front, or None, for which a kernel without them is compiled.
    matrices: from layer to array, and from before a lenslet to the sensor.
    array: pitches of lenslets, micro-images and pixels in mm.
    """
    top, left, height, width, aperture, distance = source
    views, _, lines, columns = image.shape
    rows, places = emission.shape
    for k in range(numbers.shape[0]):
        down, right = numbers[k, 0], numbers[k, 1]
        row, place = min(int(down * rows), rows - 1), min(int(right * places), places - 1)
        if emission[row, place] == 0.0:
            continue
        y, x = top + down * height, left + right * width
        tilt_y = ((numbers[k, 2] - 0.5) * aperture - y) / distance
        tilt_x = ((numbers[k, 3] - 0.5) * aperture - x) / distance
        t, v = catch(y, tilt_y, matrices, array, lines, views)
        s, u = catch(x, tilt_x, matrices, array, columns, views)
        if t >= 0 and s >= 0:
            light = weight * emission[row, place]
            if screens is not None:
                light *= passes(screens, y, tilt_y, x, tilt_x, distance)
            image[v, u, t, s] += light


passes = njit(_passes)
catch = njit(_catch)
splat = njit(cache=True)(_splat)
