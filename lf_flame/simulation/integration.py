"""Gathering the light of planes into an image: in closed form, the exact integrator, or by rays.

The compiled loops at the end gather: each output element is summed by one thread in a fixed order,
so the bits do not depend on the number of threads. Sums run in float64.
"""

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numba import njit

from lf_flame._common.threads import parallel
from lf_flame.lightfield import LightField
from lf_flame.optics.camera import ROW_SPACING, PlenopticCamera
from lf_flame.optics.ray_bundle import ArrayPart
from lf_flame.simulation._weight_kernels import shade
from lf_flame.simulation.optical_pass import Layout, Lines, OpticalPass, arrange
from lf_flame.simulation.rays import trace
from lf_flame.simulation.slabs import Plane

Width = float | np.ndarray
"""One width for all, or one for each."""

TINY = np.finfo(float).tiny
"""Divides where a width may be 0."""

LINES_BYTES = 2**28
"""Memory for planes that are integrated along x together."""

FEW_PORTIONS = 4
"""Portions of light that are added in float32; more are added in float64."""

STRIPS = 6
"""Number of boxes in place of each of the two tapering ends of a hexagonal lenslet."""


def gather(
    planes: list[Plane], passes: list[OpticalPass], layout: Layout, rays: int | None
) -> np.ndarray:
    """Gather the light of planes, front to back, on the sensor, without diffraction.

    Returns float32 in the order of the layout. rays: number along each axis; None for the exact
    integrator. passes: one for each colour.
    """
    camera = passes[0].camera
    if camera.layout == "hexagonal" and not isinstance(layout, Lines):
        views = _gather_hexagonal(planes, passes, rays)
        return views if layout == "views" else LightField.trusted(views).to_raw()[None, None]
    # Where light comes in many portions, float32 would round after each.
    portions = len(planes) if rays else len(passes[0].neighbours)
    many = len(passes) * portions > FEW_PORTIONS
    image = blank_image(camera, layout, np.float64 if many else np.float32)
    _add(planes, passes, layout, rays, image)
    return image.astype(np.float32, copy=False)


def blank_image(camera: PlenopticCamera, layout: Layout, dtype=np.float32) -> np.ndarray:
    """Make a dark image ``[a, b, c, d]``; memory that no light reaches is never touched.

    Shape (v, u, t, s) for views, (1, 1, t * v, s * u) for the raw image, (1, 1, rows, columns).
    """
    if isinstance(layout, Lines):
        return np.zeros((1, 1, layout.rows.size, layout.columns.size), dtype)
    n, (lines, columns) = camera.views, camera.lenslets
    shape = (n, n, lines, columns) if layout == "views" else (1, 1, lines * n, columns * n)
    return np.zeros(shape, dtype)


def _add(planes: list[Plane], passes, layout: Layout, rays: int | None, out: np.ndarray) -> None:
    for optics in passes:
        if rays:
            trace(planes, optics, layout, rays, out)
        else:
            integrate(planes, optics, layout, out)


def _gather_hexagonal(
    planes: list[Plane], passes: list[OpticalPass], rays: int | None
) -> np.ndarray:
    """Gather through hexagons, and interpolate along their rows to the square grid of the views.

    Even and odd rows are two rectangular arrays. A hexagon with two sides upright is a box between
    two triangles, each replaced by `STRIPS` boxes of its widths.
    """
    camera, pitch = passes[0].camera, passes[0].camera.lenslet_pitch_mm
    rows, columns = camera.lenslets
    spacing = ROW_SPACING["hexagonal"]
    # Row 0 has a lenslet half a pitch to the left of column 0, row 1 one at column 0.
    left = -(columns - 1) / 2 * spacing - 0.5
    count = math.floor((columns - 1) * spacing + 0.5) + 2
    lenslets = np.empty((camera.views, camera.views, rows, count), np.float32)
    for parity in range(min(rows, 2)):
        array = replace(camera, lenslets=(len(range(parity, rows, 2)), count))
        first = (parity - (rows - 1) / 2) * spacing * pitch, (left + parity / 2) * pitch
        parts = [
            replace(optics, camera=array, share=optics.share * share,
                    part=ArrayPart(first, (2 * spacing * pitch, pitch), size, aside))
            for optics in passes
            for share, size, aside in _hexagon(pitch)
        ]  # fmt: skip
        image = blank_image(array, "views", np.float64)
        _add(planes, parts, "views", rays, image)
        lenslets[:, :, parity::2] = image
    views = np.empty((camera.views, camera.views, rows, columns), np.float32)
    for parity in range(min(rows, 2)):
        place = 0.5 + spacing * np.arange(columns) - parity / 2
        near = np.minimum(place.astype(int), count - 2)
        lines, share = lenslets[:, :, parity::2], place - near
        views[:, :, parity::2] = lines[..., near] * (1 - share) + lines[..., near + 1] * share
    return views


def _hexagon(pitch: float) -> Iterator[tuple[float, tuple[float, float], tuple[float, float]]]:
    """Boxes of a hexagon: share of its area, height and width, position from its centre, in mm."""
    side = pitch / math.sqrt(3)
    area = 1.5 * side * pitch
    yield side * pitch / area, (side, pitch), (0.0, 0.0)
    height = side / 2 / STRIPS
    for strip in range(STRIPS):
        width = pitch * (1 - (strip + 0.5) / STRIPS)
        place = side / 2 + (strip + 0.5) * height
        for sign in (-1, 1):
            yield height * width / area, (height, width), (sign * place, 0.0)


def integrate(planes: list[Plane], optics: OpticalPass, layout: Layout, out: np.ndarray) -> None:
    """Add the light of planes to an image, in closed form.

    The image of a plane is ``Ky @ texture @ Kx.T``. The banded matrices K contain exact integrals,
    over the cells, of the trapezoid with which a pixel weights the plane. The result is exact if
    light only adds up and all rays of a pixel have the same weight, apart from cos^4.

    No plane may attenuate another, and the pass may have no stops and no skew. The light is added
    to `out`, float32 or float64 in the order of the layout.
    """
    for neighbour in optics.neighbours:
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
        lit = np.any(weight, axis=2)
        last = lit.any(axis=1) * (lit.shape[1] - lit[:, ::-1].argmax(axis=1))
        reach[:, p] = lit.argmax(axis=1), last
        part = lines[top : top + heights[p]]
        integrate_columns(plane.emission, start, weight, *reach[:, p], part)
        bands[0][p] = [bands[0][p][0] + top, bands[0][p][1] * optics.share]
        top += heights[p]
    most = max(weight.shape[2] for _, weight in bands[0])
    weights = np.zeros((len(planes), *bands[0][0][0].shape, most))
    for p, (_, weight) in enumerate(bands[0]):
        weights[p, ..., : weight.shape[2]] = weight
    starts = np.stack([start for start, _ in bands[0]])
    falloff, seen = falloff_table(optics, layout), weights.any(axis=3)
    integrate_rows(lines, starts, weights, falloff, seen, *reach, out)


class FalloffTable(NamedTuple):
    """Squared tangents of the pixels' central rays behind the main lens, for cos^4."""

    rows: np.ndarray  # (a, c)
    columns: np.ndarray  # (b, d)
    patch: float  # mean over a pixel's patch of the main lens, from its centre


def falloff_table(optics: OpticalPass, layout: Layout) -> FalloffTable | None:
    """Squared tangents in the order of an image, or None without cos^4."""
    if not optics.falloff:
        return None
    tangents = [optics.tangents(axis) for axis in (0, 1)]
    if optics.square_micro_images:  # of the part of a pixel that is lit
        for axis in (0, 1):
            tangents[axis] += optics.lit_parts(axis)[0] / optics.camera.lenslet_focal_mm
    rows, columns = (arrange(table, layout, axis) for axis, table in enumerate(tangents))
    patch = (optics.camera.pixel_mm / optics.camera.lenslet_focal_mm) ** 2 / 6
    return FalloffTable(rows**2, columns**2, patch)


def bundle_bands(
    plane: Plane, optics: OpticalPass, axis: int, layout: Layout = "views"
) -> tuple[np.ndarray, np.ndarray]:
    """Share of each pixel's ray bundle that meets each cell of a plane, along an axis.

    Returns what `band_weights` does, for centres in the order of an image, (a, c) or (b, d).
    """
    footprint = optics.footprint(plane.depth_mm, axis)
    edges = plane.layer.cell_edges_mm[axis]
    centres = arrange(footprint.centres_mm, layout, axis)
    lenslet_mm = abs(footprint.lenslet_width_mm)
    pixel_mm: Width = abs(footprint.pixel_width_mm) * optics.defocus
    factor = arrange(optics.strip_gain(plane, axis)[0], layout, axis)
    if optics.square_micro_images:
        middle, share = (arrange(part, layout, axis) for part in optics.lit_parts(axis))
        centres = centres - middle * (footprint.pixel_width_mm / optics.camera.pixel_mm)
        pixel_mm, factor = pixel_mm * share, factor * share
    start, weights = band_weights(edges, centres, lenslet_mm, pixel_mm)
    return start, weights * np.abs(factor)[..., None]


def band_weights(
    edges_mm: np.ndarray, centres_mm: np.ndarray, lenslet_mm: float, pixel_mm: Width
) -> tuple[np.ndarray, np.ndarray]:
    """Exact integrals of trapezoids over cells: differences of `trapezoid_cdf`, compiled.

    A trapezoid is the convolution of two boxes, of widths lenslet_mm and pixel_mm; the latter may
    be an array of the centres' shape. edges_mm: evenly spaced edges of the cells. Returns the first
    cell of each trapezoid, int64 of the centres' shape, and the weights of the cells from there on,
    with a last axis for them; a trapezoid inside the cells has a sum of 1.
    """
    cells, cell_mm = len(edges_mm) - 1, edges_mm[1] - edges_mm[0]
    band = int(min(cells, np.ceil((lenslet_mm + np.max(pixel_mm)) / cell_mm) + 1))
    # Arrays of their own: Numba compiles once more for each that is read-only.
    centres, widths = np.array(centres_mm), np.full(centres_mm.shape, pixel_mm, float)
    start = np.empty(centres_mm.shape, np.int64)
    weights = np.empty((*centres_mm.shape, band))
    lines = len(centres), -1
    weigh_bands(
        edges_mm, centres.reshape(lines), float(lenslet_mm), widths.reshape(lines),
        start.reshape(lines), weights.reshape(*lines, band),
    )  # fmt: skip
    return start, weights


@njit
def trapezoid_cdf(x, wide, narrow):
    """Distribution at x of the sum of two centred uniform variables of these widths.

    It is written for ``|x|`` in a linear and a quadratic part, so that nothing cancels and widths
    may be zero: one zero width makes a box, two make a step with the value 1/2 at its centre.
    """
    distance, half = abs(x), 0.5
    if wide > 0.0:
        rest = (wide + narrow) / 2 - distance
        if rest < narrow:
            ramp = max(rest, 0.0)
            half = 0.5 - ramp / wide * (ramp / max(narrow, TINY)) / 2
        else:
            half = min(distance / wide, 0.5)
    return 0.5 + half if x > 0.0 else 0.5 - half if x < 0.0 else 0.5


@parallel(lambda centres: len(centres))
def weigh_bands(v, edges, centres, lenslet, pixels, start, weights):
    """Shares of trapezoids in cells: weights[v, k, i] of cell start[v, k] + i for centres[v, k].

    edges[cell]: evenly spaced. lenslet, pixels[v, k]: widths of the boxes that make a trapezoid.
    """
    cells, cell_width = edges.size - 1, edges[1] - edges[0]
    band, border = weights.shape[2], edges[cells]
    for k in range(centres.shape[1]):
        centre, pixel = centres[v, k], pixels[v, k]
        wide, narrow, reach = max(lenslet, pixel), min(lenslet, pixel), (lenslet + pixel) / 2
        if centre + reach < edges[0] or centre - reach > border:  # as most do: in short
            start[v, k] = 0 if centre < border else cells - band
            weights[v, k] = 0.0
            continue
        first = math.floor((centre - reach - edges[0]) / cell_width)
        start[v, k] = min(max(first, 0), cells - band)
        near = trapezoid_cdf(edges[start[v, k]] - centre, wide, narrow)
        for i in range(band):
            far = trapezoid_cdf(edges[start[v, k] + i + 1] - centre, wide, narrow)
            weights[v, k, i] = far - near
            near = far


@parallel(lambda texture: len(texture))
def integrate_columns(row, texture, start, weight, first, last, out):
    """``texture @ Kx.T``, K banded: out[row, b, d].

    start[b, d], weight[b, d, j]: first cell and weights of the band.
    """
    cells = texture[row]
    for b in range(start.shape[0]):
        for d in range(first[b], last[b]):
            light, near, band = 0.0, start[b, d], weight[b, d]
            for j in range(band.size):
                light += band[j] * cells[near + j]
            out[row, b, d] = light


@parallel(lambda weight: weight.shape[1] * weight.shape[2])
def integrate_rows(k, columns, start, weight, falloff, seen, first, last, out):
    """Add ``Ky @ columns`` to each pixel, out[a, b, c, d], for a batch of planes.

    columns[row, b, d]: the planes' textures, integrated along x, one below the other.
    start[p, a, c], weight[p, a, c, i]: first row and weights of the band in plane p.
    seen[p, a, c], first[p, b], last[p, b]: the pixels along y and x that can see plane p.
    """
    planes, groups, lines, band = weight.shape
    a, c = k // lines, k % lines
    total = np.empty(columns.shape[2])
    for b in range(columns.shape[1]):
        low, high = total.size, 0
        for p in range(planes):
            if seen[p, a, c]:
                low, high = min(low, first[p, b]), max(high, last[p, b])
        total[low:high] = 0.0
        for p in range(planes):
            if not seen[p, a, c]:
                continue
            inside = total[first[p, b] : last[p, b]]
            for i in range(band):
                w = weight[p, a, c, i]
                if w != 0.0:
                    cells = columns[start[p, a, c] + i, b, first[p, b] : last[p, b]]
                    for d in range(inside.size):
                        inside[d] += w * cells[d]
        for d in range(low, high):
            out[a, b, c, d] += out.dtype.type(total[d] * shade(falloff, a, c, b, d))
