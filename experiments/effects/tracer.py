"""The reference for simulated images: rays from the sensor into the scene, in plain NumPy.

Slow and obvious, in float64, and written from the geometry alone: of the library it reads the
primary numbers of camera and layers, none of its optics. `trace_pixels` follows random rays of some
pixels through every effect. `flat_views` multiplies out whole images of flat layers, to rounding.

Places and tilts are vectors (y, x), lengths in mm, seen along the optical axis from the sensor to
the scene: layers are upright, and the sensor is rotated by 180 degrees against what is stored. A
bundle that nothing cuts, from a layer of radiance b, gives b.
"""

import math
from collections.abc import Collection
from itertools import product

import numpy as np
from numpy.typing import ArrayLike
from scipy import special
from scipy.stats import qmc

from lf_flame import InputError, Layer, PlenopticCamera, Scene

DIMENSIONS = 9
"""Random numbers of a ray: place on the pixel (2), on the lenslet (2), colour (1), and its
displacement by diffraction on the sensor (2) and on the lenslet array (2)."""


SHEETS = 128
"""Number of sheets that a thick layer is cut into."""


def trace_pixels(
    scene: Scene,
    camera: PlenopticCamera,
    pixels: ArrayLike,
    rays: int = 4096,
    repeats: int = 8,
    seed: int = 0,
    diffraction: Collection[str] = ("lenslet", "main_lens"),
) -> tuple[np.ndarray, np.ndarray]:
    """Trace random rays (scrambled Sobol points) of some pixels (v, u, t, s).

    Layers may glow, be opaque with holes, absorb, be thick, and overlap. The camera has all its
    imperfections, but an ideal sensor. A hexagonal array has no rotation and no error of its pitch,
    and its light stays in its own micro-images. `rays` is the number of rays through each lenslet,
    a power of 2, in each of `repeats` (2 or more) independent randomisations. A camera with a
    `wavelength_nm` has the diffraction of the "lenslet", of the "main_lens", or of both.

    Returns the radiance of each pixel and its standard error, from the scatter of the
    randomisations. The error is at least half a ray in each: at an edge along a row or a column
    all may miss it.
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
    return found.mean(axis=0), scatter / math.sqrt(repeats)


def flat_views(scene: Scene, camera: PlenopticCamera) -> np.ndarray:
    """Multiply out the views of flat layers that only add light, or that one opaque layer hides.

    Float64, shape (v, u, t, s). The camera counts without stops, diffraction and sensor. A layer
    may have at most one opaque layer in front of it, and layers are flat and do not absorb.
    """
    if any(layer.thickness_mm or layer.optical_thickness.any() for layer in scene.layers):
        raise InputError("flat_views takes layers that are flat and do not absorb.")
    views: np.ndarray | float = 0.0
    cards: list[Layer] = []
    for layer in sorted(scene.layers, key=lambda layer: (layer.depth_mm, layer.opaque)):
        if layer.texture.any():
            if len(cards) > 1:
                raise InputError(f"flat_views takes one card before a glow, got {len(cards)}.")
            size = tuple(3 * side for side in layer.size_mm)
            wall = Layer([[0.0]], layer.depth_mm, size, layer.centre_mm, opaque=True)  # hides all
            views = views + _hidden(wall, layer, camera)
            views = views - sum(_hidden(card, layer, camera) for card in cards)
        cards += [layer] if layer.opaque else []
    return views


def _image_distance(camera: PlenopticCamera) -> float:
    """Distance from main lens to lenslet array, in mm: 1/f = 1/a + 1/i."""
    return 1 / (1 / camera.main_lens_focal_mm - 1 / camera.focus_distance_mm)


def _pupil_mm(camera: PlenopticCamera) -> float:
    """Distance from the exit pupil to the lenslet array; by default that of the main lens."""
    return camera.exit_pupil_mm or _image_distance(camera)


def _exit_radius(camera: PlenopticCamera) -> float:
    """Radius of the exit pupil: of the image of an aperture that looks as wide as stated.

    For an exit pupil at s' behind the lens the entrance pupil, its object, is ``1 - s' / f`` times
    as narrow.
    """
    behind = _image_distance(camera) - _pupil_mm(camera)
    return camera.aperture_diameter_mm / 2 * (1 - behind / camera.main_lens_focal_mm)


def _pixel_mm(camera: PlenopticCamera) -> float:
    """Pitch of the pixels; by default so many views fill a micro-image."""
    micro_image = camera.lenslet_pitch_mm * (1 + camera.lenslet_focal_mm / _pupil_mm(camera))
    return camera.pixel_pitch_mm or micro_image / camera.views


def _turned(vectors: ArrayLike, angle: float) -> np.ndarray:
    """Turn vectors (y, x) about the optical axis, x towards y."""
    y, x = np.moveaxis(np.asarray(vectors, float), -1, 0)
    cos, sin = math.cos(angle), math.sin(angle)
    return np.stack([cos * y + sin * x, cos * x - sin * y], axis=-1)


def _on_sensor(camera: PlenopticCamera, pixel: ArrayLike, share: np.ndarray) -> np.ndarray:
    """Places on the sensor at shares of a pixel, (0.5, 0.5) its middle; shape (n, 2).

    The sensor is read at the nominal pitch of the micro-images, about the nominal chief rays.
    """
    pixel = np.asarray(pixel)
    scale = 1 + camera.lenslet_focal_mm / _pupil_mm(camera)
    lenslet = pixel[2:] - (np.array(camera.lenslets) - 1) / 2
    view = pixel[:2] - (camera.views - 1) / 2 + share - 0.5
    return -(lenslet * camera.lenslet_pitch_mm * scale + view * _pixel_mm(camera))


def _one_pixel(scene, camera, pixel, numbers, thrown) -> float:
    """Mean over rays, of all lenslets together."""
    lenslets = _hexagons if camera.layout == "hexagonal" else _squares
    return sum(
        share * _through(scene, camera, *places, numbers, thrown)
        for share, *places in lenslets(camera, pixel, numbers, thrown)
    )


def _true_pitch(camera) -> float:
    return camera.lenslet_pitch_mm * (1 + camera.lenslet_pitch_error)


def _cell_mm(camera) -> float:
    """Side of a micro-image's cell on the sensor: the lenslet seen from the main lens."""
    return _true_pitch(camera) * (1 + camera.lenslet_focal_mm / _pupil_mm(camera))


def _reach(camera) -> int:
    """How many lenslets away from the nearest one light can come to a place on the sensor."""
    if camera.aperture_diameter_mm is None:
        return 0
    half = _exit_radius(camera)
    # A stop, seen through one point of a lenslet, in cells; the lenslet's own width; half a cell.
    ratio = camera.lenslet_focal_mm / _pupil_mm(camera) / _cell_mm(camera)
    return math.floor((half + _true_pitch(camera)) * ratio + 0.5)


def _squares(camera, pixel, numbers, thrown):
    """Yield for each lenslet near a pixel: share, places on the sensor, centre, places on it."""
    on_sensor = _on_sensor(camera, pixel, numbers[:, :2])
    if "lenslet" in thrown:  # light that rays take there is thrown to here
        on_sensor = on_sensor - _thrown_on_sensor(camera, numbers[:, 5:7])
    side, angle = _true_pitch(camera), camera.lenslet_rotation_rad
    on_square = _turned((numbers[:, 2:4] - 0.5) * side, angle)
    offset = (np.array(camera.lenslets) - 1) / 2
    nearest = np.round(_turned(on_sensor, -angle) / _cell_mm(camera) + offset)
    for further in product(range(-_reach(camera), _reach(camera) + 1), repeat=2):
        centre = _turned((nearest + further - offset) * side, angle)
        yield 1.0, on_sensor, centre, centre + on_square


def _hexagons(camera, pixel, numbers, _thrown):
    """Yield the two hexagons of a row between which a pixel of a view lies, as `_squares` does.

    Rows are 0.866 pitches apart, and so are the pixels of a row; odd rows are half a pitch to the
    right of even ones, and row 0 has a lenslet half a pitch to the left of column 0.
    """
    pitch, step, odd = camera.lenslet_pitch_mm, math.sqrt(3) / 2, pixel[2] % 2
    rows, columns = camera.lenslets
    view = np.array(pixel[:2]) - (camera.views - 1) / 2 + numbers[:, :2] - 0.5
    whole, part = divmod(0.5 + step * pixel[3] - 0.5 * odd, 1)  # pitches from the first lenslet
    first = -(columns - 1) / 2 * step - 0.5 + 0.5 * odd
    for further, share in ((0, 1 - part), (1, part)):
        upright = (pixel[2] - (rows - 1) / 2) * step, first + whole + further
        centre = -pitch * np.array(upright)
        chief = centre * (1 + camera.lenslet_focal_mm / _pupil_mm(camera))
        on_lenslet = centre + pitch * _in_hexagon(numbers[:, 2:4])
        yield share, chief - view * _pixel_mm(camera), centre, on_lenslet


def _in_hexagon(numbers):
    """Spread places over a hexagon of breadth 1 with upright sides, cut into three rhombi."""
    rhombus, along = np.divmod(3 * numbers[:, 0], 1)
    corner = np.exp(2j * np.pi / 3 * rhombus) / math.sqrt(3)
    place = corner * (along + numbers[:, 1] * np.exp(2j * np.pi / 3))
    return np.stack([place.real, place.imag], axis=1)


def _through(scene, camera, on_sensor, centre, on_lenslet, numbers, thrown) -> float:
    """Mean over rays from places on the sensor through places of a lenslet."""
    # The sensor is in the lenslet's focal plane: before it, the ray is parallel to that through
    # its centre.
    tilt = (on_sensor - centre) / camera.lenslet_focal_mm
    on_main_lens = on_lenslet - _image_distance(camera) * tilt
    band = 1 + camera.chromatic_shift * (numbers[:, 4:5] - 0.5)
    power = 1 / (camera.main_lens_focal_mm * band)
    on_pupil = on_lenslet - _pupil_mm(camera) * tilt
    weight = _passes(camera, on_pupil, on_main_lens, tilt + on_main_lens * power)
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


def _passes(camera, on_pupil, on_main_lens, tilt):
    """1.0 for rays that pass all stops; tilt: in front of the main lens."""
    passes = np.ones(len(tilt))
    if camera.aperture_diameter_mm is not None:
        passes *= np.hypot(*on_pupil.T) <= _exit_radius(camera)
    if camera.rim_diameter_mm is not None:
        on_rim = on_main_lens - camera.rim_distance_mm * tilt
        passes *= np.hypot(*on_rim.T) <= camera.rim_diameter_mm / 2
    return passes


def _radiance(scene, distance_mm, on_main_lens, tilt):
    """Radiance along rays, from the main lens into the scene; a thick layer is cut into sheets.

    The path through matter is counted along the optical axis, without 1/cos.
    """
    light, clear = np.zeros(len(tilt)), np.ones(len(tilt))
    sheets = [sheet for layer in scene.layers for sheet in _sheets(layer)]
    for depth, layer, share in sorted(sheets, key=lambda sheet: (sheet[0], sheet[1].opaque)):
        hit, cells = _cells_met(layer, _on_layer(layer, depth, distance_mm, on_main_lens, tilt))
        emitted, tau = share * layer.texture[cells], share * layer.optical_thickness[cells]
        opacity = np.broadcast_to(layer.opacity, layer.texture.shape)[cells]
        light[hit] += clear[hit] * emitted * _escaping(tau)
        clear[hit] *= (1 - opacity) * np.exp(-tau)
    return light


def _sheets(layer: Layer) -> list[tuple[float, Layer, float]]:
    """Depth, layer, and share of its matter, for each sheet of a layer."""
    if layer.thickness_mm == 0:
        return [(layer.depth_mm, layer, 1.0)]
    at = (np.arange(SHEETS) + 0.5) / SHEETS - 0.5
    return [(layer.depth_mm + x * layer.thickness_mm, layer, 1 / SHEETS) for x in at]


def _escaping(tau):
    """Share of its own light that leaves evenly mixed emission and absorption."""
    tau = np.asarray(tau, float)
    safe = np.where(tau > 0, tau, 1.0)
    return np.where(tau > 0, -np.expm1(-safe) / safe, 1.0)


def _on_layer(layer, depth_mm, distance_mm, on_main_lens, tilt):
    """Places where rays meet a sheet, as if it did not lean: along it, from its own centre.

    A sheet that leans about the horizontal axis is farther away at its top, at ``depth - w sin``
    for w along it, downward, from its centre; about the vertical axis at its right side.
    """
    place = on_main_lens - (distance_mm + depth_mm) * tilt
    for axis, sign in ((0, -1), (1, 1)):
        angle = math.radians(layer.tilt_deg[axis])
        if angle:
            far = sign * math.sin(angle)
            aside = place[:, axis] - layer.centre_mm[axis]
            along = aside / (math.cos(angle) + far * tilt[:, axis])
            place = place - along[:, None] * far * tilt
            place[:, axis] = layer.centre_mm[axis] + along
    return place


def _cells_met(layer, place):
    """Find the rays that meet a layer, and the cells that these meet, (rows, columns)."""
    shape = np.array(layer.texture.shape)
    index = np.floor(((place - layer.centre_mm) / layer.size_mm + 0.5) * shape).astype(int)
    hit = np.flatnonzero(np.all((index >= 0) & (index < shape), axis=-1))
    return hit, tuple(index[hit].T)


def _thrown_on_sensor(camera, numbers):
    """How far a square lenslet's diffraction throws light on the sensor, (n, 2)."""
    spread = camera.wavelength_nm * 1e-6 * camera.lenslet_focal_mm / _true_pitch(camera)
    return _turned(spread * _sinc2_quantile(numbers), camera.lenslet_rotation_rad)


def _thrown_on_array(camera, numbers):
    """How far the main lens's diffraction throws light on the lenslet array, (n, 2)."""
    length = camera.wavelength_nm * 1e-6 * _pupil_mm(camera)
    if camera.aperture_diameter_mm is None:
        matched = _pupil_mm(camera) * camera.lenslet_pitch_mm / camera.lenslet_focal_mm
        return length / matched * _sinc2_quantile(numbers)
    # Inside these radii an Airy pattern has these shares of its light (Rayleigh).
    radii = np.interp(numbers[:, 0], _airy_shares, _steps)
    radius = length / (2 * _exit_radius(camera)) * radii
    angle = 2 * np.pi * numbers[:, 1]
    return radius[:, None] * np.stack([np.sin(angle), np.cos(angle)], axis=1)


# Flat layers as a whole: a pixel's rays fill a unit square along each axis, the place a on the
# lenslet times the place b on the pixel, and meet a layer at `middle + wide a + narrow b`.


def _bundles(layer: Layer, camera: PlenopticCamera, axis: int):
    """Middles (views, lenslets) of the bundles on a layer, upright; widths by lenslet and pixel.

    The ray through height y of the array and h of the main lens crosses the focal plane at
    ``-y a0 / i0``, the conjugate of y, and continues straight to the layer.
    """
    a0, i0, focal = camera.focus_distance_mm, _image_distance(camera), camera.lenslet_focal_mm

    def on_layer(y, h):
        focused = -y * a0 / i0
        return focused + (focused - h) * layer.depth_mm / a0

    lenslets, views = camera.lenslets[axis], camera.views
    y = (np.arange(lenslets) - (lenslets - 1) / 2) * camera.lenslet_pitch_mm
    h = -(np.arange(views)[:, None] - (views - 1) / 2) * _pixel_mm(camera) * i0 / focal
    pitch = camera.lenslet_pitch_mm  # a place on the lenslet moves the ray on the main lens, too
    return -on_layer(y, h), on_layer(pitch, pitch), on_layer(0.0, -_pixel_mm(camera) * i0 / focal)


def _hidden(card, layer, camera):
    """Light of a layer that a card in front of it hides, shape (v, u, t, s)."""
    rows, columns = (_shares(card, layer, camera, axis) for axis in (0, 1))
    opacity, views = np.broadcast_to(card.opacity, card.texture.shape), 0.0
    for row, opaque in zip(np.moveaxis(rows, 2, 0), opacity, strict=True):
        column = np.einsum("usij,i->usj", columns, opaque)
        views = views + np.einsum("vti,ij,usj->vuts", row, layer.texture, column, optimize=True)
    return views


def _shares(card, layer, camera, axis):
    """Share of each bundle that meets a cell of both, (views, lenslets, card's, layer's cells)."""
    found = [_bundles(one, camera, axis) for one in (card, layer)]
    widths = np.array([bundle[1:] for bundle in found])
    if np.abs(widths[:, 0]).min() > np.abs(widths[:, 1]).min():  # in focus: no edge by b
        widths = widths[:, ::-1]
    edges = []
    for one, bundle in zip((card, layer), found, strict=True):
        cells = one.texture.shape[axis]
        across = (np.arange(cells + 1) / cells - 0.5) * one.size_mm[axis]
        edges.append(one.centre_mm[axis] + across - bundle[0][..., None])
    below = [  # view by view, edge by edge of the card, to save memory
        [_area_below((edge[:, None], beyond), widths) for edge in view.T]
        for view, beyond in zip(*edges, strict=True)
    ]
    return np.diff(np.diff(np.moveaxis(below, 1, 2), axis=2), axis=3)


def _area_below(edges, widths):
    """Area of the unit square where ``w[0] a + w[1] b`` lies below both edges.

    For each a the places b form an interval, whose length is linear between the a where an edge
    enters or leaves the square or two cross: the trapezoid rule between these is exact.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        height = [edge / w[1] for edge, w in zip(edges, widths, strict=True)]
        slope = [-w[0] / w[1] for w in widths]
        bends = [(side - h) / m for h, m in zip(height, slope, strict=True) for side in (-0.5, 0.5)]
        bends.append((height[1] - height[0]) / (slope[0] - slope[1]))
    a = np.nan_to_num(np.stack(np.broadcast_arrays(-0.5, *bends, 0.5)))
    a = np.sort(np.clip(a, -0.5, 0.5), axis=0)
    low, high = np.full_like(a, -0.5), np.full_like(a, 0.5)
    for h, m, w in zip(height, slope, widths, strict=True):
        edge = np.clip(h + m * a, -0.5, 0.5)
        low, high = (low, np.minimum(high, edge)) if w[1] > 0 else (np.maximum(low, edge), high)
    length = np.maximum(high - low, 0)
    return ((length[1:] + length[:-1]) / 2 * np.diff(a, axis=0)).sum(axis=0)


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
