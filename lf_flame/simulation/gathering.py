"""Gathering the light of planes into an image: passes of light, and one of two integrators."""

import math
from collections.abc import Collection, Iterator
from dataclasses import replace

import numpy as np

from lf_flame.lightfield import LightField
from lf_flame.optics.camera import ROW_SPACING, PlenopticCamera
from lf_flame.optics.ray_bundle import ArrayPart
from lf_flame.simulation.exact import integrate
from lf_flame.simulation.optical_pass import Layout, Lines, OpticalPass, blank_image
from lf_flame.simulation.rays import trace
from lf_flame.simulation.slabs import Plane

FEW_PORTIONS = 4
"""Portions of light that are added in float32; more are added in float64."""

STRIPS = 6
"""Number of boxes in place of each of the two tapering ends of a hexagonal lenslet."""


def optical_passes(
    camera: PlenopticCamera, kept: Collection[str], traced: Collection[str], colours: int
) -> list[OpticalPass]:
    """Set up a camera with the effects that are kept: a pass for each colour.

    traced: kept effects that treat the rays of one bundle differently, see `EffectPlan`.
    """
    angle = camera.lenslet_rotation_rad if "lenslet_rotation" in traced else 0.0
    scale = 1 + (camera.lenslet_pitch_error if "lenslet_pitch_error" in kept else 0.0)
    stops: list[tuple[float, float]] = []
    width = camera.aperture_mm
    if "round_aperture" in traced:
        if "f_number_mismatch" in traced:
            width = camera.aperture_diameter_mm or width
        stops.append((camera.aperture_before_lens_mm, width / 2))
    if "vignetting" in traced and camera.rim_diameter_mm is not None:
        stops.append((camera.rim_distance_mm, camera.rim_diameter_mm / 2))
    ideal = OpticalPass(
        camera,
        share=1 / colours,
        defocus="defocus" in kept,
        falloff="cos4" in kept and not camera.falloff_corrected,
        lenslet_scale=scale * math.cos(angle),
        lenslet_skew=scale * math.sin(angle),
        stops=tuple(stops),
        every_lenslet=angle != 0 or scale != 1 or width > camera.aperture_mm,
        round_aperture="round_aperture" in traced,
    )
    middles = (np.arange(colours) + 0.5) / colours - 0.5
    focal = [camera.main_lens_focal_mm * (1 + camera.chromatic_shift * place) for place in middles]
    return [replace(ideal, focal_mm=focal_mm) for focal_mm in focal]


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
        if layout == "views":
            return views
        return LightField.trusted(views).to_raw()[None, None]
    # Where light comes in many portions, float32 would round after each.
    portions = len(planes) if rays else len(passes[0].lit_neighbours())
    many = len(passes) * portions > FEW_PORTIONS
    image = blank_image(camera, layout, np.float64 if many else np.float32)
    for optics in passes:
        if rays:
            trace(planes, optics, layout, rays, image)
        else:
            integrate(planes, optics, layout, image)
    return image.astype(np.float32, copy=False)


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
        for optics in parts:
            if rays:
                trace(planes, optics, "views", rays, image)
            else:
                integrate(planes, optics, "views", image)
        lenslets[:, :, parity::2] = image
    views = np.empty((camera.views, camera.views, rows, columns), np.float32)
    for parity in range(min(rows, 2)):
        place = 0.5 + spacing * np.arange(columns) - parity / 2
        near = np.minimum(place.astype(int), count - 2)
        lines, share = lenslets[:, :, parity::2], place - near
        views[:, :, parity::2] = lines[..., near] * (1 - share) + lines[..., near + 1] * share
    return views


def _hexagon(pitch: float) -> Iterator[tuple[float, tuple[float, float], tuple[float, float]]]:
    """Boxes of a hexagon: share of its area, height and width, place from its centre, in mm."""
    side = pitch / math.sqrt(3)
    area = 1.5 * side * pitch
    yield side * pitch / area, (side, pitch), (0.0, 0.0)
    height = side / 2 / STRIPS
    for strip in range(STRIPS):
        width = pitch * (1 - (strip + 0.5) / STRIPS)
        place = side / 2 + (strip + 0.5) * height
        for sign in (-1, 1):
            yield height * width / area, (height, width), (sign * place, 0.0)
