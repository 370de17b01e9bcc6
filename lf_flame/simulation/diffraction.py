"""Diffraction in images: at the lenslets a blur on the sensor, at the main lens one of the planes.

Light that diffraction at the main lens displaces on the lenslet array keeps its direction. Along
this direction, its new point on the array sees another point of the plane. It is therefore the same
as a blur of the plane's cells by the image of the diffraction pattern on the plane, for lenslets of
any size. This is valid if light only adds up; planes that occlude or attenuate each other would
have to be blurred together.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from lf_flame.errors import InputError
from lf_flame.optics import diffraction
from lf_flame.optics.camera import PlenopticCamera
from lf_flame.optics.ray_bundle import trace_footprint
from lf_flame.scenes.scene import Layer
from lf_flame.simulation.optical_pass import beyond_mm, misplaced_mm, neighbours, true_pitch_mm
from lf_flame.simulation.slabs import Plane

SAME_PITCH = 1e-9
"""Relative difference at which pixels still tile a micro-image."""

COLUMNS_AT_ONCE = 256
"""Number of columns of an image that are held as float64 at a time."""

MOST_TILES = 2**30
"""Largest number of tiles of the whole sensor; more would fill the memory."""

Interval = tuple[float, float]

CELLS = 8
"""Cells under the image of a lenslet, at least: each is taken as even after the blur, too."""

MARGIN = 200
"""Spreads of the pattern beside the light that stay dark, so that almost none comes back from the
other side of the transform: beyond them lies 5e-4 of a line's light, on each side half of it."""

MOST_DARK = 2048
"""Largest number of cells of that margin; patterns far wider than a lenslet get a narrower one."""

MOST_CELLS = 4096
"""Largest number of cells of a plane along each axis; beyond it, cells are wider."""


def lenslet_share_leaving(camera: PlenopticCamera) -> float:
    """Fraction of an evenly lit pixel's light that lenslet diffraction brings from others."""
    return diffraction.share_leaving_square(_spread_mm(camera), camera.pixel_mm, False)


def leaves_gaps(camera: PlenopticCamera) -> bool:
    """Whether there is light between the pixels of neighbouring micro-images."""
    return camera.views * camera.pixel_mm < camera.micro_image_pitch_mm * (1 - SAME_PITCH)


def tiled_sensor(
    camera: PlenopticCamera, parts: int = 1, *, limited: bool = True
) -> PlenopticCamera:
    """Camera whose pixels leave no gaps: tiles at most as wide as these parts of the pixels.

    Raises
    ------
    InputError
        If too many tiles are needed, and their number is limited.
    """
    ratio = camera.micro_image_pitch_mm / camera.pixel_mm * parts
    tiles = max(math.ceil(ratio * (1 - SAME_PITCH)), camera.views * parts)
    if limited and tiles**2 * math.prod(camera.lenslets) > MOST_TILES:
        raise InputError(
            f"Diffraction of lenslets needs the light under each in {tiles} x {tiles} tiles, which "
            f"is too many; use a larger pixel_pitch_mm or tolerance, or force lenslet_diffraction "
            f"off."
        )
    return replace(camera, views=tiles, pixel_pitch_mm=None)


def blur_on_sensor(
    tiles: np.ndarray, tiled: PlenopticCamera, camera: PlenopticCamera
) -> np.ndarray:
    """Let the lenslets diffract a raw image on tiles, and let the pixels gather it: a raw image.

    The light is assumed even over each tile. Beyond the border the outermost tiles are repeated.
    tiled: camera of the tiles, from `tiled_sensor`; camera: that of the pixels.
    """
    image = tiles
    for axis, lenslets in enumerate(camera.lenslets):
        lines = np.moveaxis(image, axis, 0)
        found = np.empty((lenslets * camera.views, lines.shape[1]), np.float32)
        for low in range(0, lines.shape[1], COLUMNS_AT_ONCE):
            part = np.s_[:, low : low + COLUMNS_AT_ONCE]
            blurred = diffraction.blur_lines(lines[part], _spread_mm(camera), tiled.pixel_mm)
            found[part] = _pixel_means(blurred, tiled, camera, lenslets)
        image = np.moveaxis(found, 0, axis)
    return np.ascontiguousarray(image)


def _pixel_means(
    lines: np.ndarray, tiled: PlenopticCamera, camera: PlenopticCamera, lenslets: int
) -> np.ndarray:
    """Take the means of tiles over the pixels, along the first axis.

    Where tiles do not lie on pixels, as differences of their sum, which is interpolated between the
    edges of tiles by cubics: what was blurred is smooth there.
    """
    if not leaves_gaps(camera):
        return lines.reshape(lenslets * camera.views, -1, lines.shape[1]).mean(axis=1)
    tiles_of_pixel = camera.pixel_mm / tiled.pixel_mm
    views = np.arange(camera.views + 1) - camera.views / 2
    edges = (np.arange(lenslets)[:, None] + 0.5) * tiled.views + views * tiles_of_pixel
    around = np.pad(lines, ((2, 2), (0, 0)), "edge")
    sums = np.cumsum(around, axis=0)  # up to the end of each tile
    here = np.floor(edges + SAME_PITCH).astype(int)
    part = np.maximum(edges - here, 0)
    part[part < SAME_PITCH] = 0
    up_to = np.zeros((*edges.shape, lines.shape[1]))
    for step, weight in zip((-1, 0, 1, 2), _cubic(part), strict=True):
        up_to += weight[..., None] * sums[here + step + 1]
    means = np.diff(up_to, axis=1) / tiles_of_pixel
    return means.reshape(-1, lines.shape[1])


def _cubic(part: np.ndarray) -> tuple[np.ndarray, ...]:
    """Weights of Lagrange's cubic through -1, 0, 1 and 2."""
    before, after, far = part + 1, part - 1, part - 2
    return (
        -part * after * far / 6,
        before * after * far / 2,
        -before * part * far / 2,
        before * part * after / 6,
    )


def _spread_mm(camera: PlenopticCamera) -> float:
    return _wavelength_mm(camera) * camera.lenslet_focal_mm / true_pitch_mm(camera)


def _wavelength_mm(camera: PlenopticCamera) -> float:
    """Wavelength of a camera in mm; refuse a camera without one."""
    if camera.wavelength_nm is None:
        raise InputError("Diffraction needs the camera's wavelength_nm, got none.")
    return camera.wavelength_nm * 1e-6


def main_lens_spread_mm(camera: PlenopticCamera) -> float:
    """Spread of the main lens's pattern on the lenslet array: wavelength times distance / width.

    Raises
    ------
    InputError
        If the camera has no wavelength.
    """
    width = camera.on_exit_pupil(camera.aperture_diameter_mm or camera.aperture_mm)
    return _wavelength_mm(camera) * camera.exit_distance_mm / width


def main_lens_share_leaving(camera: PlenopticCamera) -> float:
    """Share of the light on a pixel of a view, where it is even, that diffraction moves out."""
    spread = main_lens_spread_mm(camera)
    return diffraction.share_leaving_square(spread, camera.grid_pitch_mm, _is_round(camera))


def blur_whole_lenslets(views: np.ndarray, camera: PlenopticCamera) -> np.ndarray:
    """Blur views by diffraction at the main lens, as if light were even over each pixel."""
    spread, pitch = main_lens_spread_mm(camera), camera.grid_pitch_mm
    return diffraction.blur_views(views, spread, pitch, _is_round(camera))


def _is_round(camera: PlenopticCamera) -> bool:
    return camera.aperture_diameter_mm is not None


def gain_on_layer(camera: PlenopticCamera, depth_mm: float) -> float:
    """Displacement on a layer per mm on the array, of a ray that keeps its direction there."""
    footprint = trace_footprint(camera, depth_mm, 1)
    return abs(footprint.lenslet_width_mm) / camera.lenslet_pitch_mm


def blur_planes(planes: list[Plane], camera: PlenopticCamera) -> list[Plane]:
    """Blur what planes emit by diffraction at the main lens, as far as the camera sees.

    None of the planes may attenuate another.
    """
    layers = (blur_layer(p.layer, p.emission, camera, p.depth_mm) for p in planes)
    return [replace(p, emission=x.texture, layer=x) for p, x in zip(planes, layers, strict=True)]


def blur_layer(
    layer: Layer, emission: np.ndarray, camera: PlenopticCamera, depth_mm: float
) -> Layer:
    """Blur the light of a layer at a depth by diffraction, as far as the camera sees.

    The result has cells of its own.
    """
    gain = gain_on_layer(camera, depth_mm)
    spread = main_lens_spread_mm(camera) * gain
    if not (spread > 0 and emission.any()):
        return Layer(emission, depth_mm, layer.size_mm, layer.centre_mm)
    wanted = gain * camera.lenslet_pitch_mm / CELLS
    grids = []
    for axis in (0, 1):
        lit, seen = layer.extent_mm(emission, axis), _seen_mm(camera, depth_mm, axis)
        grids.append(_Grid.over(layer.cell_edges_mm[axis], lit, seen, spread, wanted))
    cells = emission
    for axis, grid in enumerate(grids):
        cells = grid.cut(cells, axis)
    (top, left), (height, width) = zip(*(grid.place_mm for grid in grids), strict=True)
    blurred = diffraction.blur_cells(
        cells,
        spread,
        (grids[0].cell_mm, grids[1].cell_mm),
        _is_round(camera),
        (grids[0].wanted, grids[1].wanted),
        (grids[0].dark, grids[1].dark),
    )
    return Layer(blurred, depth_mm, (height, width), (top + height / 2, left + width / 2))


@dataclass(frozen=True)
class _Grid:
    """Cells along one axis on which the light of a layer is blurred."""

    first: int  # first of the layer's cells that can send light to where it is wanted
    last: int  # one after the last
    parts: int  # into how many each is cut
    merged: int  # how many of these make one
    cell_mm: float
    wanted: tuple[int, int]  # first cell that is wanted and one after the last, from `first`
    dark: int  # cells around all these that stay dark
    start_mm: float  # where `first` begins

    @classmethod
    def over(
        cls, edges: np.ndarray, lit: Interval, window: Interval, spread: float, wanted: float
    ) -> "_Grid":
        """Lay the grid on the edges of a layer's cells.

        lit: where there is light; window: where it is wanted; wanted: width of the cells, in mm.
        """
        cell, count = float(edges[1] - edges[0]), edges.size - 1
        reach = MARGIN * spread
        low, high = max(window[0], lit[0] - reach), min(window[1], lit[1] + reach)
        high = max(low, high)
        first = min(max(math.floor((low - reach - edges[0]) / cell), 0), count - 1)
        last = min(max(math.ceil((high + reach - edges[0]) / cell), first + 1), count)
        whole = max((high - low) / cell, last - first)
        parts = max(1, min(math.ceil(cell / wanted), int(MOST_CELLS / whole)))
        merged = math.ceil(whole / MOST_CELLS)
        fine, start = cell * merged / parts, float(edges[first])
        begin = math.floor((low - start) / fine)
        end = max(math.ceil((high - start) / fine), begin + 1)
        dark = math.ceil(min(reach / fine, MOST_DARK))
        return cls(first, last, parts, merged, fine, (begin, end), dark, start)

    def cut(self, cells: np.ndarray, axis: int) -> np.ndarray:
        """Take the cells of this grid from those of the layer, along an axis."""
        near = np.moveaxis(cells, axis, 0)[self.first : self.last].repeat(self.parts, 0)
        beyond = np.zeros((-near.shape[0] % self.merged, near.shape[1]))
        merged = np.concatenate([near, beyond]).reshape(-1, self.merged, near.shape[1]).mean(axis=1)
        return np.moveaxis(merged, 0, axis)

    @property
    def place_mm(self) -> tuple[float, float]:
        """Start and width of the wanted part."""
        begin, end = self.wanted
        return self.start_mm + begin * self.cell_mm, (end - begin) * self.cell_mm


def _seen_mm(camera: PlenopticCamera, depth_mm: float, axis: int) -> tuple[float, float]:
    """First and last point on a layer that a pixel can see, through any lenslet, in any colour."""
    low, high = math.inf, -math.inf
    for colour in (-0.5, 0.5) if camera.chromatic_shift else (0.0,):
        focal_mm = camera.main_lens_focal_mm * (1 + camera.chromatic_shift * colour)
        footprint = trace_footprint(camera, depth_mm, axis, focal_mm)
        aside = beyond_mm(camera) + sum(misplaced_mm(camera))
        # At the edge of the array pixels see through lenslets beyond it, too.
        aside += max(neighbours(camera), any(misplaced_mm(camera))) * true_pitch_mm(camera)
        # With one box beyond: of a ray, or of a hexagon, which is read from its neighbours.
        reach = 3 * footprint.half_width_mm + abs(footprint.shift_per_lenslet_shift) * aside
        low = min(low, footprint.centres_mm.min() - reach)
        high = max(high, footprint.centres_mm.max() + reach)
    return low, high
