"""The ray integrator: each pixel's ray bundle by tracing rays backward, with every effect."""

import math

import numpy as np

from lf_flame.optics.ray_bundle import Footprint
from lf_flame.simulation import _kernels
from lf_flame.simulation.exact import band_weights
from lf_flame.simulation.layouts import arrange, seen_range
from lf_flame.simulation.optical_pass import OpticalPass
from lf_flame.simulation.slabs import Plane


def trace(
    planes: list[Plane],
    optics: OpticalPass,
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
    optics : OpticalPass
    layout : {"views", "raw"}
    rays : int
        Rays along each axis, at least; rounded up so that they tile pixel and lenslet.
    out : ndarray of float32 or float64, shape (a, b, c, d)
        In the order of `lf_flame.simulation.layouts`; the light is added to what it holds.
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

    def __init__(self, planes, optics: OpticalPass, layout: str, rays: int, axis: int, thin: bool):
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
                arrange(self._meets(footprint, edge), layout)
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
        return np.stack([arrange(table, self.layout) for table in tables])

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
        return arrange(moved, self.layout)[None] * gains[:, None, None]

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


def _trace_group(
    planes, optics: OpticalPass, layout: str, rays: list[_Rays], out, lines: slice
) -> None:
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
        lines, row, shares, stops, skew, optics.falloff_tables(layout), rays[0].seen
    )
    first, last = seen_range(rays[1].seen)
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
