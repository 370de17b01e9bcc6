"""The exact integrator: each pixel's ray bundle over the cells of the planes, in closed form."""

from dataclasses import replace

import numpy as np

from lf_flame.simulation import _exact_kernels
from lf_flame.simulation.layouts import Layout, arrange, seen_range
from lf_flame.simulation.optical_pass import OpticalPass
from lf_flame.simulation.slabs import Plane

Width = float | np.ndarray
"""One width for all, or one for each."""

LINES_BYTES = 2**28
"""Memory for planes that are integrated along x together."""


def integrate(planes: list[Plane], optics: OpticalPass, layout: Layout, out: np.ndarray) -> None:
    """Add the light of planes to an image, in closed form.

    The image of a plane is ``Ky @ texture @ Kx.T``. The banded matrices K hold exact integrals,
    over the cells, of the trapezoid with which a pixel weights the plane. The result is exact if
    light only adds up and all rays of a pixel have the same weight, apart from cos^4.

    Parameters
    ----------
    planes : list of Plane
        Planes of which none attenuates another.
    optics : OpticalPass
        Pass of light without stops and skew.
    layout : {"views", "raw"} or Lines
        Layout of the image.
    out : ndarray of float32 or float64, shape (a, b, c, d)
        Image in the order of axes of `lf_flame.simulation.layouts`, to which the light is added.
    """
    for neighbour in optics.lit_neighbours():
        through = replace(optics, neighbour=neighbour)
        batch: list[Plane] = []
        used = 0
        for plane in planes:
            rows = plane.emission.shape[0]
            if batch and used + rows * out.shape[1] * out.shape[3] * 8 > LINES_BYTES:
                _integrate_batch(batch, through, layout, out)
                batch, used = [], 0
            batch.append(plane)
            used += rows * out.shape[1] * out.shape[3] * 8
        _integrate_batch(batch, through, layout, out)


def _integrate_batch(planes, optics, layout: Layout, out: np.ndarray) -> None:
    bands = [[list(bundle_bands(p, optics, axis, layout)) for p in planes] for axis in (0, 1)]
    heights = [plane.emission.shape[0] for plane in planes]
    lines = np.empty((sum(heights), out.shape[1], out.shape[3]))
    if not planes:
        return
    reach = np.zeros((2, len(planes), out.shape[1]), np.int64)
    top = 0
    for p, (plane, (start, weight)) in enumerate(zip(planes, bands[1], strict=True)):
        reach[:, p] = seen_range(np.any(weight, axis=2))
        part = lines[top : top + heights[p]]
        _exact_kernels.integrate_columns(plane.emission, start, weight, *reach[:, p], part)
        bands[0][p] = [bands[0][p][0] + top, bands[0][p][1] * optics.share]
        top += heights[p]
    most = max(weight.shape[2] for _, weight in bands[0])
    weights = np.zeros((len(planes), *bands[0][0][0].shape, most))
    for p, (_, weight) in enumerate(bands[0]):
        weights[p, ..., : weight.shape[2]] = weight
    starts = np.stack([start for start, _ in bands[0]])
    falloff, seen = optics.falloff_table(layout), weights.any(axis=3)
    _exact_kernels.integrate_rows(lines, starts, weights, falloff, seen, *reach, out)


def bundle_bands(
    plane: Plane, optics: OpticalPass, axis: int, layout: Layout = "views"
) -> tuple[np.ndarray, np.ndarray]:
    """Share of each pixel's ray bundle that meets each cell of a plane, along an axis.

    Returns
    -------
    start, weights
        As `band_weights` returns them, for centres in the order of an image, (a, c) or (b, d).
    """
    footprint = optics.footprint(plane.depth_mm, axis)
    edges = plane.layer.cell_edges_mm(axis)
    centres = arrange(footprint.centres_mm, layout, axis)
    lenslet_mm = abs(footprint.lenslet_width_mm)
    pixel_mm: Width = abs(footprint.pixel_width_mm) * optics.defocus
    gain = optics.strip_gain(plane, axis)
    factor = 1.0 if gain is None else arrange(gain, layout, axis)[..., None]
    if not optics.square_micro_images:
        start, weights = band_weights(edges, centres, lenslet_mm, pixel_mm)
        return start, weights if gain is None else weights * factor
    middle, share = (arrange(part, layout, axis) for part in optics.lit_parts(axis))
    centres = centres - middle * (footprint.pixel_width_mm / optics.camera.pixel_mm)
    start, weights = band_weights(edges, centres, lenslet_mm, pixel_mm * share)
    return start, weights * (share[..., None] * factor)


def band_weights(
    edges_mm: np.ndarray, centres_mm: np.ndarray, lenslet_mm: float, pixel_mm: Width
) -> tuple[np.ndarray, np.ndarray]:
    """Exact integrals of trapezoids over cells: differences of `trapezoid_cdf`, compiled.

    Parameters
    ----------
    edges_mm : ndarray, shape (cells + 1,)
        Evenly spaced edges of the cells.
    centres_mm : ndarray of any shape
        Where the trapezoids are centred.
    lenslet_mm, pixel_mm : float
        Widths of the two boxes whose convolution the trapezoid is; that of the pixel may be an
        array of the centres' shape.

    Returns
    -------
    start : ndarray of int64, shape of `centres_mm`
    weights : ndarray of float64, with a last axis of the band's cells
        The cell ``start + k`` has weight ``weights[..., k]``; a trapezoid inside the cells has a
        sum of 1.
    """
    cells, cell_mm = len(edges_mm) - 1, edges_mm[1] - edges_mm[0]
    band = int(min(cells, np.ceil((lenslet_mm + np.max(pixel_mm)) / cell_mm) + 1))
    # Arrays of their own: Numba compiles once more for each that is read-only.
    centres, widths = np.array(centres_mm), np.full(centres_mm.shape, pixel_mm, float)
    start = np.empty(centres_mm.shape, np.int64)
    weights = np.empty((*centres_mm.shape, band))
    lines = len(centres), -1
    _exact_kernels.weigh_bands(
        edges_mm, centres.reshape(lines), float(lenslet_mm), widths.reshape(lines),
        start.reshape(lines), weights.reshape(*lines, band),
    )  # fmt: skip
    return start, weights
