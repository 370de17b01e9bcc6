"""A reference for every optical effect: full rays from the sensor into the scene, in plain NumPy.

Slow and plain, in float64, and written from the geometry: of the library it reads the primary
numbers of camera and layers, nothing of its optics. A pixel is the mean over rays that start at
random on its true area of the sensor and cross, at random, the true square of a lenslet; all
lenslets through which light can come add up. A bundle that nothing cuts, of a layer of radiance b,
gives b.

Places and slopes are vectors (y, x), lengths in mm, seen along the optical axis from the sensor to
the scene: layers stand upright, and the sensor stands turned by 180 degrees against what is stored.
"""

import math
from collections.abc import Collection
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy import special
from scipy.stats import qmc

from lf_flame import Layer, PlenopticCamera, Scene

DIMENSIONS = 9
"""Random numbers of a ray: place on the pixel (2), on the lenslet (2), colour (1), and how far
diffraction throws it on the sensor (2) and on the lenslet array (2)."""


class Traced(NamedTuple):
    """Radiance of some pixels, and its standard error from independent randomisations.

    The error is at least that of half a ray in each, which all of them may miss at an edge along a
    row or a column.
    """

    mean: np.ndarray
    error: np.ndarray


def trace_pixels(
    scene: Scene,
    camera: PlenopticCamera,
    pixels: ArrayLike,
    rays: int = 4096,
    repeats: int = 8,
    seed: int = 0,
    diffraction: Collection[str] = ("lenslet", "main_lens"),
) -> Traced:
    """Radiance of some pixels (v, u, t, s), by scrambled Sobol points.

    Layers may be any: glowing, opaque with holes, absorbing, thick, in one another. The camera has
    all its imperfections, but its sensor is taken as ideal. Rays are those through each lenslet, a
    power of 2, in each of two or more independent randomisations, whose scatter gives the standard
    error. A camera with a `wavelength_nm` has the diffraction of the "lenslet", of the "main_lens",
    or of both.
    """
    thrown = frozenset(diffraction if camera.wavelength_nm is not None else ())
    found = np.empty((repeats, len(pixels)))
    for k, rng in enumerate(np.random.default_rng(seed).spawn(repeats)):
        sobol = qmc.Sobol(DIMENSIONS, seed=rng)
        numbers = sobol.random_base2(rays.bit_length() - 1)
        for i, pixel in enumerate(pixels):
            found[k, i] = _one_pixel(scene, camera, pixel, numbers, thrown)
    half_a_ray = sum(layer.texture.max() for layer in scene.layers) / 2 / len(numbers)
    scatter = np.hypot(found.std(axis=0, ddof=1), half_a_ray)
    return Traced(found.mean(axis=0), scatter / math.sqrt(repeats))


def draw_pixels(camera: PlenopticCamera, count: int, seed: int) -> np.ndarray:
    """Draw pixels (v, u, t, s), a third of them in corners of micro-images; shape (count, 4)."""
    rng, k = np.random.default_rng(seed), camera.views
    pixels = rng.integers(0, (k, k, *camera.lenslets), (count, 4))
    corners = count // 3
    pixels[:corners, :2] = rng.choice([0, k - 1], (corners, 2))
    return pixels


def image_distance(camera: PlenopticCamera) -> float:
    """Find the distance from main lens to lenslet array, in mm: 1/f = 1/a + 1/i."""
    return 1 / (1 / camera.main_lens_focal_mm - 1 / camera.focus_distance_mm)


def turned(vectors: ArrayLike, angle: float) -> np.ndarray:
    """Turn vectors (y, x) about the optical axis, x towards y."""
    y, x = np.moveaxis(np.asarray(vectors, float), -1, 0)
    cos, sin = math.cos(angle), math.sin(angle)
    return np.stack([cos * y + sin * x, cos * x - sin * y], axis=-1)


def pixel_places(camera: PlenopticCamera, pixel: ArrayLike, share: ArrayLike) -> np.ndarray:
    """Places on the sensor at some shares of a pixel, (0.5, 0.5) its middle; shape (n, 2).

    The sensor is read at the nominal pitch of the micro-images, about the nominal chief rays.
    """
    pixel = np.asarray(pixel)
    scale = 1 + camera.lenslet_focal_mm / image_distance(camera)
    lenslet = pixel[2:] - (np.array(camera.lenslets) - 1) / 2
    view = pixel[:2] - (camera.views - 1) / 2 + np.asarray(share) - 0.5
    return -(lenslet * camera.lenslet_pitch_mm * scale + view * camera.pixel_mm)


def _one_pixel(scene, camera, pixel, numbers, thrown) -> float:
    """Mean over rays, of all lenslets together."""
    on_sensor = pixel_places(camera, pixel, numbers[:, :2])
    if "lenslet" in thrown:  # light that rays take there is thrown to here
        on_sensor = on_sensor - _thrown_on_sensor(camera, numbers[:, 5:7])
    light, reach = 0.0, _reach(camera)
    for down in range(-reach, reach + 1):
        for right in range(-reach, reach + 1):
            centre = _lenslet_centre(camera, on_sensor, (down, right))
            light += _through(scene, camera, on_sensor, centre, numbers, thrown)
    return light


def _true_pitch(camera) -> float:
    return camera.lenslet_pitch_mm * (1 + camera.lenslet_pitch_error)


def _cell_mm(camera) -> float:
    """Side of a micro-image's cell on the sensor: the lenslet seen from the main lens."""
    return _true_pitch(camera) * (1 + camera.lenslet_focal_mm / image_distance(camera))


def _reach(camera) -> int:
    """How many lenslets away from the nearest one light can come to a place on the sensor."""
    if camera.aperture_diameter_mm is None:
        return 0
    half = camera.aperture_diameter_mm / 2
    # A stop, seen through one point of a lenslet, in cells; the lenslet's own width; half a cell.
    ratio = camera.lenslet_focal_mm / image_distance(camera) / _cell_mm(camera)
    return math.floor((half + _true_pitch(camera)) * ratio + 0.5)


def _lenslet_centre(camera, on_sensor, further):
    """Centre of the lenslet in whose cell a place lies, or of one some rows and columns further."""
    offset = (np.array(camera.lenslets) - 1) / 2
    cells = turned(on_sensor, -camera.lenslet_rotation_rad) / _cell_mm(camera)
    index = np.round(cells + offset) + further
    return turned((index - offset) * _true_pitch(camera), camera.lenslet_rotation_rad)


def _through(scene, camera, on_sensor, centre, numbers, thrown) -> float:
    """Mean over rays through one lenslet for each."""
    side, angle = _true_pitch(camera), camera.lenslet_rotation_rad
    on_lenslet = centre + turned((numbers[:, 2:4] - 0.5) * side, angle)
    # The sensor is in the lenslet's focal plane: before it, the ray is parallel to that through
    # its centre.
    tilt = (on_sensor - centre) / camera.lenslet_focal_mm
    on_main_lens = on_lenslet - image_distance(camera) * tilt
    band = 1 + camera.chromatic_shift * (numbers[:, 4:5] - 0.5)
    power = 1 / (camera.main_lens_focal_mm * band)
    weight = _passes(camera, on_main_lens, tilt + on_main_lens * power)
    if not camera.falloff_corrected:
        weight = weight / (1 + np.sum(tilt**2, axis=1)) ** 2
    if not weight.any():
        return 0.0
    if "main_lens" in thrown:  # parallel to itself, as seen from the array
        on_main_lens = on_main_lens - _thrown_on_array(camera, numbers[:, 7:9])
    lit = weight > 0
    light = _radiance(
        scene, camera.focus_distance_mm, on_main_lens[lit], (tilt + on_main_lens * power)[lit]
    )
    return float(np.sum(weight[lit] * light) / len(weight))


def _passes(camera, on_main_lens, tilt):
    """1.0 for rays that pass all stops; tilt: in front of the main lens."""
    passes = np.ones(len(tilt))
    if camera.aperture_diameter_mm is not None:
        passes *= np.hypot(*on_main_lens.T) <= camera.aperture_diameter_mm / 2
    if camera.rim_diameter_mm is not None:
        on_rim = on_main_lens - camera.rim_distance_mm * tilt
        passes *= np.hypot(*on_rim.T) <= camera.rim_diameter_mm / 2
    return passes


def _radiance(scene, distance_mm, on_main_lens, tilt):
    """Radiance along rays, from the main lens into the scene: sheets, and bodies between them.

    The path through matter is counted along the optical axis, without 1/cos.
    """
    sheets = sorted(
        (layer for layer in scene.layers if layer.thickness_mm == 0),
        key=lambda layer: (layer.depth_mm, layer.opaque),
    )
    bodies = [(layer, *_faces(layer)) for layer in scene.layers if layer.thickness_mm > 0]
    stations = {layer.depth_mm for layer in sheets}
    stations = sorted(stations.union(*(faces for _, *faces in bodies)))
    light, clear = np.zeros(len(tilt)), np.ones(len(tilt))
    for depth, following in zip(stations, [*stations[1:], math.inf], strict=True):
        place = on_main_lens - (distance_mm + depth) * tilt
        for sheet in sheets:
            if sheet.depth_mm == depth:
                tau = _cells_at(sheet, sheet.optical_thickness, place)
                opacity = _cells_at(sheet, np.asarray(sheet.opacity), place)
                light += clear * _cells_at(sheet, sheet.texture, place) * _escaping(tau)
                clear *= (1 - opacity) * np.exp(-tau)
        inside = [body for body, front, back in bodies if front <= depth < back]
        if inside:
            origin = on_main_lens - distance_mm * tilt
            added, passed = _cross(inside, origin, tilt, depth, following)
            light += clear * added
            clear *= passed
    return light


def _faces(layer: Layer) -> tuple[float, float]:
    return layer.depth_mm - layer.thickness_mm / 2, layer.depth_mm + layer.thickness_mm / 2


def _cross(bodies, origin, tilt, near, far):
    """Light that rays gain between two depths in thick bodies, and what they let pass.

    Each ray is cut where it crosses an edge of cells; between two cuts all is uniform, and the
    equation of transfer has its exponential solution.
    """
    cuts = [np.full((len(tilt), 1), near), np.full((len(tilt), 1), far)]
    for body in bodies:
        for axis in (0, 1):
            with np.errstate(divide="ignore", invalid="ignore"):
                crossed = (origin[:, axis, None] - _edges(body, axis)) / tilt[:, axis, None]
            crossed = np.clip(np.nan_to_num(crossed, nan=near), near, far)
            cuts.append(crossed[:, np.any((crossed > near) & (crossed < far), axis=0)])
    cuts = np.sort(np.concatenate(cuts, axis=1), axis=1)
    length, middle = np.diff(cuts, axis=1), (cuts[:, 1:] + cuts[:, :-1]) / 2
    place = origin[:, None] - middle[..., None] * tilt[:, None]
    emitted, absorbed = np.zeros(length.shape), np.zeros(length.shape)
    for body in bodies:
        emitted += _cells_at(body, body.texture, place) / body.thickness_mm * length
        absorbed += _cells_at(body, body.optical_thickness, place) / body.thickness_mm * length
    before = np.cumsum(absorbed, axis=1) - absorbed
    light = np.sum(np.exp(-before) * emitted * _escaping(absorbed), axis=1)
    return light, np.exp(-absorbed.sum(axis=1))


def _escaping(tau):
    """Share of its own light that leaves evenly mixed emission and absorption."""
    tau = np.asarray(tau, float)
    safe = np.where(tau > 0, tau, 1.0)
    return np.where(tau > 0, -np.expm1(-safe) / safe, 1.0)


def _edges(layer, axis):
    cells, size = layer.texture.shape[axis], layer.size_mm[axis]
    return layer.centre_mm[axis] + (np.arange(cells + 1) / cells - 0.5) * size


def _cells_at(layer, values, place):
    """Values of the cells at some places, 0 outside the layer."""
    values = np.broadcast_to(values, layer.texture.shape)
    size, shape = np.array(layer.size_mm), np.array(values.shape)
    index = np.floor(((place - np.array(layer.centre_mm)) / size + 0.5) * shape).astype(int)
    inside = np.all((index >= 0) & (index < shape), axis=-1)
    y, x = np.moveaxis(np.where(inside[..., None], index, 0), -1, 0)
    return np.where(inside, values[y, x], 0.0)


def _thrown_on_sensor(camera, numbers):
    """How far a square lenslet's diffraction throws light on the sensor, (n, 2)."""
    spread = camera.wavelength_nm * 1e-6 * camera.lenslet_focal_mm / _true_pitch(camera)
    return turned(spread * _sinc2_quantile(numbers), camera.lenslet_rotation_rad)


def _thrown_on_array(camera, numbers):
    """How far the main lens's diffraction throws light on the lenslet array, (n, 2)."""
    length = camera.wavelength_nm * 1e-6 * image_distance(camera)
    if camera.aperture_diameter_mm is None:
        matched = image_distance(camera) * camera.lenslet_pitch_mm / camera.lenslet_focal_mm
        return length / matched * _sinc2_quantile(numbers)
    radius = length / camera.aperture_diameter_mm * _airy_quantile(numbers[:, 0])
    angle = 2 * np.pi * numbers[:, 1]
    return radius[:, None] * np.stack([np.sin(angle), np.cos(angle)], axis=1)


FAR = 1e4
"""Spreads beyond which a diffraction pattern ends here: 1e-5 of its light, and 6e-5 of Airy's."""

_steps = np.concatenate([np.arange(0, 64, 1 / 512), np.geomspace(64, FAR, 4096)])
_sinc2_shares = special.sici(2 * np.pi * _steps)[0] / np.pi
_sinc2_shares -= np.pi * _steps * np.sinc(_steps) ** 2 / np.pi
_airy_shares = 1 - special.j0(np.pi * _steps) ** 2 - special.j1(np.pi * _steps) ** 2


def _sinc2_quantile(numbers):
    """Places, in spreads, below which a line spread sinc^2 has these shares of its light."""
    distance = np.interp(np.abs(2 * numbers - 1), 2 * _sinc2_shares, _steps)
    return np.copysign(distance, numbers - 0.5)


def _airy_quantile(numbers):
    """Radii, in spreads, inside which an Airy pattern has these shares of its light (Rayleigh)."""
    return np.interp(numbers, _airy_shares, _steps)
