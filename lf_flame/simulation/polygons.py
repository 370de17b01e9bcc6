"""Exact images of planes that occlude or attenuate each other, by polygons of rays.

Along one axis, the rays of a pixel fill a unit square: position on the lenslet times position on
the pixel. The position where a ray meets a plane is an affine function of both. The edges of the
plane's cells therefore divide the square into strips, and the edges of all planes divide it into
convex polygons, within which every ray meets the same cells. A pixel is then a finite sum over
pairs of polygons, one along y and one along x: the product of their areas and of the radiance along
a ray through their cells. This holds for any number of planes, if the weight of a ray does not
couple the axes, as a round stop or a rotated lenslet array would.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from lf_flame.simulation import _polygon_kernels
from lf_flame.simulation.layouts import arrange
from lf_flame.simulation.optical_pass import OpticalPass
from lf_flame.simulation.ray_tables import PlaneTable
from lf_flame.simulation.slabs import Plane


class PolygonTable(NamedTuple):
    """The polygons of all bundles along one axis, one bundle behind the other.

    Attributes
    ----------
    first : ndarray of int64, shape (bundles + 1,)
        Place of a bundle's first polygon; bundles in the order of an image's axes, (a, c) or
        (b, d).
    cells : ndarray of int32, shape (polygons, p)
        Where in the table of planes a polygon's row of cells, or its column, begins: the sum of
        both is the cell.
    areas : ndarray of float64, shape (polygons,)
        Share of the bundle.
    """

    first: np.ndarray
    cells: np.ndarray
    areas: np.ndarray


class Bundles(NamedTuple):
    """Bundles on planes, along one axis, in cells of each plane.

    Attributes
    ----------
    middles : ndarray of float64, shape (view, lenslet, p)
        From the first edge of the plane.
    lenslet, pixel : ndarray of float64, shape (p,)
        Widths of the images of lenslet and pixel, signed.
    counts : ndarray of int64, shape (p,)
        Cells of each plane.
    lit : ndarray of float64, shape (view, lenslet)
        Share of the pixel that light can reach through the lenslet; `middles` are those of the
        rays through this part.
    """

    middles: np.ndarray
    lenslet: np.ndarray
    pixel: np.ndarray
    counts: np.ndarray
    lit: np.ndarray

    @property
    def reach(self) -> np.ndarray:
        """Half of each bundle's full extent on the planes, shape (p,)."""
        return (abs(self.lenslet) + abs(self.pixel)) / 2


def split_planes(planes: list[Plane]) -> tuple[list[Plane], list[Plane]]:
    """Split planes into those in front of the first that attenuates light, and the others.

    Planes behind the last that glows are dropped, as they attenuate no light.

    Parameters
    ----------
    planes : list of Plane
        Front to back.

    Returns
    -------
    in_front, behind : list of Plane
        `behind` begins with a plane that dims, or is empty.
    """
    last = max((p for p, plane in enumerate(planes) if plane.emission.any()), default=-1)
    planes = planes[: last + 1]
    planes[last:] = [replace(plane, transmission=None) for plane in planes[last:]]
    dimming = (p for p, plane in enumerate(planes) if plane.transmission is not None)
    first = next(dimming, len(planes))
    return planes[:first], planes[first:]


def integrate_polygons(
    planes: list[Plane],
    optics: OpticalPass,
    layout: str,
    shaded: tuple[np.ndarray, np.ndarray],
    out: np.ndarray,
) -> None:
    """Add the light of planes that attenuate each other to the pixels that see this, exactly.

    Parameters
    ----------
    planes : list of Plane
        Planes, front to back.
    optics : OpticalPass
        Pass of light without stops and skew.
    layout : {"views", "raw"}
        Layout of the image.
    shaded : (ndarray of bool, ndarray of bool), shapes (a, c) and (b, d)
        Pixels to which light is added: those with both values true.
    out : ndarray of float32 or float64, shape (a, b, c, d)
        Image in the order of axes of `lf_flame.simulation.layouts`, to which the light is added.
    """
    table = _plane_table(planes)
    rows, columns = (
        cut_bundles(bundles_on(planes, optics, axis), layout, wanted)
        for axis, wanted in enumerate(shaded)
    )
    down = (rows.cells * table.stride + table.first).astype(np.int32)
    rows = rows._replace(cells=down, areas=rows.areas * optics.share)
    _polygon_kernels.add_polygons(table, rows, columns, optics.falloff_table(layout), out)


def bundles_on(planes: list[Plane], optics: OpticalPass, axis: int) -> Bundles:
    """Lay all bundles over some planes, along one axis.

    Parameters
    ----------
    planes : list of Plane
    optics : OpticalPass
    axis : int
        0 for y, 1 for x.

    Returns
    -------
    Bundles
    """
    middles, widths, counts = [], [], []
    aside, lit = optics.lit_parts(axis)
    for plane in planes:
        edges, footprint = plane.layer.cell_edges_mm(axis), optics.footprint(plane.depth_mm, axis)
        cell_mm = plane.layer.size_mm[axis] / (edges.size - 1)
        centres = footprint.centres_mm
        if optics.square_micro_images:
            centres = centres - aside * (footprint.pixel_width_mm / optics.camera.pixel_mm)
        middles.append((centres - edges[0]) / cell_mm)
        pixel_mm = footprint.pixel_width_mm * optics.defocus
        widths.append((footprint.lenslet_width_mm / cell_mm, pixel_mm / cell_mm))
        counts.append(edges.size - 1)
    lenslet, pixel = np.array(widths).T.copy()  # contiguous for any number of planes: one kernel
    lit = lit if optics.square_micro_images else np.ones_like(lit)
    return Bundles(np.stack(middles, axis=-1), lenslet, pixel, np.array(counts), lit)


def cut_bundles(bundles: Bundles, layout: str, wanted: np.ndarray) -> PolygonTable:
    """Cut bundles into the polygons in which each ray meets the same cells of all planes.

    Parameters
    ----------
    bundles : Bundles
    layout : {"views", "raw"}
    wanted : ndarray of bool, shape (a, c) or (b, d)
        The others are left without polygons.

    Returns
    -------
    PolygonTable
        `cells` count from the border of a plane at 0. What meets no plane at all is left out.
    """
    planes = bundles.counts.size
    # A place outside the layer is moved to just outside; all such places are alike.
    outside = bundles.reach + 1
    middles = np.clip(bundles.middles, -outside, bundles.counts + outside)
    middles = np.ascontiguousarray(arrange(middles, layout).reshape(-1, planes))
    lit = np.ascontiguousarray(arrange(bundles.lit, layout).ravel())
    geometry = middles, bundles.lenslet, bundles.pixel, lit, bundles.counts
    found = np.empty(len(middles), np.int64)
    _polygon_kernels.count_polygons(*geometry, wanted.ravel(), found)
    first = np.concatenate([[0], np.cumsum(found)])
    cells, areas = np.empty((first[-1], planes), np.int32), np.empty(first[-1])
    _polygon_kernels.cut_bundles(*geometry, first, cells, areas)
    return PolygonTable(first, cells, areas)


def find_shaded(
    planes: list[Plane], optics: OpticalPass, layout: str
) -> tuple[np.ndarray, np.ndarray]:
    """Find the pixels with a bundle that can meet an attenuating plane, along y and along x.

    Parameters
    ----------
    planes : list of Plane
    optics : OpticalPass
    layout : {"views", "raw"}

    Returns
    -------
    rows, columns : ndarray of bool, shapes (a, c) and (b, d)
        A pixel is shaded only if both are true.
    """
    found = []
    for axis in (0, 1):
        meets = np.zeros((optics.camera.views, optics.camera.lenslets[axis]), bool)
        for plane in planes:
            if plane.transmission is None:
                continue
            low, high = plane.layer.extent_mm(plane.transmission < 1, axis)
            footprint = optics.footprint(plane.depth_mm, axis)
            reach = footprint.half_width_mm * (1 + 1e-9)
            meets |= (footprint.centres_mm + reach > low) & (footprint.centres_mm - reach < high)
        found.append(arrange(meets, layout))
    return found[0], found[1]


def expected_pairs(planes: list[Plane], optics: OpticalPass) -> float:
    """Estimate the pairs of polygons in all pixels that are shaded: the work of summing them.

    Parameters
    ----------
    planes : list of Plane
    optics : OpticalPass

    Returns
    -------
    float
    """
    shaded = find_shaded(planes, optics, "views")
    return float(
        np.prod(
            [
                marks.sum() * expected_polygons(bundles_on(planes, optics, axis))
                for axis, marks in enumerate(shaded)
            ]
        )
    )


def expected_polygons(bundles: Bundles) -> float:
    """Mean number of polygons of bundles that lie anywhere on the planes.

    Lines across a convex region cut it into one part more than there are lines, and into another
    for each crossing inside. As many edges of a plane meet a bundle as the bundle is cells long,
    in the mean; and as many edges of two planes cross in it as the area is that it covers in
    cells of the one by cells of the other. A small plane may have fewer edges.

    Parameters
    ----------
    bundles : Bundles

    Returns
    -------
    float
    """
    lenslet, pixel = bundles.lenslet, bundles.pixel
    lines = abs(lenslet) + abs(pixel)
    present = np.minimum(1.0, (bundles.counts + 1) / np.maximum(lines, 1e-300))
    crossings = abs(np.outer(lenslet, pixel) - np.outer(pixel, lenslet))
    return float(1 + lines @ present + present @ crossings @ present / 2)


def _plane_table(planes: list[Plane]) -> PlaneTable:
    """Put the cells of all planes into one table, each with a border in which there is nothing."""
    counts = np.array([plane.emission.shape for plane in planes])
    height, width = counts.T.copy()
    first = np.concatenate([[0], np.cumsum((height + 2) * (width + 2))[:-1]])
    emission = [np.pad(plane.emission, 1).ravel() for plane in planes]
    passes = [
        np.ones(plane.emission.shape) if plane.transmission is None else plane.transmission
        for plane in planes
    ]
    transmission = [np.pad(cells, 1, constant_values=1.0).ravel() for cells in passes]
    return PlaneTable(
        np.concatenate(emission), np.concatenate(transmission), first, width + 2, height, width
    )
