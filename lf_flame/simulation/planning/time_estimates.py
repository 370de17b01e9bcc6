"""Estimates of the time to render an image, by integrator and effect, from measured rates."""

import math
from collections.abc import Collection, Mapping, Sequence

import numpy as np

from lf_flame.optics.camera import PlenopticCamera
from lf_flame.optics.sensor import STAGES
from lf_flame.scenes.scene import Layer, Scene
from lf_flame.simulation.optical_pass import OpticalPass
from lf_flame.simulation.planning.effects import EFFECTS, MATTER, RAYS
from lf_flame.simulation.planning.scene_bounds import SceneBounds

NANOSECONDS = {
    "pixel": 1.0,
    "exact": 2.5,
    "ray": 4.0,
    "dimmed": 6.0,
    "stop": 11.5,
    "lenslets": 24.0,
    "lenslets_stop": 60.0,
    "cos4": 0.25,
    "lenslet_blur": 420.0,
    "main_lens_blur": 35.0,
    "noise": 18.0,
}
"""Time in nanoseconds on one core, as measured for the tables of costs.

- ``pixel``: per pixel of the image;
- ``exact``: per pixel that sees a plane, for the plane and for each cell along an axis of its
  bundle;
- ``ray``: per pixel that sees a plane and per ray along an axis, if light only adds up;
- ``dimmed``, ``stop``, ``lenslets``, ``lenslets_stop``: per pixel that sees a plane and per ray, if
  planes attenuate others, if stops cut off rays, and if the light of all lenslets adds up in a
  pixel, without and with a stop;
- others: per pixel."""

TYPICAL_RAYS, RAYS_EXPONENT = 18, 0.35
"""Typical number of rays per pixel and axis at a tolerance of 1e-3, and the exponent with which it
falls for larger tolerances."""

FEWEST_RAYS, RAYS_TO_CELLS, MOST_CELLS = 5, 2.25, 41
"""Smallest number of rays per pixel and axis at any tolerance; its ratio to the number of cells
along an axis of a bundle, because the search for the number compares three images and the first has
one ray per cell; and the largest number of cells that counts."""

SEARCH_LINES = 40
"""Time of the search for the number of rays, as the number of lines traced in the same time."""

RAYS_TIMES_TOLERANCE = 0.1
"""Number of rays per pixel and axis times tolerance, if planes attenuate others."""

EVERY_LENSLET = ("f_number_mismatch", "lenslet_rotation")
"""Effects with which a pixel can receive light through every lenslet."""


def lit_pixels(layer: Layer, optics: OpticalPass) -> tuple[int, float]:
    """Count the pixels that see a layer, and the cells along an axis of the widest bundle."""
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
    """Estimate the time of each integrator for one colour, in seconds on one core.

    Parameters
    ----------
    scene : Scene
    camera : PlenopticCamera
    tolerance : float
        Tolerance of the image, which determines the number of rays.
    kept : collection of str
        Effects that are simulated.
    slabs : sequence of int
        Number of planes for each layer of the scene.
    traced : collection of str
        Effects that treat the rays of one bundle differently.

    Returns
    -------
    dict of str to float
        Times of "exact" and "rays", and of "blank": the empty image, once for all colours.
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
        rays = max(rays, RAYS_TIMES_TOLERANCE / tolerance)
    return {**found, "rays": lit * _nanoseconds_of_rays(traced, rays) * search * 1e-9}


def _nanoseconds_of_rays(traced: Collection[str], rays: float) -> float:
    """Time in nanoseconds of all rays of one pixel through one plane."""
    stops = any(name in RAYS and name != "lenslet_rotation" for name in traced)
    if any(name in EVERY_LENSLET for name in traced):
        return rays**2 * NANOSECONDS["lenslets_stop" if stops else "lenslets"]
    if any(name in MATTER for name in traced):
        return rays**2 * NANOSECONDS["dimmed"]
    return rays**2 * NANOSECONDS["stop"] if stops else rays * NANOSECONDS["ray"]


def estimate_seconds(
    bounds: SceneBounds,
    slabs: Sequence[int],
    colours: int,
    cost: float,
    without: Mapping[str, float],
) -> dict[str, float]:
    """Estimate the time that each effect adds, or would add, in seconds on one core.

    Parameters
    ----------
    bounds : SceneBounds
    slabs : sequence of int
        Number of planes for each layer of the scene.
    colours : int
        Number of focal lengths.
    cost : float
        Time of the chosen integrator for one colour, see `compare_integrators`.
    without : mapping of str to float
        The same without each of the effects that treat the rays of one bundle differently.
    """
    camera = bounds.camera
    pixels = camera.views**2 * math.prod(camera.lenslets)
    base = cost * colours
    seconds = dict.fromkeys(EFFECTS, 0.0)
    seconds["cos4"] = pixels * NANOSECONDS["cos4"] * 1e-9
    seconds["thickness"] = base * (1 - len(slabs) / sum(slabs))
    seconds["chromatic"] = base * (1 - 1 / colours)
    seconds |= {name: base - other * colours for name, other in without.items()}
    if camera.wavelength_nm is not None:
        for stop in ("lenslet", "main_lens"):
            seconds[f"{stop}_diffraction"] = pixels * NANOSECONDS[f"{stop}_blur"] * 1e-9
    if camera.sensor is not None:
        seconds.update(dict.fromkeys(STAGES, pixels * NANOSECONDS["noise"] * 1e-9))
    return seconds
