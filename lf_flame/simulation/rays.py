"""The ray integrator: each pixel's bundle traced backward, with every effect.

The positions of the rays are laid out along one axis at a time (`ray_grid`), and put into the
tables that the kernels read (`lf_flame.simulation.ray_tables`).
"""

import math

import numpy as np

from lf_flame._common import progress
from lf_flame.optics.ray_bundle import Footprint, lenslet_places_mm
from lf_flame.simulation import _ray_kernels
from lf_flame.simulation.optical_pass import Layout, OpticalPass, arrange
from lf_flame.simulation.ray_tables import (
    LensletTables,
    MicroImageTable,
    PlaneRays,
    PlaneTable,
    RayFalloffTable,
    RayGrid,
    RayTable,
    SeenTable,
    ShiftTable,
    SquareTable,
    StopRays,
    StopTable,
    Tiling,
    TiltTable,
    WeightTable,
)
from lf_flame.simulation.slabs import Plane

LENSLET_FINER = 1.5
"""Ratio of tiles along the lenslet to tiles along the pixel where the images of both are equally
wide; by trial, about this ratio takes the fewest rays."""

CELLS_AT_ONCE = 1 << 30
"""Number of crossings of rays and cells between steps of the progress bar: a few seconds."""


def trace(
    planes: list[Plane], optics: OpticalPass, layout: Layout, rays: int, out: np.ndarray
) -> None:
    """Add planes of light by backward rays, about rays x rays for each pixel.

    A ray represents the part of the bundle around it: its box on a plane takes the mean of the
    cells that it covers. Without boxes an edge inside a pixel is off by up to half a ray's share,
    and the error falls only as 1 / rays.

    Planes are given front to back; if none attenuates another, each is traced alone, where it is
    seen. rays: smallest number along each axis, rounded up so that they tile pixel and lenslet. The
    light is added to `out`, float32 or float64 in the order of the layout.
    """
    front = _first_attenuating(planes)
    for group in [*([plane] for plane in planes[:front]), planes[front:]]:
        if not group:
            continue
        y, x = (ray_grid(group, optics, layout, rays, axis) for axis in (0, 1))
        find = _lenslet_tables if optics.every_lenslet else _own_tables
        kernel, tables = find(group, optics, layout, y, x)
        first, beyond = x.seen.argmax(axis=1), x.seen[:, ::-1].argmax(axis=1)
        seen = SeenTable(y.seen, first, x.seen.any(axis=1) * (x.seen.shape[1] - beyond))
        share = optics.share / (y.rays * x.rays)
        runs = _runs(out.shape[2], out.size * y.rays * x.rays * len(group))
        bar = progress.steps(runs, "tracing rays", len(runs)) if len(runs) > 1 else runs
        for some in bar:
            lines = np.zeros_like(seen.lines)  # those of this run alone
            lines[:, some] = seen.lines[:, some]
            kernel(*tables, seen._replace(lines=lines), share, out)


def ray_grid(
    planes: list[Plane], optics: OpticalPass, layout: Layout, rays: int, axis: int
) -> RayGrid:
    """Lay the rays of all bundles over given planes along an axis, at least `rays` per pixel."""
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
    their cells in one tile are taken as independent: tiles then shrink along both, to images about
    as wide as long on the planes, unless cells or a stop require narrower tiles along the pixel.

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

    The covariance of a tile's positions on two planes is the product of its images on both, summed
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
    """Positions of all rays on a plane, [e, f, i]; the pixel is a point if not `wide`."""
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
    # The light of a lenslet reaches no farther from the pixel, whose own may be displaced.
    if optics.every_lenslet:
        tangent = abs(optics.lenslet_tangent)
        micro_image = optics.camera.views * optics.camera.pixel_mm / 2
        moved = micro_image + optics.micro_image_reach_mm * (1 + tangent)
        moved += np.abs(lenslet_places_mm(optics.camera, axis)) * abs(optics.lenslet_scale - 1)
        reach = reach + moved * abs(footprint.shift_per_lenslet_shift)
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


def _first_attenuating(planes: list[Plane]) -> int:
    """Count the planes in front of the first that attenuates light."""
    return next((k for k, p in enumerate(planes) if p.transmission is not None), len(planes))


def _lenslet_tables(planes, optics: OpticalPass, layout: Layout, y, x) -> tuple:
    """Return the kernel for light through every lenslet, and its tables."""
    stop, second = _stop_tables(optics, y, x)
    # Shifts of lenslets along y and x by a rotated array, by their position on the other axis.
    skews = [
        arrange(np.tile(optics.skew_mm(axis), (optics.camera.views, 1)), layout, 1 - axis)
        for axis in (0, 1)
    ]
    focal_mm = optics.camera.lenslet_focal_mm
    tilt = TiltTable(
        -skews[0] / focal_mm, -skews[1] / focal_mm, -optics.lenslet_pitch_mm / focal_mm
    )
    tables = LensletTables(
        planes=_plane_table(planes, y.planes, x.planes, optics, layout),
        rays=RayTable(y.planes.positions, x.planes.positions, y.planes.boxes, x.planes.boxes),
        shifts=_shift_table(planes, y, x, optics, skews),
        stop=stop,
        second=second,
        micro_images=_micro_image_table(optics, layout, skews),
        squares=_square_table(y.tiling, x.tiling, optics),
        falloff=_falloff_table(y.tiling, x.tiling, optics, layout),
        tilt=tilt if optics.falloff else None,
    )
    return _ray_kernels.trace_lenslets, (tables,)


def _own_tables(planes, optics: OpticalPass, layout: Layout, y, x) -> tuple:
    """Return the kernel for light through each pixel's own lenslet, and its tables."""
    table = _plane_table(planes, y.planes, x.planes, optics, layout)
    stop, second = _stop_tables(optics, y, x)
    falloff = _falloff_table(y.tiling, x.tiling, optics, layout)
    # Positions become indices once, outside the ray loop.
    rows, down = _indices(y.planes)
    columns, right = _indices(x.planes)
    stride, first = table.stride[:, None, None, None], table.first[:, None, None, None]
    rows, columns = (rows * stride + first).astype(np.int32), columns.astype(np.int32)
    rays = RayTable(rows, columns, y.planes.boxes, x.planes.boxes)
    weights = WeightTable(down, right)
    bounded = table.transmission is not None or stop is not None or falloff is not None
    if not bounded:
        return _ray_kernels.trace_apart, (table, rays, weights)
    return _ray_kernels.trace_planes, (table, rays, weights, stop, second, falloff)


def _stop_tables(optics: OpticalPass, y: RayGrid, x: RayGrid) -> list[StopTable | None]:
    """Tables of the first and of the second round stop; None where there is no such stop."""
    stops = [
        StopTable(
            y.stops.places_mm[k],
            x.stops.places_mm[k],
            radius,
            y.stops.boxes_mm[k],
            x.stops.boxes_mm[k],
        )
        for k, (_, radius) in enumerate(optics.stops)
    ]
    return [*stops, None, None][:2]


def _runs(lines: int, cells: int) -> list[slice]:
    """Split lines into runs of about CELLS_AT_ONCE crossings each."""
    ends = np.linspace(0, lines, min(math.ceil(cells / CELLS_AT_ONCE), lines) + 1).astype(int)
    return [slice(first, last) for first, last in zip(ends, ends[1:], strict=False)]


def _falloff_table(
    y: Tiling, x: Tiling, optics: OpticalPass, layout: Layout
) -> RayFalloffTable | None:
    """Tangents of all rays, or None without cos^4."""
    if not optics.falloff:
        return None
    rows, columns = (arrange(optics.tangents(axis), layout, axis) for axis in (0, 1))
    pixel = optics.camera.pixel_mm / optics.camera.lenslet_focal_mm
    boxes = pixel / y.on_pixel, pixel / x.on_pixel
    return RayFalloffTable(
        rows,
        columns,
        -pixel * y.along_pixel,  # on upright images rays run the other way than on the sensor
        -pixel * x.along_pixel,
        patch=(boxes[0] ** 2 + boxes[1] ** 2) / 12,
    )


def _shift_table(planes, y: RayGrid, x: RayGrid, optics: OpticalPass, skews) -> ShiftTable:
    """Shifts by displaced lenslets, and by the rotation of each lenslet's own square."""
    tangent = optics.lenslet_tangent
    leans = [np.array([optics.strip_gain(p, axis)[1] for p in planes]) for axis in (0, 1)]
    return ShiftTable(
        rows=skews[0],
        columns=skews[1],
        pitch=optics.lenslet_pitch_mm,
        plane_rows=y.planes.gains,
        plane_columns=x.planes.gains,
        lean_rows=leans[0],
        lean_columns=leans[1],
        turned_rows=tangent * y.planes.lenslet_cells[:, None] * x.tiling.along_lenslet,
        turned_columns=-tangent * x.planes.lenslet_cells[:, None] * y.tiling.along_lenslet,
        stops=y.stops.gains,
    )


def _micro_image_table(optics: OpticalPass, layout: Layout, skews) -> MicroImageTable:
    """Positions of all pixels in the micro-images of their lenslets."""
    side, turned = optics.micro_image_mm, math.atan(optics.lenslet_tangent)
    rows, columns = (arrange(optics.offsets_mm(axis) / side, layout, axis) for axis in (0, 1))
    return MicroImageTable(
        rows,
        columns,
        shift_rows=-skews[0] / optics.lenslet_pitch_mm,
        shift_columns=-skews[1] / optics.lenslet_pitch_mm,
        cosine=math.cos(turned),
        sine=math.sin(turned),
        # Micro-images that only touch the pixel send no light.
        reach=optics.micro_image_reach_mm / side - 1e-9,
    )


def _square_table(y: Tiling, x: Tiling, optics: OpticalPass) -> SquareTable | None:
    """Positions of the rays on a pixel, where micro-images are squares."""
    if not optics.square_micro_images:
        return None
    pixel = optics.camera.pixel_mm / optics.micro_image_mm
    return SquareTable(
        -pixel * y.along_pixel,  # as for the falloff
        -pixel * x.along_pixel,
        pixel / y.on_pixel,
        pixel / x.on_pixel,
        pixel,
    )


def _plane_table(
    planes: list[Plane], y: PlaneRays, x: PlaneRays, optics: OpticalPass, layout: Layout
) -> PlaneTable:
    """Put the cells of all planes into one table, each on the edges of the rays' grids."""
    height, width = y.cells, x.cells
    sizes = (height + 2) * (width + 2)
    first = np.concatenate([[0], np.cumsum(sizes)[:-1]])
    edges = list(zip(y.edges_mm, x.edges_mm, strict=True))
    emission = [
        _bordered(_averaged(plane.emission, plane, new), 0.0)
        for plane, new in zip(planes, edges, strict=True)
    ]
    transmission = _transmission(planes, edges)
    gains = [
        np.stack([arrange(optics.strip_gain(plane, axis)[0], layout, axis) for plane in planes])
        for axis in (0, 1)
    ]
    return PlaneTable(
        np.concatenate(emission), transmission, first, width + 2, height, width, gains[0], gains[1],
        np.array([plane.sheet for plane in planes]),
    )  # fmt: skip


def _indices(grid: PlaneRays) -> tuple[np.ndarray, np.ndarray]:
    """First cell of each ray, counted from the border at 0, and the weight of the next."""
    boxes, cells = grid.boxes[:, None, None, None], grid.cells[:, None, None, None]
    start = np.floor(grid.positions - boxes / 2)
    missed = (start < -1) | (start >= cells)
    index = np.where(missed, 0, start + 1).astype(np.int64)
    weight = (grid.positions + boxes / 2 - index) / np.maximum(boxes, 1e-12)
    return index, np.where(missed, 0.0, np.clip(weight, 0.0, 1.0))


def _transmission(planes: list[Plane], edges: list) -> np.ndarray | None:
    if all(plane.transmission is None for plane in planes):
        return None
    found = []
    for plane, new in zip(planes, edges, strict=True):
        stopped = np.zeros_like(plane.emission)
        if plane.transmission is not None:
            stopped = 1 - plane.transmission
        found.append(_bordered(1 - _averaged(stopped, plane, new), 1.0))
    return np.concatenate(found)


def _averaged(cells: np.ndarray, plane: Plane, edges: tuple) -> np.ndarray:
    """Average cells exactly over coarser ones; outside the plane all values are 0."""
    for axis in (0, 1):
        old, new = plane.layer.cell_edges_mm[axis], edges[axis]
        if new.size == old.size and new[0] == old[0]:
            continue
        # Differences of the sum up to each new edge, in which the sum is linear over a cell.
        cell, lines = old[1] - old[0], np.moveaxis(cells, axis, 0)
        places = np.clip((new - old[0]) / cell, 0, len(lines))
        whole = np.minimum(places.astype(int), len(lines) - 1)
        sums = np.cumsum(lines, axis=0)[whole] + (places - whole - 1)[:, None] * lines[whole]
        cells = np.moveaxis(np.diff(sums, axis=0) * (cell / (new[1] - new[0])), 0, axis)
    return cells


def _bordered(cells: np.ndarray, border: float) -> np.ndarray:
    """Cells with a border around them for rays that miss the plane, flat."""
    return np.pad(cells, 1, constant_values=border).ravel()
