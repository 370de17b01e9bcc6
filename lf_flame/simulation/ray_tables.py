"""Rays of all bundles, and the tables of them that the kernels read.

Numba takes these named tuples as they are. In their shapes (a, c) is the place of a pixel along y
and (b, d) along x, as in `lf_flame.simulation.optical_pass`: a and b count views, c and d rows and
columns. i and j count a pixel's rays along y and x, p the planes from front to back, k the stops.
Arrays are float64 where nothing else is said. The places of the rays are laid out along one axis at
a time, by `ray_grid`.
"""

import math
from typing import NamedTuple

import numpy as np

from lf_flame.optics.ray_bundle import Footprint
from lf_flame.simulation.optical_pass import Layout, OpticalPass, arrange
from lf_flame.simulation.slabs import Plane

LENSLET_FINER = 1.5
"""Ratio of tiles along the lenslet to tiles along the pixel where the images of both are equally
wide; by trial, about this ratio takes the fewest rays."""


class PlaneTable(NamedTuple):
    """The cells of all planes, one plane behind the other in memory, row by row.

    Around each plane there is a border of one cell, for the rays that miss it: it emits nothing and
    lets all light pass.
    """

    emission: np.ndarray  # (all cells,)
    transmission: np.ndarray | None  # (all cells,); None where the light of one plane only adds
    first: np.ndarray  # int64, (p,): first cell of a plane
    stride: np.ndarray  # int64, (p,): its cells in a row, borders included
    height: np.ndarray  # int64, (p,): its rows without the border
    width: np.ndarray  # int64, (p,): its columns without the border
    # Factors of a plane's light in each pixel: of strips of a sheet that leans, else 1.
    down: np.ndarray  # (p, a, c)
    right: np.ndarray  # (p, b, d)
    sheet: np.ndarray  # int64, (p,): sheet of which a plane is a strip, from 1 on; 0 for others


class RayTable(NamedTuple):
    """Where the rays meet the planes.

    The sum of row and column is the cell of plane p in which the box of ray (i, j) begins. With
    shifts they are the middle of the box, in cells of the plane without its border.
    """

    rows: np.ndarray  # int32, or float64 with shifts, (p, a, c, i)
    columns: np.ndarray  # the same, (p, b, d, j)
    heights: np.ndarray  # (p,): size of a ray's box in cells, at most 1
    widths: np.ndarray  # (p,)


class WeightTable(NamedTuple):
    """Share of a ray's box on the cells below, and to the right of, that in which it begins."""

    down: np.ndarray  # (p, a, c, i)
    right: np.ndarray  # (p, b, d, j)


class ShiftTable(NamedTuple):
    """Shifts of bundles by lenslets that are not where the sensor is read."""

    # By a turned array, in cells of each plane: by the lenslet's place on the other axis.
    rows: np.ndarray  # (p, b, d)
    columns: np.ndarray  # (p, a, c)
    # By the turn of each lenslet's own square: by the ray's place on the other axis.
    turned_rows: np.ndarray  # (p, j)
    turned_columns: np.ndarray  # (p, i)
    # For each lenslet pitch.
    pitch_rows: np.ndarray  # (p,)
    pitch_columns: np.ndarray  # (p,)
    # On each stop, in mm. (There, a lenslet's own turn is a ten thousandth of the stop at most.)
    stop_rows: np.ndarray  # (k, b, d)
    stop_columns: np.ndarray  # (k, a, c)
    stop_pitch: np.ndarray  # (k,)


class StopTable(NamedTuple):
    """A round stop, and the places where rays cross it, in mm from the optical axis."""

    rows: np.ndarray  # (a, c, i)
    columns: np.ndarray  # (b, d, j)
    radius: float
    height: float  # of a ray's box; below 0 where it lies upside down
    width: float


class RayFalloffTable(NamedTuple):
    """Tangents of the rays behind the main lens, for cos^4."""

    rows: np.ndarray  # (a, c), of the pixels' central rays
    columns: np.ndarray  # (b, d)
    down: np.ndarray  # (i,): difference of each ray's tangent from the central ray's
    right: np.ndarray  # (j,)
    patch: float  # mean of the squares over a ray's patch of the main lens, from its middle


class TiltTable(NamedTuple):
    """Change of the rays' tangents by lenslets that are not where the sensor is read."""

    rows: np.ndarray  # (b, d), by a turned array
    columns: np.ndarray  # (a, c)
    pitch: float  # for each lenslet pitch


class MicroImageTable(NamedTuple):
    """Places of pixels on the sensor, for light through every lenslet that can send them any.

    From the middle of their lenslet's micro-image, in the pitch of the micro-images.
    """

    rows: np.ndarray  # (a, c)
    columns: np.ndarray  # (b, d)
    shift_rows: np.ndarray  # (b, d): change by a turned array
    shift_columns: np.ndarray  # (a, c)
    cosine: float  # of the angle by which the array is turned
    sine: float
    reach: float  # largest distance, along an axis of the array, at which a pixel gets any light


class SquareTable(NamedTuple):
    """Rays on a pixel where micro-images are squares, in the pitch of the micro-images."""

    down: np.ndarray  # (i,): middles of the rays' boxes on the sensor, from the pixel's
    right: np.ndarray  # (j,)
    height: float  # of a ray's box on the sensor
    width: float
    pixel: float  # width of a pixel


class LensletTables(NamedTuple):
    """Tables of the kernel for light through every lenslet that can send a pixel any."""

    planes: PlaneTable
    rays: RayTable
    shifts: ShiftTable
    stop: StopTable | None
    second: StopTable | None
    micro_images: MicroImageTable
    squares: SquareTable | None  # None where round stops end the micro-images
    falloff: RayFalloffTable | None
    tilt: TiltTable | None


class SeenTable(NamedTuple):
    """Pixels that see at least one plane."""

    lines: np.ndarray  # bool, (a, c)
    first: np.ndarray  # int64, (b,): first place d
    last: np.ndarray  # int64, (b,): one past the last


class Tiling(NamedTuple):
    """Places of the rays on a pixel and on its lenslet, in widths of each, -1/2 to 1/2."""

    along_pixel: np.ndarray  # (i,)
    along_lenslet: np.ndarray  # (i,)
    on_pixel: int  # number of tiles
    on_lenslet: int


class PlaneRays(NamedTuple):
    """Rays on planes along one axis; p counts the planes, other letters as in `RayGrid`."""

    edges_mm: tuple[np.ndarray, ...]  # of cells: the layer's, or wider if finer than a ray's box
    positions: np.ndarray  # (p, e, f, i): middles of the rays' boxes, in cells from the first edge
    boxes: np.ndarray  # (p,): breadth of a ray's box in cells, 0 to 1
    gains: np.ndarray  # (p,): shift of bundles in cells, per mm by which their lenslets move
    lenslet_cells: np.ndarray  # (p,): image of the lenslet, signed as the rays' places on it
    cells: np.ndarray  # (p,): number of cells of each plane


class StopRays(NamedTuple):
    """Rays on stops along one axis; k counts the stops, other letters as in `RayGrid`."""

    places_mm: list[np.ndarray]  # [k], (e, f, i): middles of the rays' boxes
    boxes_mm: list[float]  # [k]: breadth of a ray's box, below 0 where it lies upside down
    gains: np.ndarray  # (k,): shift of bundles per shift of their lenslets


class RayGrid(NamedTuple):
    """Rays of all bundles along one axis, on planes and stops, in the order of an image.

    They tile the bundle's two widths, over the pixel and over the lenslet. A ray's box has the
    tile's variance, so that all boxes together have the mean and the variance of the trapezoid.
    In the shapes of its tables e and f are the image's axes along this one, (a, c) or (b, d), and i
    counts the rays.
    """

    planes: PlaneRays
    stops: StopRays
    seen: np.ndarray  # bool, (e, f): whether a pixel can see any of the planes
    tiling: Tiling
    rays: int  # number of rays of each pixel


def ray_grid(
    planes: list[Plane],
    optics: OpticalPass,
    layout: Layout,
    rays: int,
    axis: int,
) -> RayGrid:
    """Lay the rays of all bundles over some planes along an axis, at least so many for a pixel."""
    footprints = [optics.footprint(plane.depth_mm, axis) for plane in planes]
    edges = [plane.layer.cell_edges_mm[axis] for plane in planes]
    tiling = _tile(rays, _widths_in_cells(footprints, edges, optics), planes, optics)
    seen = [_meets(*one, optics, axis) for one in zip(footprints, edges, strict=True)]
    return RayGrid(
        planes=_on_planes(footprints, edges, tiling, optics, layout, axis),
        stops=_on_stops(tiling, optics, layout, axis),
        seen=np.any([arrange(pixels, layout, axis) for pixels in seen], axis=0),
        tiling=tiling,
        rays=tiling.along_pixel.size,
    )


def _on_planes(
    footprints, layer_edges, tiling: Tiling, optics: OpticalPass, layout: Layout, axis: int
) -> PlaneRays:
    """Lay the rays over planes, in cells of the layers or in wider ones."""
    # Without defocus a plane sees the pixel as a point; a stop never does.
    boxes_mm = np.array([_box_mm(one, tiling, optics.defocus) for one in footprints])
    edges_mm = tuple(
        _coarse_edges(edges, box) for edges, box in zip(layer_edges, boxes_mm, strict=True)
    )
    cell_mm = np.array([edges[1] - edges[0] for edges in edges_mm])
    positions = [
        (_hits_mm(footprint, tiling, optics.defocus, layout, axis) - edges[0]) / width
        for footprint, edges, width in zip(footprints, edges_mm, cell_mm, strict=True)
    ]
    return PlaneRays(
        edges_mm=edges_mm,
        positions=np.stack(positions),
        boxes=np.minimum(boxes_mm / cell_mm, 1.0),
        gains=_gains(footprints) / cell_mm,
        lenslet_cells=np.array([footprint.lenslet_width_mm for footprint in footprints]) / cell_mm,
        cells=np.array([edges.size - 1 for edges in edges_mm]),
    )


def _on_stops(tiling: Tiling, optics: OpticalPass, layout: Layout, axis: int) -> StopRays:
    """Lay the rays over the round stops of a pass."""
    stops = [optics.stop(distance, axis) for distance, _ in optics.stops]
    # On a stop the pixel's image is far wider than the lenslet's: its tiles alone do not overlap.
    return StopRays(
        places_mm=[_hits_mm(stop, tiling, True, layout, axis) for stop in stops],
        boxes_mm=[stop.pixel_width_mm / tiling.on_pixel for stop in stops],
        gains=_gains(stops),
    )


def _widths_in_cells(footprints, edges_mm, optics: OpticalPass) -> np.ndarray:
    """Images of lenslet and pixel on each plane, in its cells, shape (p, 2)."""
    cells_mm = np.array([edges[1] - edges[0] for edges in edges_mm])
    widths = [(f.lenslet_width_mm, f.pixel_width_mm * optics.defocus) for f in footprints]
    return np.abs(widths) / cells_mm[:, None]


def _tile(rays: int, widths: np.ndarray, planes: list[Plane], optics: OpticalPass) -> Tiling:
    """Tile pixel and lenslet.

    Tiles along the lenslet cover its image without a gap, so that the smallest number that fits the
    cells is enough, and all further rays go along the pixel. Where planes attenuate each other,
    their cells in one tile count as independent: tiles then shrink along both, to images about as
    wide as long on the planes, unless cells or a stop require narrower tiles along the pixel.

    rays: smallest number of rays; widths: images of lenslet and pixel in cells, shape (p, 2).
    """
    root = math.ceil(rays**0.5)
    cells, pixel_cells = widths.max(axis=0)
    on_pixel = root if optics.stops else min(math.ceil(pixel_cells), root)
    dims = any(plane.transmission is not None for plane in planes)
    balanced = math.sqrt(rays * LENSLET_FINER * _aspect(widths)) if dims else 0
    on_lenslet = min(math.ceil(min(balanced, rays)), rays // max(on_pixel, 1))
    on_lenslet = max(on_lenslet, math.ceil(min(cells, rays**0.5)), 1)
    if optics.stops:  # the edge of a stop cuts the lenslet's image, too: tiles as long as wide
        camera = optics.camera
        seen = round(math.sqrt(rays * camera.lenslet_pitch_mm / camera.view_step_mm))
        on_lenslet = max(on_lenslet, min(seen, root))
    spread = optics.defocus or optics.stops or optics.every_lenslet
    on_pixel = math.ceil(rays / on_lenslet) if spread else 1
    pixel_places, lenslet_places = ((np.arange(n) + 0.5) / n - 0.5 for n in (on_pixel, on_lenslet))
    return Tiling(
        np.repeat(pixel_places, on_lenslet), np.tile(lenslet_places, on_pixel), on_pixel, on_lenslet
    )


def _aspect(widths: np.ndarray) -> float:
    """Ratio of the lenslet's image to the pixel's, each a mean over all pairs of planes.

    The covariance of a tile's places on two planes is the product of its images on both, summed
    over the lenslet's tile and the pixel's.
    """
    pairs = np.triu_indices(len(widths), 1)
    lenslet, pixel = (np.outer(column, column)[pairs].sum() for column in widths.T)
    if pixel <= lenslet * 1e-18:
        return math.inf if lenslet else 0.0
    return math.sqrt(lenslet / pixel)


def _hits_mm(
    footprint: Footprint, tiling: Tiling, wide: bool, layout: Layout, axis: int
) -> np.ndarray:
    """Places of all rays on a plane, [e, f, i]; the pixel is a point if not `wide`."""
    pixel_mm = footprint.pixel_width_mm * wide
    offsets = footprint.lenslet_width_mm * tiling.along_lenslet + pixel_mm * tiling.along_pixel
    return arrange(footprint.centres_mm, layout, axis)[..., None] + offsets


def _box_mm(footprint: Footprint, tiling: Tiling, wide: bool) -> float:
    """Breadth of the box with the variance of a tile's image, a convolution of two boxes."""
    pixel_mm = footprint.pixel_width_mm * wide / tiling.on_pixel
    return math.hypot(footprint.lenslet_width_mm / tiling.on_lenslet, pixel_mm)


def _meets(
    footprint: Footprint, edges_mm: np.ndarray, optics: OpticalPass, axis: int
) -> np.ndarray:
    """Whether the bundle of a pixel can meet a plane, for each (view, lenslet)."""
    reach = footprint.half_width_mm
    if optics.every_lenslet:  # the light of a lenslet reaches no farther from the pixel
        tangent = abs(optics.lenslet_tangent)
        micro_image = optics.camera.views * optics.camera.pixel_mm / 2
        moved = micro_image + optics.micro_image_reach_mm * (1 + tangent)
        reach += moved * abs(footprint.shift_per_lenslet_shift)
        reach += tangent * abs(footprint.lenslet_width_mm) / 2
    centres = footprint.centres_mm
    return (centres + 1.5 * reach >= edges_mm[0]) & (centres - 1.5 * reach <= edges_mm[-1])


def _gains(footprints) -> np.ndarray:
    """Displacement of bundles on each plane, per displacement of their lenslets."""
    return np.array([footprint.shift_per_lenslet_shift for footprint in footprints])


def _coarse_edges(edges_mm: np.ndarray, box_mm: float) -> np.ndarray:
    """Edges of a layer's cells; cells finer than a ray's box give way to cells of its width."""
    length, cells = edges_mm[-1] - edges_mm[0], edges_mm.size - 1
    if box_mm * cells <= length:
        return edges_mm
    count = math.ceil(length / box_mm)
    return (edges_mm[0] + edges_mm[-1]) / 2 + (np.arange(count + 1) - count / 2) * box_mm
