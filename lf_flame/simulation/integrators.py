"""The two ways to integrate over each pixel's ray bundle: in closed form, and by tracing rays.

Both add the light of planes to an image ``[a, b, c, d]`` whose pixel has its place along y in
(a, c) and along x in (b, d): that is ``[v, u, t, s]`` for sub-aperture views, and the raw lenslet
image with a = b = 0. One kernel so writes either layout.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from lf_flame._common.arrays import centred
from lf_flame.optics.camera import PlenopticCamera
from lf_flame.optics.ray_bundle import Footprint, trace_footprint, trace_stop, trapezoid_cdf
from lf_flame.simulation import _kernels
from lf_flame.simulation.slabs import Plane

LINES_BYTES = 2**28
"""Memory for planes that are integrated along x together."""


@dataclass(frozen=True)
class Optics:
    """A camera as the kept effects leave it.

    Parameters
    ----------
    camera : PlenopticCamera
    focal_mm : float, optional
        Focal length of the main lens for the colour of this pass.
    share : float, optional
        Share of the light in this pass.
    defocus : bool, optional
        Whether a pixel's own width, hence a patch of the main lens, is integrated over.
    falloff : bool, optional
        Whether pixels dim by cos^4.
    lenslet_scale, lenslet_skew : float, optional
        Diagonal and other element of the lenslet grid's rotation and stretch.
    stops : tuple of (float, float), optional
        Distance in front of the main lens and radius of round stops, in mm.
    neighbour : (int, int), optional
        Light that comes through the lenslet this many rows and columns further on.
    """

    camera: PlenopticCamera
    focal_mm: float | None = None
    share: float = 1.0
    defocus: bool = True
    falloff: bool = False
    lenslet_scale: float = 1.0
    lenslet_skew: float = 0.0
    stops: tuple[tuple[float, float], ...] = ()
    neighbour: tuple[int, int] = field(default=(0, 0))

    def footprint(self, depth_mm: float, axis: int) -> Footprint:
        """Bundles of all pixels on a layer."""
        return trace_footprint(self.camera, depth_mm, axis, *self._grid(axis))

    def stop(self, distance_mm: float, axis: int) -> Footprint:
        """Bundles of all pixels on a stop."""
        return trace_stop(self.camera, distance_mm, axis, *self._grid(axis))

    def _grid(self, axis: int) -> tuple:
        return self.focal_mm, self.lenslet_scale, self.neighbour[axis]

    def skew_mm(self, axis: int) -> np.ndarray:
        """How far the rotated array moves each lenslet along `axis`, by its place on the other."""
        other = 1 - axis
        place = centred(self.camera.lenslets[other]) + self.neighbour[other]
        sign = 1 if axis == 0 else -1
        return sign * self.lenslet_skew * self.camera.lenslet_pitch_mm * place

    def squared_tangents(self, axis: int) -> np.ndarray:
        """Squared tangent of each pixel's central ray behind the main lens, shape (view, lenslet).

        The patch of the main lens that a pixel sees is `view_step_mm` wide; the light of the
        whole cone dims as that of its central ray, to second order in the cone's width.
        """
        camera = self.camera
        lenslet = centred(camera.lenslets[axis])[None, :] * camera.lenslet_pitch_mm
        patch = centred(camera.views)[:, None] * camera.view_step_mm
        # The patch is a sensor position, which the lenslet turns over.
        return ((lenslet + patch) / camera.image_distance_mm) ** 2


def integrate(planes: list[Plane], optics: Optics, layout: str, out: np.ndarray) -> None:
    """Add planes of light in closed form: ``Ky @ texture @ Kx.T`` for each, K banded.

    K holds the exact integrals of a pixel's trapezoid over the cells. Exact as long as light only
    adds and nothing but cos^4 weighs the rays of a bundle.

    Parameters
    ----------
    planes : list of Plane
    optics : Optics
        Without stops, skew and neighbour.
    layout : {"views", "raw"}
    out : ndarray of float32, shape [a, b, c, d]
    """
    batch, used = [], 0
    for plane in planes:
        rows = plane.emission.shape[0]
        if batch and used + rows * out.shape[1] * out.shape[3] * 8 > LINES_BYTES:
            _integrate_batch(batch, optics, layout, out)
            batch, used = [], 0
        batch.append(plane)
        used += rows * out.shape[1] * out.shape[3] * 8
    _integrate_batch(batch, optics, layout, out)


def _integrate_batch(planes, optics: Optics, layout: str, out: np.ndarray) -> None:
    bands = [
        [tuple(_arrange(part, layout) for part in _band(plane, optics, axis)) for plane in planes]
        for axis in (0, 1)
    ]
    heights = [plane.emission.shape[0] for plane in planes]
    lines = np.empty((sum(heights), out.shape[1], out.shape[3]))
    reach = np.zeros((2, len(planes), out.shape[1]), np.int64)
    top = 0
    for p, (plane, (start, weight)) in enumerate(zip(planes, bands[1], strict=True)):
        reach[:, p] = _reach(weight.any(axis=2))
        part = lines[top : top + heights[p]]
        _kernels.integrate_columns(plane.emission, start, weight, *reach[:, p], part)
        bands[0][p] = (bands[0][p][0] + top, bands[0][p][1] * optics.share)
        top += heights[p]
    most = max(weight.shape[2] for _, weight in bands[0])
    weights = np.zeros((len(planes), *bands[0][0][0].shape, most))
    for p, (_, weight) in enumerate(bands[0]):
        weights[p, ..., : weight.shape[2]] = weight
    starts = np.stack([start for start, _ in bands[0]])
    falloff, seen = _falloff(optics, layout), weights.any(axis=3)
    _kernels.integrate_rows(lines, starts, weights, falloff, seen, *reach, out)


def _band(plane: Plane, optics: Optics, axis: int) -> tuple[np.ndarray, np.ndarray]:
    """Share of each pixel's ray bundle that meets each cell, as (first cell, weights)."""
    footprint = optics.footprint(plane.depth_mm, axis)
    widths = [abs(footprint.lenslet_width_mm), abs(footprint.pixel_width_mm) * optics.defocus]
    return band_weights(plane.layer.cell_edges_mm(axis), footprint.centres_mm, *widths)


def band_weights(edges_mm: np.ndarray, centres_mm: np.ndarray, lenslet_mm: float, pixel_mm: float):
    """Exact integrals of trapezoids over cells: differences of their cumulative distribution.

    Parameters
    ----------
    edges_mm : ndarray, shape (cells + 1,)
        Evenly spaced edges of the cells.
    centres_mm : ndarray of any shape
        Where the trapezoids are centred.
    lenslet_mm, pixel_mm : float
        Widths of the two boxes whose convolution the trapezoid is.

    Returns
    -------
    start : ndarray of int64, shape of `centres_mm`
    weights : ndarray of float64, with a last axis of the band's cells
        The cell ``start + k`` has weight ``weights[..., k]``; a trapezoid inside the cells has a
        sum of 1.
    """
    cells, cell_mm = len(edges_mm) - 1, edges_mm[1] - edges_mm[0]
    reach = (lenslet_mm + pixel_mm) / 2
    band = int(min(cells, np.ceil(2 * reach / cell_mm) + 1))
    start = np.floor((centres_mm - reach - edges_mm[0]) / cell_mm)
    start = np.clip(start, 0, cells - band).astype(np.int64)
    edges = edges_mm[start[..., None] + np.arange(band + 1)]
    return start, np.diff(trapezoid_cdf(edges - centres_mm[..., None], lenslet_mm, pixel_mm))


def trace(
    planes: list[Plane],
    optics: Optics,
    layout: str,
    rays: int,
    out: np.ndarray,
    lines: slice = slice(None),
    thin: bool = True,
) -> None:
    """Add planes of light by backward rays, about rays x rays for each pixel.

    A ray stands for the part of the bundle around it: its box on a plane takes the mean of the
    cells that it lies on. Without that an edge inside a pixel is off by up
    to half a ray's share, and the error falls only as 1 / rays.

    Parameters
    ----------
    planes : list of Plane
        Front to back. If none dims another, each is traced alone, where it can be seen.
    optics : Optics
    layout : {"views", "raw"}
    rays : int
        Rays along each axis, at least; rounded up so that they tile pixel and lenslet.
    out : ndarray of float32, shape [a, b, c, d]
    lines : slice, optional
        The lines c of the whole image that `out` holds.
    thin : bool, optional
        False for rays without breadth, the plain midpoint rule.
    """
    dims = any(plane.transmission is not None for plane in planes)
    for group in [planes] if dims else [[plane] for plane in planes]:
        tables = [_Rays(group, optics, layout, rays, axis, thin) for axis in (0, 1)]
        _trace_group(group, optics, layout, tables, out, lines)


class _Rays:
    """Rays of all bundles along one axis, on planes and stops.

    They tile the bundle's two widths, over the pixel and over the lenslet. A ray's box has the
    tile's variance, so that all boxes together have the mean and the variance of the trapezoid.
    """

    def __init__(self, planes, optics: Optics, layout: str, rays: int, axis: int, thin: bool):
        self.axis, self.optics, self.layout, self.thin = axis, optics, layout, thin
        self.on_pixel = self.on_lenslet = rays
        footprints = [optics.footprint(plane.depth_mm, axis) for plane in planes]
        stops = [optics.stop(distance, axis) for distance, _ in optics.stops]
        edges = [plane.layer.cell_edges_mm(axis) for plane in planes]
        hard = any(p.transmission is not None and p.layer.opaque for p in planes)
        haze = any(p.transmission is not None for p in planes)
        dims = 1 / 2 if hard else 1 / 3 if haze else 0.0
        self.along_pixel, self.along_lenslet = self._tile(footprints, edges, rays, dims)
        self.count = self.along_pixel.size
        wide = optics.defocus
        boxes_mm = np.array([self._box_mm(footprint, wide) for footprint in footprints])
        # Cells that are finer than a ray's box are averaged first: see `_averaged`.
        self.edges = [_coarse_edges(edge, box) for edge, box in zip(edges, boxes_mm, strict=True)]
        self.cells = np.array([edge.size - 1 for edge in self.edges])
        cell_mm = np.array([edge[1] - edge[0] for edge in self.edges])
        self.positions = self._stack(
            (self._hits_mm(footprint, wide) - edge[0]) / width
            for footprint, edge, width in zip(footprints, self.edges, cell_mm, strict=True)
        )
        self.boxes = np.minimum(boxes_mm / cell_mm, 1.0)
        self.stop_mm = self._stack(self._hits_mm(stop, True) for stop in stops) if stops else None
        # On a stop the pixel's image is much the wider: its tiles alone, so that none overlap.
        tile = thin / self.on_pixel
        self.stop_boxes = np.array([abs(stop.pixel_width_mm) * tile for stop in stops])
        self.shifts = self._skewed(footprints, cell_mm)
        self.stop_shifts = self._skewed(stops, 1.0) if stops else self.shifts
        self.seen = np.any(
            [
                _arrange(self._meets(footprint, edge), layout)
                for footprint, edge in zip(footprints, edges, strict=True)
            ],
            axis=0,
        )

    def _tile(self, footprints, edges, rays: int, dims: float) -> tuple[np.ndarray, np.ndarray]:
        """Places of the rays on pixel and lenslet, both in [-1/2, 1/2].

        Boxes along the lenslet tile its image without a gap, so that as few as fit the cells do,
        and all further rays go along the pixel. Where a plane dims another, what both have in
        one box counts as unrelated, so that the boxes have to shrink along both, faster behind
        a hard edge than in a haze: `dims` is the power of the rays that goes to the lenslet.
        """
        if not self.thin:
            return _lattice(rays)
        cells = max(
            abs(f.lenslet_width_mm) / (edge[1] - edge[0])
            for f, edge in zip(footprints, edges, strict=True)
        )
        fewest = round(rays**dims) if dims else 1
        on_lenslet = max(fewest, math.ceil(min(cells, rays**0.5)))
        self.on_lenslet = min(on_lenslet, rays)
        spreads = self.optics.defocus or self.optics.stops
        self.on_pixel = math.ceil(rays / self.on_lenslet) if spreads else 1
        pixel_places, lenslet_places = (
            (np.arange(n) + 0.5) / n - 0.5 for n in (self.on_pixel, self.on_lenslet)
        )
        return np.repeat(pixel_places, self.on_lenslet), np.tile(lenslet_places, self.on_pixel)

    def _hits_mm(self, footprint: Footprint, wide: bool) -> np.ndarray:
        """Trace all rays to a plane; not `wide`: as if the pixel were a point."""
        pixel_mm = footprint.pixel_width_mm * wide
        offsets = footprint.lenslet_width_mm * self.along_lenslet + pixel_mm * self.along_pixel
        return footprint.centres_mm[..., None] + offsets

    def _box_mm(self, footprint: Footprint, wide: bool) -> float:
        if not self.thin:
            return 0.0
        pixel_mm = footprint.pixel_width_mm * wide / self.on_pixel
        return math.hypot(footprint.lenslet_width_mm / self.on_lenslet, pixel_mm)

    def _stack(self, tables) -> np.ndarray:
        return np.stack([_arrange(table, self.layout) for table in tables])

    def _meets(self, footprint: Footprint, edges: np.ndarray) -> np.ndarray:
        """Whether the bundle of a pixel can meet a plane, for each (view, lenslet)."""
        skewed = np.abs(self.optics.skew_mm(self.axis)).max()
        reach = footprint.half_width_mm + skewed * abs(footprint.shift_per_lenslet_shift)
        centres = footprint.centres_mm
        return (centres + 1.5 * reach >= edges[0]) & (centres - 1.5 * reach <= edges[-1])

    def _skewed(self, footprints: list[Footprint], unit_mm) -> np.ndarray:
        """How far a rotated array shifts bundles, by the lenslet's place on the other axis."""
        moved = np.tile(self.optics.skew_mm(self.axis), (self.optics.camera.views, 1))
        gains = np.array([f.shift_per_lenslet_shift for f in footprints]) / unit_mm
        return _arrange(moved, self.layout)[None] * gains[:, None, None]

    def indices(self) -> tuple[np.ndarray, np.ndarray | None]:
        """First cell of each ray, counted from the border at 0, and its share of the next."""
        boxes, cells = self.boxes[:, None, None, None], self.cells[:, None, None, None]
        start = np.floor(self.positions - boxes / 2)
        missed = (start < -1) | (start >= cells)
        index = np.where(missed, 0, start + 1).astype(np.int64)
        if not self.thin:
            return index, None
        share = (self.positions + boxes / 2 - index) / np.maximum(boxes, 1e-12)
        return index, np.where(missed, 0.0, np.clip(share, 0.0, 1.0))


def _trace_group(planes, optics: Optics, layout: str, rays: list[_Rays], out, lines: slice) -> None:
    height, width = rays[0].cells, rays[1].cells
    sizes = (height + 2) * (width + 2)
    first_cell = np.concatenate([[0], np.cumsum(sizes)[:-1]])
    edges = list(zip(rays[0].edges, rays[1].edges, strict=True))
    emission = np.concatenate(
        [
            _bordered(_averaged(p.emission, p, new), 0.0)
            for p, new in zip(planes, edges, strict=True)
        ]
    )
    transmission = _transmission(planes, edges)
    grid = (first_cell, width + 2, height, width, rays[0].boxes, rays[1].boxes)
    skew = stops = None
    if optics.lenslet_skew:
        row, column = (axis.positions for axis in rays)
        shares = (row[..., :0], column[..., :0])
        skew = (rays[0].shifts, rays[1].shifts, rays[0].stop_shifts, rays[1].stop_shifts)
    else:  # positions become indices once, outside the ray loop
        (row, down), (column, right) = (axis.indices() for axis in rays)
        row = row * grid[1][:, None, None, None] + first_cell[:, None, None, None]
        row, column = row.astype(np.int32), column.astype(np.int32)
        shares = (down, right) if rays[0].thin else None
    if optics.stops:
        radii = np.array([radius for _, radius in optics.stops])
        stops = (*(axis.stop_mm for axis in rays), radii, *(axis.stop_boxes for axis in rays))
    row, shares, stops, skew, falloff, seen = _take_lines(
        lines, row, shares, stops, skew, _falloff(optics, layout), rays[0].seen
    )
    first, last = _reach(rays[1].seen)
    share = optics.share / (rays[0].count * rays[1].count)
    _kernels.trace_planes(
        emission, transmission, row, column, shares, grid, skew, stops, falloff,
        seen, first, last, share, out,
    )  # fmt: skip


def _take_lines(lines: slice, row, shares, stops, skew, falloff, seen):
    """Cut all tables along y down to some lines c of the image, kept contiguous."""

    def cut(table, axis):
        return np.ascontiguousarray(table[(slice(None),) * axis + (lines,)])

    if shares is not None:
        shares = (cut(shares[0], 2), shares[1])
    if stops is not None:
        stops = (cut(stops[0], 2), *stops[1:])
    if skew is not None:
        skew = (skew[0], cut(skew[1], 2), skew[2], cut(skew[3], 2))
    if falloff is not None:
        falloff = (cut(falloff[0], 1), falloff[1])
    return cut(row, 2), shares, stops, skew, falloff, cut(seen, 1)


def _lattice(rays: int) -> tuple[np.ndarray, np.ndarray]:
    """Place single rays on pixel and lenslet, both in [-1/2, 1/2], by a rank-1 lattice.

    The same midpoints along both, in an order along the lenslet that steps by about the golden
    section, so that neither width alone, nor both together, is sampled unevenly.
    """
    step = next(k for k in range(round(0.618 * rays), 2 * rays + 1) if math.gcd(k, rays) == 1)
    places = (np.arange(rays) + 0.5) / rays - 0.5
    return places, places[np.arange(rays) * step % rays]


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


def _coarse_edges(edges_mm: np.ndarray, box_mm: float) -> np.ndarray:
    """Keep the cells of a layer, or lay as few as wide as a ray's box over it."""
    length, cells = edges_mm[-1] - edges_mm[0], edges_mm.size - 1
    if box_mm * cells <= length:
        return edges_mm
    count = math.ceil(length / box_mm)
    return (edges_mm[0] + edges_mm[-1]) / 2 + (np.arange(count + 1) - count / 2) * box_mm


def _averaged(cells: np.ndarray, plane: Plane, edges: tuple) -> np.ndarray:
    """Average cells over coarser ones, exactly; outside the plane there is nothing."""
    for axis in (0, 1):
        old, new = plane.layer.cell_edges_mm(axis), edges[axis]
        if new.size == old.size and new[0] == old[0]:
            continue
        start, weight = band_weights(old, (new[1:] + new[:-1]) / 2, new[1] - new[0], 0.0)
        lines = np.moveaxis(cells, axis, 0)
        taken = lines[start[:, None] + np.arange(weight.shape[1])]
        cells = np.moveaxis(np.einsum("ni,ni...->n...", weight, taken), 0, axis)
    return cells


def _bordered(cells: np.ndarray, border: float) -> np.ndarray:
    """Cells with a border around them for rays that miss the plane, flat."""
    return np.pad(cells, 1, constant_values=border).ravel()


def _falloff(optics: Optics, layout: str):
    if not optics.falloff:
        return None
    return tuple(_arrange(optics.squared_tangents(axis), layout) for axis in (0, 1))


def _arrange(table: np.ndarray, layout: str) -> np.ndarray:
    """Bring a table [view, lenslet, ...] into the order of the image's axes (a, c) or (b, d)."""
    if layout == "views":
        return table
    raw = np.swapaxes(table, 0, 1)
    return raw.reshape(1, raw.shape[0] * raw.shape[1], *raw.shape[2:])


def _reach(seen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First and one past the last place d that sees a plane, for each b: seen[b, d] -> [b], [b]."""
    any_seen = seen.any(axis=1)
    first = np.where(any_seen, seen.argmax(axis=1), 0)
    last = np.where(any_seen, seen.shape[1] - seen[:, ::-1].argmax(axis=1), 0)
    return first, last
