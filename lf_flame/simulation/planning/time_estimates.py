"""Estimates of the time that integrators and effects take, from measured rates."""

import math
from collections.abc import Collection, Mapping, Sequence

import numpy as np

from lf_flame.optics.camera import PlenopticCamera
from lf_flame.optics.sensor import STAGES
from lf_flame.scenes.scene import Layer, Scene
from lf_flame.simulation.optical_pass import OpticalPass
from lf_flame.simulation.planning.effects import EFFECTS, MATTER, RAYS
from lf_flame.simulation.planning.scene_bounds import SceneBounds
from lf_flame.simulation.polygons import expected_pairs, split_planes
from lf_flame.simulation.slabs import slice_scene

NANOSECONDS = {
    "pixel": 1.0,
    "exact": 2.5,
    "ray": 4.0,
    "dimmed": 6.0,
    "stop": 11.5,
    "lenslets": 24.0,
    "lenslets_stop": 60.0,
    "polygon": 1.2,
    "cos4": 0.25,
    "lenslet_blur": 420.0,
    "main_lens_blur": 35.0,
    "noise": 18.0,
}
"""Time on one core, as measured for the tables of costs: for a pixel of the image (pixel); for a
pixel that sees a plane, the plane and each of its cells along the pixel's bundle (exact), each ray
along an axis where planes only add (ray), each ray where they dim others (dimmed), where stops cut
it (stop), or where light of every lenslet adds up, without and with a stop (lenslets); for two
polygons and a plane (polygon); and for a pixel (others)."""

TYPICAL_RAYS, RAYS_EXPONENT = 18, 0.35
"""Rays per pixel and axis that most scenes take at a tolerance of 1e-3, and how their number falls
with a larger one."""

FEWEST_RAYS, RAYS_TO_CELLS, MOST_CELLS = 5, 2.25, 41
"""Fewest rays per pixel and axis at any tolerance: three images are compared, the first with as
many rays as a bundle has cells."""

SEARCH_LINES = 40
"""Lines of the image whose rays take as long as the search for the number of rays."""

RAYS_TIMES_TOLERANCE = 0.1
"""Where planes dim others, rays per pixel and axis times the tolerance that they meet, about."""

EVERY_LENSLET = ("f_number_mismatch", "lenslet_rotation")
"""Effects by which light of every lenslet adds up in a pixel."""


def lit_pixels(layer: Layer, optics: OpticalPass) -> tuple[int, float]:
    """Count the pixels that see a layer, and the cells along their bundles at most."""
    pixels, cells = 1, 0.0
    for axis in (0, 1):
        footprint, edges = optics.footprint(layer.depth_mm, axis), layer.cell_edges_mm(axis)
        reach = footprint.half_width_mm
        ends = edges[0] - reach, edges[-1] + reach
        centres = footprint.centres_mm
        pixels *= int(np.count_nonzero((centres > ends[0]) & (centres < ends[1])))
        cells = max(cells, float(2 * reach / (edges[1] - edges[0])))
    return pixels, cells


def compare_integrators(
    scene: Scene,
    camera: PlenopticCamera,
    tolerance: float,
    kept: Collection[str],
    slabs: Sequence[int],
    traced: Collection[str],
) -> dict[str, float]:
    """Estimate the seconds of each integrator for one colour, on one core.

    "blank" is the time of the image itself, once for all colours.
    """
    optics = OpticalPass(camera, defocus="defocus" in kept)
    seen = [lit_pixels(layer, optics) for layer in scene.layers]
    blank = camera.views**2 * math.prod(camera.lenslets) * NANOSECONDS["pixel"]
    work = sum(lit * n * (1 + cells) for (lit, cells), n in zip(seen, slabs, strict=True))
    lit = sum(lit * n for (lit, _), n in zip(seen, slabs, strict=True))
    dense = RAYS_TO_CELLS * min(MOST_CELLS, max(cells for _, cells in seen))
    rays = max(FEWEST_RAYS, dense, TYPICAL_RAYS * (1e-3 / tolerance) ** RAYS_EXPONENT)
    search = 1 + SEARCH_LINES / camera.lenslets[0]
    found = {"blank": blank * 1e-9, "exact": work * NANOSECONDS["exact"] * 1e-9}
    if any(name in MATTER for name in traced):
        parts = dict(zip(scene.layers, slabs, strict=True))
        _, behind = split_planes(slice_scene(scene, parts, "self_absorption" in kept, set(traced)))
        pairs = expected_pairs(behind, optics) if behind else 0
        found["exact"] += pairs * len(behind) * NANOSECONDS["polygon"] * 1e-9
        rays = max(rays, RAYS_TIMES_TOLERANCE / tolerance)
    return {**found, "rays": lit * _nanoseconds_of_rays(traced, rays) * search * 1e-9}


def _nanoseconds_of_rays(traced: Collection[str], rays: float) -> float:
    """Time of all rays of a pixel through one plane."""
    stops = any(name in RAYS and name != "lenslet_rotation" for name in traced)
    if any(name in EVERY_LENSLET for name in traced):
        return rays**2 * NANOSECONDS["lenslets_stop" if stops else "lenslets"]
    if any(name in MATTER for name in traced):
        return rays**2 * NANOSECONDS["dimmed"]
    return rays**2 * NANOSECONDS["stop"] if stops else rays * NANOSECONDS["ray"]


def estimate_seconds(
    bounds: SceneBounds,
    kept: Collection[str],
    slabs: Sequence[int],
    colours: int,
    costs: Mapping[str, float],
    others: Mapping[str, float],
    integrator: str,
) -> dict[str, float]:
    """Roughly how long each effect takes, or would take, on one core.

    costs: of `compare_integrators`; others: the seconds without each effect that weighs rays.
    """
    camera = bounds.camera
    pixels = camera.views**2 * math.prod(camera.lenslets)
    base = costs[integrator] * colours
    seconds = dict.fromkeys(EFFECTS, 0.0)
    seconds["cos4"] = pixels * NANOSECONDS["cos4"] * 1e-9
    seconds["thickness"] = base * (1 - len(slabs) / sum(slabs))
    seconds["chromatic"] = base * (1 - 1 / colours)
    seconds |= {name: base - without * colours for name, without in others.items()}
    if camera.wavelength_nm is not None:
        for stop in ("lenslet", "main_lens"):
            seconds[f"{stop}_diffraction"] = pixels * NANOSECONDS[f"{stop}_blur"] * 1e-9
    if camera.sensor is not None:
        seconds.update(dict.fromkeys(STAGES, pixels * NANOSECONDS["noise"] * 1e-9))
    return seconds
