"""The physical effects that a scene may call for, and how much each can change its image.

Every function of `EFFECTS` takes `SceneBounds` and returns an `Estimate`: an upper bound on the
change of any pixel (for noise: of the root-mean-square over the image), relative to the brightest
pixel, and the criterion in words and numbers. Bounds come from the scene and the camera alone,
before anything is rendered. Sources of the criteria stand with the functions.
"""

import math
from dataclasses import dataclass
from itertools import product

from lf_flame.optics.camera import PlenopticCamera
from lf_flame.optics.ray_bundle import trace_footprint
from lf_flame.simulation.bundle_shifts import (
    focus_spread,
    misplaced_mm,
    pitch_shifts_mm,
    rotation_shifts_mm,
    true_pitch_mm,
)
from lf_flame.simulation.lenslet_blur import lenslet_share_leaving
from lf_flame.simulation.main_lens_blur import main_lens_share_leaving, main_lens_spread_mm
from lf_flame.simulation.planning.probes import measured_change
from lf_flame.simulation.planning.scene_bounds import (
    SceneBounds,
    dimmed_inside,
    displaced,
    lenslets_moved,
    smeared,
    stopped_inside,
)
from lf_flame.simulation.slabs import self_absorbed
from lf_flame.simulation.stops import crosstalk, neighbours, share_cut

MEASURED = ", measured on some pixels, doubled"
"""Words where a change is no bound: see `lf_flame.simulation.planning.probes`."""


@dataclass(frozen=True)
class Estimate:
    """What leaving an effect out can cost.

    Attributes
    ----------
    bound : float
        Largest relative change of the image, derived, or measured on some of its pixels where the
        criterion says so; 0 where the effect does not arise.
    criterion : str
        Why, with its numbers.
    """

    bound: float
    criterion: str


def _defocus(bounds: SceneBounds) -> Estimate:
    """Blur by the patch of the main lens that a pixel sees: on the layer, a box of width b.

    A box moves rays by b/4 on average. (Circle of confusion for one view; Hahne et al., Opt.
    Express 24, 21521, 2016, give it for plenoptic cameras.)
    """
    change, widest = 0.0, 0.0
    for layer, axis in product(bounds.layers, (0, 1)):
        # Where a layer is thick or the lens chromatic, some of its light is more out of focus.
        seen = [
            trace_footprint(bounds.camera, depth, axis, focal)
            for depth, focal in focus_spread(bounds.camera, layer)
        ]
        width = max(abs(footprint.pixel_width_mm) for footprint in seen)
        lenslet = min(abs(footprint.lenslet_width_mm) for footprint in seen)
        widest = max(widest, width)
        change += displaced(bounds, layer, axis, width / 4, lenslet)
    words = f"a pixel's patch of the main lens blurs {widest:.3g} mm"
    return Estimate(bounds.relative(change), words)


def _occlusion(bounds: SceneBounds) -> Estimate:
    """Hide what is behind opaque layers, where some pixel's bundle meets both."""
    opaque = [layer for layer in bounds.layers if layer.opaque]
    hidden = sum(bounds.behind[layer] for layer in opaque)
    if not opaque:
        return Estimate(0.0, "no opaque layer")
    words = f"radiance up to {hidden:.3g} behind" if hidden else "nothing behind"
    return Estimate(bounds.relative(hidden), f"{words} {len(opaque)} opaque layer(s)")


def _self_absorption(bounds: SceneBounds) -> Estimate:
    """1 - (1 - exp(-tau)) / tau of a layer's own light, 1 - exp(-tau) of that behind it.

    Beer's law; Modest, Radiative Heat Transfer. Soot: tau = 6 pi E(m) f_v L / lambda.
    """
    change, thickest = 0.0, 0.0
    for layer in bounds.layers:
        tau = layer.optical_thickness
        thickest = max(thickest, float(tau.max()))
        change += float((layer.texture * (1 - self_absorbed(tau))).max())
        change += -math.expm1(-tau.max()) * bounds.behind[layer] if tau.any() else 0.0
    words = f"optical thickness up to {thickest:.3g}" if thickest else "no optical thickness"
    return Estimate(bounds.relative(change), words)


def _thickness(bounds: SceneBounds) -> Estimate:
    """Each slab of a thick layer moves on the image from where its middle plane would be."""
    change, thickest, by_pixels = 0.0, 0.0, False
    for layer in bounds.layers:
        if layer.thickness_mm > 0:
            thickest = max(thickest, layer.thickness_mm)
            moved = sum(
                smeared(bounds, layer, axis, depth_mm=layer.thickness_mm) for axis in (0, 1)
            )
            measured = measured_change(bounds, layer, "thickness")
            change, by_pixels = change + min(moved, measured), by_pixels or measured < moved
            change += stopped_inside(bounds, layer) * layer.texture.max()
            change += dimmed_inside(bounds, layer)
    if not thickest:
        return Estimate(0.0, "no layer has a thickness_mm")
    return Estimate(
        bounds.relative(change), f"{thickest:.3g} mm thick{MEASURED if by_pixels else ''}"
    )


def _cos4(bounds: SceneBounds) -> Estimate:
    """1 - cos^4 at the corner of the field, from the far corner of the pixel's own patch."""
    if bounds.camera.falloff_corrected:
        return Estimate(0.0, "falloff_corrected: divided out by a white image")
    squared = squared_tangent(bounds.camera)
    cos4 = 1 / (1 + squared) ** 2
    change = (1 - cos4) / cos4  # relative to the dimmed image too
    angle = math.degrees(math.atan(math.sqrt(squared)))
    words = f"rays tilted up to {angle:.2f} degrees"
    return Estimate(bounds.relative(change * bounds.brightest_raw), words)


def squared_tangent(camera: PlenopticCamera) -> float:
    """Largest squared tangent of a pixel's central ray behind the main lens, and of its patch.

    The ray crosses the main lens on the patches that the pixels of a lenslet see, or where a
    wider aperture is, and the array where the outermost lenslet stands.
    """
    seen, pitch_mm, farther = (camera.views - 1) * camera.view_step_mm, true_pitch_mm(camera), 0.0
    if max(misplaced_mm(camera)) > 0 or neighbours(camera):
        widest = max(camera.aperture_diameter_mm or 0.0, camera.aperture_mm) + camera.view_step_mm
        seen = widest * (1 + abs(camera.lenslet_pitch_error)) + 2 * pitch_mm
        farther = pitch_mm
    height = [
        ((lenslets - 1) * camera.lenslet_pitch_mm + seen) / 2 + farther
        for lenslets in camera.lenslets
    ]
    patch = 2 * camera.view_step_mm**2 / 12
    return (height[0] ** 2 + height[1] ** 2 + patch) / camera.image_distance_mm**2


def _round_aperture(bounds: SceneBounds) -> Estimate:
    """Round off the aperture, at matched width: it darkens the corners of every micro-image."""
    camera = bounds.camera
    if camera.aperture_diameter_mm is None:
        return Estimate(0.0, "no aperture_diameter_mm: square and matched")
    share = share_cut(camera, 0.0, camera.aperture_mm / 2)
    if camera.lenslet_pitch_error < 0:  # it is too wide for such lenslets
        share = min(1.0, share + crosstalk(camera))
    words = f"cuts up to {share:.3g} of a pixel's light"
    return Estimate(bounds.relative(share * bounds.radiance), words)


def _f_number_mismatch(bounds: SceneBounds) -> Estimate:
    """Light neighbours' pixels if the aperture is too wide; if too narrow, leave some dark.

    Ng et al., Stanford CSTR 2005-02: the f-numbers of main lens and lenslets have to match.
    """
    camera = bounds.camera
    if camera.aperture_diameter_mm is None:
        return Estimate(0.0, "no aperture_diameter_mm: matched")
    excess = (camera.aperture_diameter_mm - camera.aperture_mm) / 2
    # An arc inside a patch of side w is at most 2 w long. Beyond the matched width each ring
    # lights both its own and a neighbour's pixels.
    share = abs(excess) * (4 if excess > 0 else 2) / camera.view_step_mm
    share = min(share, float((1 + 2 * neighbours(camera)) ** 2))
    words = f"{camera.aperture_diameter_mm:.4g} mm for {camera.aperture_mm:.4g} mm"
    return Estimate(bounds.relative(share * bounds.radiance), words)


def _vignetting(bounds: SceneBounds) -> Estimate:
    """Chief ray height plus marginal ray height against the radius of the rim."""
    camera = bounds.camera
    if camera.rim_diameter_mm is None:
        return Estimate(0.0, "no rim_diameter_mm")
    share = share_cut(camera, camera.rim_distance_mm, camera.rim_diameter_mm / 2)
    words = f"the rim cuts up to {share:.3g} of a pixel's light"
    return Estimate(bounds.relative(share * bounds.brightest_raw), words)


def _lenslet_diffraction(bounds: SceneBounds) -> Estimate:
    """Share of a point's light that leaves its pixel: a square lenslet's sinc^2 at the sensor.

    Goodman, Introduction to Fourier Optics; Broxton et al., Opt. Express 21, 25418 (2013).
    """
    camera = bounds.camera
    if camera.wavelength_nm is None:
        return Estimate(0.0, "no wavelength_nm: ray optics")
    share = lenslet_share_leaving(camera)
    spread = camera.wavelength_nm * 1e-6 * camera.lenslet_focal_mm / camera.lenslet_pitch_mm
    words = f"spread {spread * 1e3:.3g} um on pixels of {camera.pixel_mm * 1e3:.3g} um"
    return Estimate(bounds.relative(share * bounds.brightest_raw), words)


def _main_lens_diffraction(bounds: SceneBounds) -> Estimate:
    """Share of a point's light that leaves its lenslet: the main lens's pattern at the array."""
    camera = bounds.camera
    if camera.wavelength_nm is None:
        return Estimate(0.0, "no wavelength_nm: ray optics")
    share, spread = main_lens_share_leaving(camera), main_lens_spread_mm(camera)
    words = f"spread {spread * 1e3:.3g} um on lenslets of {camera.lenslet_pitch_mm * 1e3:.4g} um"
    return Estimate(bounds.relative(share * bounds.brightest_raw), words)


def _lenslet_rotation(bounds: SceneBounds) -> Estimate:
    """Lenslets at the edge of a rotated array stand aside of where the sensor is read."""
    camera = bounds.camera
    if not camera.lenslet_rotation_rad:
        return Estimate(0.0, "no lenslet_rotation_rad")
    shifts = rotation_shifts_mm(camera)
    words = f"lenslets up to {max(shifts) / camera.pixel_mm:.3g} pixels aside"
    return Estimate(lenslets_moved(bounds, shifts), words)


def _lenslet_pitch_error(bounds: SceneBounds) -> Estimate:
    """Lenslets at the edge of an array of another pitch stand aside of where the sensor is read."""
    camera = bounds.camera
    if not camera.lenslet_pitch_error:
        return Estimate(0.0, "no lenslet_pitch_error")
    shifts = pitch_shifts_mm(camera)
    words = f"lenslets up to {max(shifts) / camera.pixel_mm:.3g} pixels aside"
    return Estimate(lenslets_moved(bounds, shifts), words)


def _chromatic(bounds: SceneBounds) -> Estimate:
    """Change the focal length over the band, by about its share of F-C over the Abbe number."""
    camera = bounds.camera
    if not camera.chromatic_shift:
        return Estimate(0.0, "no chromatic_shift")
    band_mm = camera.chromatic_shift * camera.main_lens_focal_mm
    change, by_pixels = 0.0, False
    for layer in bounds.layers:
        moved = sum(smeared(bounds, layer, axis, focal_mm=band_mm) for axis in (0, 1))
        measured = measured_change(bounds, layer, "chromatic")
        change, by_pixels = change + min(moved, measured), by_pixels or measured < moved
    words = f"focal length +-{band_mm / 2:.3g} mm{MEASURED if by_pixels else ''}"
    return Estimate(bounds.relative(change), words)


def _shot_noise(bounds: SceneBounds) -> Estimate:
    """1 / sqrt(electrons): Poisson (EMVA 1288 linear model)."""
    return _noise(
        bounds, lambda sensor: math.sqrt(bounds.brightest_raw * sensor.exposure_e), "shot"
    )


def _read_noise(bounds: SceneBounds) -> Estimate:
    """Read noise against the electrons of the brightest pixel (EMVA 1288 linear model)."""
    return _noise(bounds, lambda sensor: sensor.read_noise_e, "read")


def _noise(bounds: SceneBounds, electrons, kind: str) -> Estimate:
    sensor = bounds.camera.sensor
    if sensor is None:
        return Estimate(0.0, "no sensor: ideal")
    camera = bounds.camera
    pixels = camera.views**2 * camera.lenslets[0] * camera.lenslets[1]
    # The root-mean-square of n draws scatters by 1 / sqrt(2 n) of itself.
    noise = electrons(sensor) * (1 + 5 / math.sqrt(2 * pixels))
    words = (
        f"{kind} noise {electrons(sensor):.3g} of {bounds.peak * sensor.exposure_e:.3g} electrons"
    )
    return Estimate(bounds.relative(noise / sensor.exposure_e), words)


def _quantisation(bounds: SceneBounds) -> Estimate:
    """Half a step of the analogue-to-digital converter (EMVA 1288)."""
    sensor = bounds.camera.sensor
    if sensor is None:
        return Estimate(0.0, "no sensor: ideal")
    words = f"{sensor.bits} bits of {sensor.full_well_e:.4g} electrons"
    return Estimate(bounds.relative(sensor.step_e / 2 / sensor.exposure_e), words)


def _saturation(bounds: SceneBounds) -> Estimate:
    """Electrons of the brightest pixel beyond the full well."""
    sensor = bounds.camera.sensor
    if sensor is None:
        return Estimate(0.0, "no sensor: ideal")
    most = bounds.brightest_raw * sensor.exposure_e
    noise = 8 * math.hypot(math.sqrt(most), sensor.read_noise_e)
    excess = max(0.0, most + noise - sensor.full_well_e)
    words = f"up to {most:.3g} electrons of {sensor.full_well_e:.4g}"
    return Estimate(bounds.relative(excess / sensor.exposure_e), words)


EFFECTS = {
    "defocus": _defocus,
    "occlusion": _occlusion,
    "self_absorption": _self_absorption,
    "thickness": _thickness,
    "cos4": _cos4,
    "round_aperture": _round_aperture,
    "f_number_mismatch": _f_number_mismatch,
    "vignetting": _vignetting,
    "lenslet_diffraction": _lenslet_diffraction,
    "main_lens_diffraction": _main_lens_diffraction,
    "lenslet_rotation": _lenslet_rotation,
    "lenslet_pitch_error": _lenslet_pitch_error,
    "chromatic": _chromatic,
    "shot_noise": _shot_noise,
    "read_noise": _read_noise,
    "quantisation": _quantisation,
    "saturation": _saturation,
}
"""All effects by name, in the order in which light meets them."""

MATTER = ("occlusion", "self_absorption")
"""Effects by which planes hide or dim what is behind them."""

RAYS = ("round_aperture", "f_number_mismatch", "vignetting", "lenslet_rotation")
"""Effects that weigh or shift the rays of one bundle unevenly, which only tracing them can do."""

NOT_SEPARABLE = {
    "occlusion": "hides what is behind",
    "self_absorption": "dims what is behind",
    "cos4": "dims pixels by their distance from the axis",
    "round_aperture": "ends bundles in a circle",
    "f_number_mismatch": "ends bundles in a circle",
    "vignetting": "ends bundles in a circle",
    "lenslet_diffraction": "spreads light from pixel to pixel",
    "lenslet_rotation": "turns the lenslets against the scene",
    "shot_noise": "is drawn for every pixel",
    "read_noise": "is drawn for every pixel",
    "quantisation": "rounds every pixel",
    "saturation": "cuts every pixel",
}
"""Effects by which a light field is more than light that adds up along y and along x apart."""
