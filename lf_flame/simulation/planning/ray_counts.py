"""Number of rays per pixel that meets a tolerance, measured on a few lines of the image."""

import math

import numpy as np

from lf_flame._common import progress
from lf_flame.errors import InputError
from lf_flame.optics.camera import PlenopticCamera
from lf_flame.simulation.layouts import blank_image
from lf_flame.simulation.optical_pass import OpticalPass
from lf_flame.simulation.planning.plan import EffectPlan
from lf_flame.simulation.rays import trace
from lf_flame.simulation.slabs import Plane

RAY_COUNTS = (2, 3, 5, 8, 12, 18, 27, 41, 62, 93, 140, 210, 315)
"""Numbers of rays per pixel and axis that are tried."""

RAYS_SHARE = 0.5
"""Fraction of the tolerance for the error of a finite number of rays."""

PROBE_LINES = 24
"""Number of lines of the image on which the number of rays is found."""


def count_rays(
    planes: list[Plane],
    passes: list[OpticalPass],
    camera: PlenopticCamera,
    plan: EffectPlan,
    layout: str,
) -> int:
    """Find the smallest number of rays that meets the tolerance, on some lines of the image.

    The error falls as ``rays**-0.8`` or a little faster if planes with edges attenuate each other,
    and otherwise at least as one over the number of rays. The change from one number to 2.25 times
    as many, two steps of `RAY_COUNTS`, is therefore about the error of the larger number. Two
    images can agree by chance. Three are therefore compared, of which the first has at least one
    ray per cell of a bundle.

    Parameters
    ----------
    planes : list of Plane
        Planes to trace.
    passes : list of OpticalPass
        Passes of light, one for each colour.
    camera : PlenopticCamera
    plan : EffectPlan
        Plan with the tolerance of the image.
    layout : str
        Layout of the image, see `lf_flame.simulation.layouts`.

    Returns
    -------
    int
        Number of rays per pixel and axis.

    Raises
    ------
    InputError
        If the largest number of `RAY_COUNTS` does not meet the tolerance.
    """
    lines = blank_image(camera, layout).shape[2]
    probe = slice(lines // PROBE_LINES // 2, None, max(1, lines // PROBE_LINES))
    allowance = RAYS_SHARE * plan.tolerance
    coarser: list[np.ndarray] = []
    counts = RAY_COUNTS[_first_ray_count(planes, passes[0]) :]
    for rays in progress.steps(counts, "finding the number of rays", len(counts)):
        fine = blank_image(camera, layout)[:, :, probe].copy()
        for optics in passes:
            trace(planes, optics, layout, rays, fine, probe)
        changes = [math.sqrt(np.mean(np.square(fine - c, dtype=np.float64))) for c in coarser]
        if len(changes) == 2 and max(changes) <= allowance * fine.max():
            return rays
        coarser = [*coarser[-1:], fine]
    instead = "" if plan.traced else ", or use the exact integrator"
    raise InputError(
        f"tolerance {plan.tolerance:g} was not met with {rays} x {rays} rays per pixel: the number "
        f"of rays is the obstacle; allow more{instead}."
    )


def _first_ray_count(planes: list[Plane], optics: OpticalPass) -> int:
    """Index of the first of `RAY_COUNTS` with one ray per cell along a bundle, or with 41 rays."""
    dense = 1.0
    for plane in planes:
        for axis in (0, 1):
            edges = plane.layer.cell_edges_mm(axis)
            footprint = optics.footprint(plane.depth_mm, axis)
            dense = max(dense, 2 * footprint.half_width_mm / (edges[1] - edges[0]))
    return next(i for i, rays in enumerate(RAY_COUNTS) if rays >= min(dense, 41))
