"""Rendering: a scene through a plenoptic camera into a light field.

Two integrators share one ray transfer chain (`lf_flame.footprint`). The exact one evaluates the
integral over each pixel's ray bundle in closed form; the ray one samples the bundle. A pixel
holds the mean radiance over its bundle: a uniform layer that fills the field gives its own
brightness in every pixel.
"""

import math

import numpy as np

from lf_flame import _kernels
from lf_flame.camera import PlenopticCamera
from lf_flame.errors import InputError
from lf_flame.footprint import Footprint, trace_footprint, trapezoid_cdf
from lf_flame.lightfield import LightField
from lf_flame.scene import Layer, Scene

RAY_COUNTS = (5, 13, 34, 89)
"""Rays per pixel and axis that are tried for a tolerance: every second Fibonacci number, whose
lattices are the most even."""


def render(
    scene: Scene,
    camera: PlenopticCamera,
    tolerance: float = 1e-3,
    integrator: str = "auto",
    rays: int | None = None,
) -> LightField:
    """Simulate the light field that a camera records of a scene.

    Parameters
    ----------
    scene : Scene
        Layers whose light adds.
    camera : PlenopticCamera
    tolerance : float, optional
        Error that is acceptable, root-mean-square over the image relative to its brightest pixel.
        The exact integrator stays at float32 rounding; the ray integrator adds rays until two
        images differ by less than this.
    integrator : {"auto", "exact", "rays"}, optional
        "auto" takes the exact integrator, which does everything that planar layers of added
        light need.
    rays : int, optional
        Fixed number of rays per pixel along each axis for the ray integrator, instead of the
        tolerance.

    Returns
    -------
    LightField
        ``views[v, u, t, s]``, float32, in the unit of the textures.

    Raises
    ------
    InputError
        If a layer lies outside the field, stands behind the lens or is opaque, or if the
        tolerance or integrator cannot be had.
    """
    if integrator not in ("auto", "exact", "rays"):
        raise InputError(f"integrator must be auto, exact or rays, got {integrator!r}.")
    if not tolerance > 0:
        raise InputError(f"tolerance must be above 0, got {tolerance}.")
    if rays is not None and (integrator != "rays" or rays < 1):
        raise InputError(
            f"rays must be at least 1 and goes with integrator='rays', "
            f"got rays={rays}, integrator={integrator!r}."
        )
    traced = [(layer, *_trace_axes(layer, camera)) for layer in scene.layers]
    if integrator != "rays":
        return LightField(_accumulate(_add_exact, traced, camera))
    if rays is not None:
        return LightField(_accumulate(_add_rays, traced, camera, rays))
    return LightField(_trace_to_tolerance(traced, camera, tolerance))


def _trace_axes(layer: Layer, camera: PlenopticCamera) -> tuple[Footprint, Footprint]:
    """Footprints of all pixels on a layer, after checking that some pixel sees it."""
    if layer.opaque:
        raise InputError(
            f"Opaque layers cannot be rendered yet, light only adds; "
            f"set opaque=False on the layer at {layer.depth_mm} mm."
        )
    axes = tuple(trace_footprint(camera, layer.depth_mm, axis) for axis in (0, 1))
    for axis, footprint in enumerate(axes):
        edges, reach = layer.cell_edges_mm(axis), footprint.half_width_mm
        low, high = footprint.centres_mm.min() - reach, footprint.centres_mm.max() + reach
        if edges[-1] <= low or edges[0] >= high:
            raise InputError(
                f"The layer at depth {layer.depth_mm} mm lies outside the field: in "
                f"{'yx'[axis]} it spans {edges[0]:.4g} to {edges[-1]:.4g} mm, "
                f"and the camera sees {low:.4g} to {high:.4g} mm there."
            )
    return axes


def _accumulate(add_layer, traced, camera: PlenopticCamera, *options) -> np.ndarray:
    out = np.zeros((camera.views, camera.views, *camera.lenslets), np.float32)
    for layer, rows, columns in traced:
        add_layer(layer, rows, columns, out, *options)
    return out


def _trace_to_tolerance(traced, camera, tolerance: float) -> np.ndarray:
    coarse = None
    for rays in RAY_COUNTS:
        fine = _accumulate(_add_rays, traced, camera, rays)
        if coarse is not None:
            change = np.sqrt(np.mean(np.square(fine - coarse, dtype=np.float64)))
            if change <= tolerance * fine.max():
                return fine
        coarse = fine
    raise InputError(
        f"tolerance {tolerance} was not met with {rays} x {rays} rays per pixel; allow more, "
        f"or use the exact integrator."
    )


def _add_exact(layer: Layer, rows: Footprint, columns: Footprint, out: np.ndarray) -> None:
    row_start, row_weight = _band(layer.cell_edges_mm(0), rows)
    column_start, column_weight = _band(layer.cell_edges_mm(1), columns)
    first, last = _reach(column_weight.any(axis=2))
    _kernels.integrate_layer(
        layer.texture, row_start, row_weight, column_start, column_weight, first, last, out
    )


def _band(edges_mm: np.ndarray, footprint: Footprint) -> tuple[np.ndarray, np.ndarray]:
    """Share of each pixel's ray bundle that meets each cell, as (first cell, weights).

    Exact integrals of the trapezoid over the cells: differences of its cumulative distribution.
    """
    cells, cell_mm = len(edges_mm) - 1, edges_mm[1] - edges_mm[0]
    reach = footprint.half_width_mm
    band = min(cells, int(np.ceil(2 * reach / cell_mm)) + 1)
    start = np.floor((footprint.centres_mm - reach - edges_mm[0]) / cell_mm)
    start = np.clip(start, 0, cells - band).astype(np.int64)
    edges = edges_mm[start[..., None] + np.arange(band + 1)]
    widths = abs(footprint.lenslet_width_mm), abs(footprint.pixel_width_mm)
    cumulative = trapezoid_cdf(edges - footprint.centres_mm[..., None], *widths)
    return start, np.diff(cumulative, axis=-1)


def _add_rays(layer: Layer, rows: Footprint, columns: Footprint, out: np.ndarray, rays: int):
    row_hits = _hits(layer.cell_edges_mm(0), rows, rays)
    column_hits = _hits(layer.cell_edges_mm(1), columns, rays)
    first, last = _reach(column_hits.any(axis=2))
    _kernels.trace_layer(np.pad(layer.texture, 1), row_hits, column_hits, first, last, out)


def _hits(edges_mm: np.ndarray, footprint: Footprint, rays: int) -> np.ndarray:
    """Cell index + 1 that each ray of each pixel meets, 0 where it misses; half-open cells.

    The rays of a pixel are a rank-1 lattice over pixel and lenslet: the same midpoints along
    both, in an order along the lenslet that steps by about the golden section, so that neither
    width alone, nor both together, is sampled unevenly.
    """
    step = next(k for k in range(round(0.618 * rays), 2 * rays + 1) if math.gcd(k, rays) == 1)
    along_pixel = (np.arange(rays) + 0.5) / rays - 0.5
    along_lenslet = (np.arange(rays) * step % rays + 0.5) / rays - 0.5
    offsets = footprint.pixel_width_mm * along_pixel + footprint.lenslet_width_mm * along_lenslet
    hit_mm = footprint.centres_mm[..., None] + offsets
    cells, cell_mm = len(edges_mm) - 1, edges_mm[1] - edges_mm[0]
    index = np.floor((hit_mm - edges_mm[0]) / cell_mm) + 1
    return np.where((index < 1) | (index > cells), 0, index).astype(np.int32)


def _reach(seen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First and one-past-last lenslet that sees a layer, for each view: seen[u, s] -> [u], [u]."""
    any_seen = seen.any(axis=1)
    first = np.where(any_seen, seen.argmax(axis=1), 0)
    last = np.where(any_seen, seen.shape[1] - seen[:, ::-1].argmax(axis=1), 0)
    return first, last
