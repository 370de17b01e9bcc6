"""Optical effects, and an upper bound on how much each can change the image of a scene.

Each function in `EFFECTS` takes `SceneBounds` and returns an `Estimate`: an upper bound on the
change of any pixel if the effect is left out (for noise: on the root-mean-square change of the
image), relative to the brightest pixel, and the reason with its numbers. Bounds are computed from
scene and camera, before anything is rendered. The source of each formula is given in its function.

An effect whose cause a camera does not state (no wavelength: no diffraction; no sensor: no noise)
is left out because it is unknown, not because it is small; `CAUSES` has a typical value of each.
"""

import math
from collections.abc import Callable, Collection
from dataclasses import replace
from itertools import product
from typing import Any, NamedTuple

from lf_flame.optics.camera import PlenopticCamera
from lf_flame.optics.ray_bundle import trace_footprint
from lf_flame.optics.sensor import Sensor
from lf_flame.scenes.scene import Layer
from lf_flame.simulation.diffraction import (
    lenslet_share_leaving,
    main_lens_share_leaving,
    main_lens_spread_mm,
)
from lf_flame.simulation.optical_pass import (
    crosstalk,
    neighbours,
    pitch_shifts_mm,
    rotation_shifts_mm,
    share_cut,
    share_moved,
    share_vignetted,
    squared_tangent,
)
from lf_flame.simulation.planning.scene_bounds import (
    SceneBounds,
    assuming,
    box_mm,
    displaced,
    farthest_move_mm,
    focus_spread,
    lenslets_moved,
    measured_change,
    mixed_inside,
    smeared,
)
from lf_flame.simulation.slabs import self_absorbed

MEASURED = ", measured on some pixels, doubled"
"""Note on a change that was measured, not bounded: see `scene_bounds.measured_change`."""


class Estimate(NamedTuple):
    """Change of the image if an effect is left out, relative to its brightest pixel, and why."""

    bound: float
    criterion: str


def _defocus(bounds: SceneBounds) -> Estimate:
    """Blur of a layer out of focus, because a pixel collects rays from a patch of the main lens.

    On the layer these rays fill a box of some width b, and lie b/4 from its centre on average.
    (Circle of confusion of one view; Hahne et al., Opt. Express 24, 21521, 2016, give it for
    plenoptic cameras.)
    """
    change, widest = 0.0, 0.0
    for layer, axis in product(bounds.layers, (0, 1)):
        # If a layer is thick or the lens chromatic, a part of its light is farther out of focus.
        seen = [
            trace_footprint(bounds.camera, depth, axis, focal)
            for depth, focal in focus_spread(bounds.camera, layer)
        ]
        width = max(abs(footprint.pixel_width_mm) for footprint in seen)
        lenslet = min(abs(footprint.lenslet_width_mm) for footprint in seen)
        widest = max(widest, width)
        change += displaced(bounds, layer, axis, width / 4, lenslet)
    words = f"a pixel's patch of the main lens blurs {widest:.3g} mm"
    return Estimate(bounds.relative(bounds.overlap * change), words)


def _occlusion(bounds: SceneBounds) -> Estimate:
    """Occlusion of light by opaque layers, if the rays of some pixel meet both."""
    opaque = [layer for layer in bounds.layers if layer.opaque]
    hidden = bounds.overlap * sum(bounds.behind[layer] for layer in opaque)
    if not opaque:
        return Estimate(0.0, "no opaque layer")
    words = f"radiance up to {hidden:.3g} behind" if hidden else "nothing behind"
    return Estimate(bounds.relative(hidden), f"{words} {len(opaque)} opaque layer(s)")


def _self_absorption(bounds: SceneBounds) -> Estimate:
    """Absorption of a layer's own light and of light from behind, at optical thickness tau.

    The layer absorbs the fraction ``1 - (1 - exp(-tau)) / tau`` of its own light and ``1 -
    exp(-tau)`` of the light behind it (Beer's law; Modest, Radiative Heat Transfer). For soot,
    ``tau = 6 pi E(m) f_v L / lambda``.
    """
    change, thickest = 0.0, max(float(layer.optical_thickness.max()) for layer in bounds.layers)
    for layer in bounds.layers:
        tau = layer.optical_thickness
        lost = 1 - self_absorbed(tau)
        if layer.thickness_mm:  # an oblique ray leaves through other cells
            lost = lost.max()
        change += float((layer.texture * lost).max())
        change += -math.expm1(-tau.max()) * bounds.behind[layer] if tau.any() else 0.0
    words = f"optical thickness up to {thickest:.3g}" if thickest else "no optical thickness"
    return Estimate(bounds.relative(bounds.overlap * change), words)


def _thickness(bounds: SceneBounds) -> Estimate:
    """Blur of a thick layer, because its slabs are in focus at different distances.

    The change is that of replacing the layer by its middle plane.
    """
    layers = [layer for layer in bounds.layers if layer.depth_extent_mm > 0]
    if not layers:
        return Estimate(0.0, "no layer has a thickness_mm or tilt_deg")
    moved = sum(_leaning(bounds, layer, axis) for layer in layers for axis in (0, 1))
    measured = measured_change(bounds, "thickness")
    change = min(moved, measured) + sum(mixed_inside(bounds, layer) for layer in layers)
    thickest = max(layer.depth_extent_mm for layer in layers)
    words = f"{thickest:.3g} mm thick{MEASURED if measured < moved else ''}"
    return Estimate(bounds.relative(bounds.overlap * change), words)


def _leaning(bounds: SceneBounds, layer: Layer, axis: int) -> float:
    """Change of a pixel by the depths over which a layer spreads or leans."""
    change = smeared(bounds, layer, axis, depth_mm=layer.thickness_mm)
    if any(layer.tilt_deg):
        ends = (layer.depth_mm + side * layer.depth_extent_mm / 2 for side in (-1, 1))
        here = bounds.footprints[layer, axis]
        move = max(farthest_move_mm(bounds.camera, here, axis, depth) for depth in ends)
        change += displaced(bounds, layer, axis, move, box_mm(bounds, layer, axis))
    return change


def _cos4(bounds: SceneBounds) -> Estimate:
    """Fall-off of light with the angle of the rays: 1 - cos^4 at the corner of the field."""
    if bounds.camera.falloff_corrected:
        return Estimate(0.0, "falloff_corrected: divided out by a white image")
    squared = squared_tangent(bounds.camera)
    cos4 = 1 / (1 + squared) ** 2
    change = (1 - cos4) / cos4  # valid relative to the darkened image too
    angle = math.degrees(math.atan(math.sqrt(squared)))
    words = f"rays tilted up to {angle:.2f} degrees"
    return Estimate(bounds.relative(change * bounds.brightest_raw), words)


def _round_aperture(bounds: SceneBounds) -> Estimate:
    """Round aperture of matched width, which darkens the corners of each micro-image."""
    camera = bounds.camera
    if camera.aperture_diameter_mm is None:
        return Estimate(0.0, "no aperture_diameter_mm: square and matched")
    share = share_cut(camera, camera.aperture_before_lens_mm, camera.aperture_mm / 2)
    if camera.lenslet_pitch_error < 0:  # the aperture is too wide for smaller lenslets
        share = min(1.0, share + crosstalk(camera))
    words = f"cuts up to {share:.3g} of a pixel's light"
    return Estimate(bounds.relative(share * bounds.radiance), words)


def _f_number_mismatch(bounds: SceneBounds) -> Estimate:
    """Aperture that is wider or narrower than matched to the lenslets.

    If it is wider, light also reaches pixels of neighbouring lenslets; if it is narrower, some
    pixels stay dark (Ng et al., Stanford CSTR 2005-02: the f-numbers of main lens and lenslets
    must match).
    """
    camera = bounds.camera
    if camera.aperture_diameter_mm is None:
        return Estimate(0.0, "no aperture_diameter_mm: matched")
    width, matched = camera.aperture_diameter_mm, camera.aperture_mm
    # An arc inside a patch of side w is at most 2 w long. (The middle one of three views sees the
    # whole circle only of an aperture so narrow that the share reaches its limit below.) Beyond the
    # matched width each ring lights both its own and a neighbour's pixels. A single view sees all.
    share = abs(width - matched) * (2 if width > matched else 1) / camera.view_step_mm
    if camera.views == 1:
        share = math.pi / 4 * abs(width**2 - matched**2) / camera.view_step_mm**2
    share = min(share, float((1 + 2 * neighbours(camera)) ** 2))
    words = f"{camera.aperture_diameter_mm:.4g} mm for {camera.aperture_mm:.4g} mm"
    return Estimate(bounds.relative(share * bounds.radiance), words)


def _vignetting(bounds: SceneBounds) -> Estimate:
    """Light that the rim of a lens element cuts off: rays higher than the radius of the rim."""
    if bounds.camera.rim_diameter_mm is None:
        return Estimate(0.0, "no rim_diameter_mm")
    share = share_vignetted(bounds.camera)
    diffracted = bounds.brightest_raw - bounds.overlap * bounds.radiance if share else 0.0
    words = f"the rim cuts up to {share:.3g} of a pixel's light"
    return Estimate(bounds.relative(share * bounds.radiance + max(diffracted, 0.0)), words)


def _lenslet_diffraction(bounds: SceneBounds) -> Estimate:
    """Fraction of a pixel's light that diffraction by the lenslet spreads to other pixels.

    The diffraction pattern of a square lenslet on the sensor is sinc^2 along each axis (Goodman,
    Introduction to Fourier Optics; Broxton et al., Opt. Express 21, 25418, 2013).
    """
    camera = bounds.camera
    if camera.wavelength_nm is None:
        return Estimate(0.0, "no wavelength_nm: ray optics")
    share = lenslet_share_leaving(camera)
    spread = camera.wavelength_nm * 1e-6 * camera.lenslet_focal_mm / camera.lenslet_pitch_mm
    words = f"spread {spread * 1e3:.3g} um on pixels of {camera.pixel_mm * 1e3:.3g} um"
    return Estimate(bounds.relative(share * bounds.brightest_raw), words)


def _main_lens_diffraction(bounds: SceneBounds) -> Estimate:
    """Fraction of a lenslet's light that diffraction by the main lens spreads to others."""
    camera = bounds.camera
    if camera.wavelength_nm is None:
        return Estimate(0.0, "no wavelength_nm: ray optics")
    share, spread = main_lens_share_leaving(camera), main_lens_spread_mm(camera)
    words = f"spread {spread * 1e3:.3g} um on lenslets of {camera.lenslet_pitch_mm * 1e3:.4g} um"
    return Estimate(bounds.relative(share * bounds.brightest_raw), words)


def _lenslet_rotation(bounds: SceneBounds) -> Estimate:
    """Rotation of the lenslet array, which displaces lenslets at its edge against the pixels."""
    camera = bounds.camera
    if not camera.lenslet_rotation_rad:
        return Estimate(0.0, "no lenslet_rotation_rad")
    shifts = rotation_shifts_mm(camera)
    words = f"lenslets up to {max(shifts) / camera.pixel_mm:.3g} pixels aside"
    return Estimate(lenslets_moved(bounds, shifts), words)


def _lenslet_pitch_error(bounds: SceneBounds) -> Estimate:
    """Error of the lenslet pitch, which displaces lenslets at the edge against the pixels."""
    camera = bounds.camera
    if not camera.lenslet_pitch_error:
        return Estimate(0.0, "no lenslet_pitch_error")
    shifts = pitch_shifts_mm(camera)
    words = f"lenslets up to {max(shifts) / camera.pixel_mm:.3g} pixels aside"
    return Estimate(lenslets_moved(bounds, shifts), words)


def _chromatic(bounds: SceneBounds) -> Estimate:
    """Chromatic shift: the focal length of the main lens changes over the band of light.

    Between the F and C lines, it changes by about its value divided by the Abbe number.
    """
    camera = bounds.camera
    if not camera.chromatic_shift:
        return Estimate(0.0, "no chromatic_shift")
    band_mm = camera.chromatic_shift * camera.main_lens_focal_mm
    moved = sum(
        smeared(bounds, layer, axis, focal_mm=band_mm) for layer in bounds.layers for axis in (0, 1)
    )
    measured = measured_change(bounds, "chromatic")
    words = f"focal length +-{band_mm / 2:.3g} mm{MEASURED if measured < moved else ''}"
    cut = share_vignetted(camera)  # stops cut colours differently, away from the lens
    if camera.aperture_diameter_mm is not None and camera.aperture_before_lens_mm:
        cut += share_moved(camera, camera.aperture_before_lens_mm)
    change = bounds.overlap * min(moved, measured) + cut * bounds.radiance
    return Estimate(bounds.relative(change), words)


def _shot_noise(bounds: SceneBounds) -> Estimate:
    """Shot noise: 1 / sqrt(electrons) of the brightest pixel (Poisson; EMVA 1288)."""
    sensor = bounds.camera.sensor
    electrons = math.sqrt(bounds.brightest_raw * sensor.exposure_e) if sensor else 0.0
    return _noise(bounds, "shot", electrons)


def _read_noise(bounds: SceneBounds) -> Estimate:
    """Read noise relative to the electrons of the brightest pixel (EMVA 1288)."""
    sensor = bounds.camera.sensor
    return _noise(bounds, "read", sensor.read_noise_e if sensor else 0.0)


def _noise(bounds: SceneBounds, kind: str, electrons: float) -> Estimate:
    camera, sensor = bounds.camera, bounds.camera.sensor
    if sensor is None:
        return Estimate(0.0, "no sensor: ideal")
    # The root mean square of n random draws has a relative standard deviation of 1 / sqrt(2 n).
    pixels = camera.views**2 * camera.lenslets[0] * camera.lenslets[1]
    noise = electrons * (1 + 5 / math.sqrt(2 * pixels))
    words = f"{kind} noise {electrons:.3g} of {bounds.peak * sensor.exposure_e:.3g} electrons"
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
"""Functions that estimate the effects, by name, in the order in which light meets them."""

MATTER = ("occlusion", "self_absorption")
"""Effects by which layers occlude or attenuate light from behind."""

RAYS = ("round_aperture", "f_number_mismatch", "vignetting", "lenslet_rotation")
"""Effects that treat the rays of one pixel's bundle differently, and so need traced rays."""

NOT_SEPARABLE = {
    "occlusion": "occludes light from behind",
    "self_absorption": "attenuates light from behind",
    "cos4": "darkens pixels by their distance from the axis",
    "round_aperture": "limits bundles of rays by a circle",
    "f_number_mismatch": "limits bundles of rays by a circle",
    "vignetting": "limits bundles of rays by a circle",
    "lenslet_diffraction": "spreads light from pixel to pixel",
    "lenslet_rotation": "rotates the lenslets against the scene",
    "shot_noise": "is drawn for each pixel",
    "read_noise": "is drawn for each pixel",
    "quantisation": "rounds each pixel",
    "saturation": "clips each pixel",
    "layout": "of hexagons couples the sums along y and along x",
}
"""Effects, and a layout, for which light is not summed along y and along x apart, with reasons."""

TYPICAL_SENSOR = Sensor(exposure_e=8_000.0, full_well_e=10_000.0, bits=12, read_noise_e=2.0)
"""Sensor of an industrial camera: full well and noise as in EMVA 1288 data sheets of small pixels,
with an exposure of four fifths of the full well."""


class Cause(NamedTuple):
    """Cause of an effect: a field of a camera, its value if not stated, and a typical one."""

    field: str
    unstated: Any
    typical: Callable[[PlenopticCamera], Any] | None
    words: str


_SENSOR = Cause("sensor", None, lambda camera: TYPICAL_SENSOR, "10,000 electrons, 12 bits")
_WAVELENGTH = Cause("wavelength_nm", None, lambda camera: 550.0, "550 nm")

CAUSES = {
    "cos4": Cause("falloff_corrected", True, lambda camera: False, "without a white image"),
    "round_aperture": Cause(
        "aperture_diameter_mm", None, lambda camera: camera.aperture_mm, "a round, matched stop"
    ),
    "f_number_mismatch": Cause(
        "aperture_diameter_mm", None, lambda camera: 1.05 * camera.aperture_mm, "a stop 5 % wider"
    ),
    "vignetting": Cause("rim_diameter_mm", None, None, ""),
    "lenslet_diffraction": _WAVELENGTH,
    "main_lens_diffraction": _WAVELENGTH,
    # Calibration files of two Lytro cameras state 0.54 and 0.86 mrad, 0.034 and 0.037 %.
    "lenslet_rotation": Cause("lenslet_rotation_rad", 0.0, lambda camera: 7e-4, "0.7 mrad"),
    "lenslet_pitch_error": Cause("lenslet_pitch_error", 0.0, lambda camera: 3.5e-4, "0.035 %"),
    # Secondary spectrum of an achromat: W. J. Smith, Modern Optical Engineering.
    "chromatic": Cause("chromatic_shift", 0.0, lambda camera: 1 / 2400, "an achromat"),
    "shot_noise": _SENSOR,
    "read_noise": _SENSOR,
    "quantisation": _SENSOR,
    "saturation": _SENSOR,
}
"""Causes of the effects that follow from a camera's optional fields; other effects follow from the
scene."""


def is_stated(camera: PlenopticCamera, effect: str, stated: Collection[str] = ()) -> bool:
    """Whether a camera, or a list of fields that a file names, states the cause of an effect."""
    cause = CAUSES.get(effect)
    if cause is None or getattr(camera, cause.field) != cause.unstated:
        return True
    return cause.unstated is not None and cause.field in stated


def typical_bounds(bounds: SceneBounds, stated: Collection[str] = ()) -> dict[str, float]:
    """Bound each effect whose cause a camera does not state, at its typical value, if any."""
    camera, found = bounds.camera, {}
    for name, cause in CAUSES.items():
        if is_stated(camera, name, stated) or cause.typical is None:
            continue
        assumed = replace(camera, **{cause.field: cause.typical(camera)})
        found[name] = EFFECTS[name](assuming(bounds, assumed)).bound
    return found
