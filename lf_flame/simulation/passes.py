"""Passes of light through the camera as a plan leaves it: one for each colour."""

import math
from dataclasses import replace

import numpy as np

from lf_flame.optics.camera import PlenopticCamera
from lf_flame.simulation.optical_pass import OpticalPass
from lf_flame.simulation.planning.plan import EffectPlan


def optical_passes(camera: PlenopticCamera, plan: EffectPlan) -> list[OpticalPass]:
    """Set up the camera as a plan leaves it: a pass for each colour."""
    kept = plan.kept
    angle = camera.lenslet_rotation_rad if "lenslet_rotation" in plan.traced else 0.0
    scale = 1 + (camera.lenslet_pitch_error if "lenslet_pitch_error" in kept else 0.0)
    stops: list[tuple[float, float]] = []
    width = camera.aperture_mm
    if "round_aperture" in plan.traced:
        if "f_number_mismatch" in plan.traced:
            width = camera.aperture_diameter_mm or width
        stops.append((camera.aperture_before_lens_mm, width / 2))
    if "vignetting" in plan.traced and camera.rim_diameter_mm is not None:
        stops.append((camera.rim_distance_mm, camera.rim_diameter_mm / 2))
    ideal = OpticalPass(
        camera,
        share=1 / plan.colours,
        defocus="defocus" in kept,
        falloff="cos4" in kept and not camera.falloff_corrected,
        lenslet_scale=scale * math.cos(angle),
        lenslet_skew=scale * math.sin(angle),
        stops=tuple(stops),
        every_lenslet=angle != 0 or scale != 1 or width > camera.aperture_mm,
        round_aperture="round_aperture" in plan.traced,
    )
    middles = (np.arange(plan.colours) + 0.5) / plan.colours - 0.5
    focal = [camera.main_lens_focal_mm * (1 + camera.chromatic_shift * place) for place in middles]
    return [replace(ideal, focal_mm=focal_mm) for focal_mm in focal]
