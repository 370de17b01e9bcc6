"""Each effect, rendered by the library, beside the reference tracer and closed forms.

A trial is a small flame before a camera, with what calls for one effect. Pixels are those that the
effect changes most, and as many drawn at random. All numbers are relative to the brightest pixel.
"""

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from experiments.command_parts import step_bar
from experiments.effects.cameras import CAMERAS
from experiments.effects.ray_tracer import trace_pixels
from lf_flame._common.config import to_json
from lf_flame.optics.camera import PlenopticCamera
from lf_flame.optics.sensor import STAGES, Sensor
from lf_flame.scenes.flames import HALF_WIDTH, flame_texture
from lf_flame.scenes.scene import Layer, Scene
from lf_flame.simulation.planning.decisions import plan_effects
from lf_flame.simulation.rendering import render

TOLERANCE = 1e-3
"""Tolerance of the images that the library makes."""

PIXELS = 24
"""Pixels that are traced for each effect: half of them those that change most."""

RAYS = 2**12
"""Rays of the tracer through each lenslet, in each of its randomisations."""

REPEATS = 8
"""Randomisations."""

SEED = 1

DIFFRACTION = {"lenslet_diffraction": ("lenslet",), "main_lens_diffraction": ("main_lens",)}
"""Openings whose diffraction the tracer adds, by effect."""

NOISE = ("shot_noise", "read_noise")
"""Effects whose change is a root-mean-square over the image, and has a closed form."""


@dataclass(frozen=True)
class Trial:
    """A scene and a camera that call for an effect."""

    scene: Scene
    camera: PlenopticCamera


def effect_trials(camera: PlenopticCamera, lenslets_high: int = 16) -> dict[str, Trial]:
    """Set up, for each effect, a small flame before a camera in which the effect matters.

    Sizes and depths follow from the camera: the flame is 16 lenslets high, or as many as given,
    and its layers stand where the slope is 0.4, 0.8 or -0.4.
    """
    near, far, front = (camera.slope_to_depth(slope) for slope in (0.4, 0.8, -0.4))
    lenslet_mm = camera.field_mm(near)[0] / camera.lenslets[0]
    height = lenslets_high * lenslet_mm
    texture = flame_texture(height, height / 8, cell_mm=height / 60)
    size = (height, 2 * HALF_WIDTH * height / 8)
    flame, behind = Layer(texture, near, size), Layer(texture, far, size)
    card = Layer(np.zeros((1, 1)), front, (height / 4, height / 5), opaque=True)
    thick_mm = camera.slope_to_depth(0.5) - camera.slope_to_depth(0.3)
    lone = Scene([flame])

    def before(scene: Scene = lone, **changes) -> Trial:
        return Trial(scene, replace(camera, **changes))

    width = camera.aperture_mm
    distance = 0.3 * camera.focus_distance_mm
    aside = 0.5 / max(camera.lenslets)  # lenslets at the end move by a quarter of their pitch
    return {
        "defocus": before(),
        "occlusion": before(Scene([flame, card])),
        "self_absorption": before(Scene([replace(flame, optical_thickness=0.5 * texture), behind])),
        "thickness": before(Scene([replace(flame, thickness_mm=thick_mm)])),
        "cos4": before(falloff_corrected=False),
        "round_aperture": before(aperture_diameter_mm=width),
        "f_number_mismatch": before(aperture_diameter_mm=1.1 * width),
        "vignetting": before(rim_diameter_mm=0.6 * width, rim_distance_mm=distance),
        "lenslet_diffraction": before(wavelength_nm=550.0),
        "main_lens_diffraction": before(wavelength_nm=550.0),
        "lenslet_rotation": before(lenslet_rotation_rad=aside),
        "lenslet_pitch_error": before(lenslet_pitch_error=aside),
        "chromatic": before(chromatic_shift=0.01),
        "shot_noise": before(sensor=Sensor(8000.0)),
        "read_noise": before(sensor=Sensor(8000.0, read_noise_e=20.0)),
        "quantisation": before(sensor=Sensor(8000.0, bits=8)),
        "saturation": before(sensor=Sensor(8000.0, full_well_e=4000.0)),
    }


def measure_effects(cameras: Mapping[str, PlenopticCamera] = CAMERAS, rays: int = RAYS) -> dict:
    """Measure every effect on every camera; the tracer's rays are a power of 2.

    Returns the record, in ``rows`` one for each effect and camera.
    """
    started = time.perf_counter()
    trials = [
        (name, camera, trial)
        for camera, optics in cameras.items()
        for name, trial in effect_trials(optics).items()
    ]
    steps = (measure_effect(name, camera, trial, rays) for name, camera, trial in trials)
    rows = list(step_bar(steps, len(trials)))
    return {
        "cameras": {name: to_json(camera) for name, camera in cameras.items()},
        "tolerance": TOLERANCE,
        "pixels": PIXELS,
        "rays": rays,
        "repeats": REPEATS,
        "seed": SEED,
        "wall_s": time.perf_counter() - started,
        "rows": rows,
    }


def measure_effect(name: str, camera: str, trial: Trial, rays: int = RAYS) -> dict:
    """Set one effect of the library beside its reference.

    Returns ``effect`` and ``camera``; ``reference`` and ``library``, in the pixel where they differ
    most (for noise: root-mean-square over the image); ``difference``, of these two;
    ``rms_difference`` over the pixels; ``reference_error``, the standard error in that pixel;
    ``change``, the largest that the effect makes by the reference; ``bound``, the plan's;
    ``looseness``, the bound over the change.
    """
    on, off = (_render(trial, name, kept) for kept in (True, False))
    peak = max(float(off.max()), 1e-300)
    bound = plan_effects(trial.scene, trial.camera, TOLERANCE)[name].bound
    if name in NOISE:
        found = _noise_row(name, trial, on, off)
    else:
        found = _pixel_row(name, trial, on, off, rays)
    found = {key: value / peak for key, value in found.items()}
    looseness = bound / found["change"] if found["change"] > 0 else math.nan
    return {"effect": name, "camera": camera, **found, "bound": bound, "looseness": looseness}


def _render(trial: Trial, name: str, kept: bool) -> np.ndarray:
    """Image with or without an effect, without the other causes that its trial brings."""
    forced = dict.fromkeys([*STAGES, *DIFFRACTION], False) | {name: kept}
    if name == "round_aperture":
        forced["f_number_mismatch"] = False
    if name == "f_number_mismatch":
        forced["round_aperture"] = True  # the matched round aperture is what it departs from
    image = render(trial.scene, trial.camera, TOLERANCE, effects=forced, seed=SEED)
    return image.views.astype(np.float64)


def _noise_row(name: str, trial: Trial, on: np.ndarray, off: np.ndarray) -> dict:
    """Noise by EMVA 1288: variance of the electrons is their mean, or that of the read noise."""
    sensor = trial.camera.sensor
    electrons = off * sensor.exposure_e if name == "shot_noise" else sensor.read_noise_e**2
    reference = math.sqrt(np.mean(electrons)) / sensor.exposure_e
    library = math.sqrt(np.mean((on - off) ** 2))
    error = reference / math.sqrt(2 * on.size)  # of a root-mean-square of so many draws
    return _row(reference, library, library - reference, error, reference)


def _pixel_row(name: str, trial: Trial, on: np.ndarray, off: np.ndarray, rays: int) -> dict:
    """Compare some pixels with the tracer, behind which the sensor is a closed form."""
    pixels = _chosen_pixels(on, off)
    patterns = DIFFRACTION.get(name, ())
    traced = trace_pixels(
        trial.scene, trial.camera, pixels, rays, REPEATS, SEED, diffraction=patterns
    )
    reference, error = _behind_the_sensor(name, trial.camera.sensor, traced.mean, traced.error)
    at = tuple(pixels.T)
    difference = on[at] - reference
    worst = int(np.abs(difference).argmax())
    return _row(
        float(reference[worst]),
        float(on[at][worst]),
        float(np.sqrt(np.mean(difference**2))),
        float(error[worst]),
        float(np.abs(reference - off[at]).max()),
    )


def _row(reference: float, library: float, rms: float, error: float, change: float) -> dict:
    return {
        "reference": reference,
        "library": library,
        "difference": library - reference,
        "rms_difference": abs(rms),
        "reference_error": error,
        "change": change,
    }


def _chosen_pixels(on: np.ndarray, off: np.ndarray) -> np.ndarray:
    """Pixels (v, u, t, s) that change most, and some drawn among those with light."""
    changes = np.abs(on - off).ravel()
    most = np.argsort(changes)[-PIXELS // 2 :]
    lit = np.flatnonzero(np.maximum(on, off).ravel() > 0)
    some = np.random.default_rng(SEED).choice(lit, PIXELS - most.size)
    return np.stack(np.unravel_index(np.concatenate([most, some]), on.shape), axis=1)


def _behind_the_sensor(name: str, sensor: Sensor | None, mean: np.ndarray, error: np.ndarray):
    """Clip or round what the tracer found, as the stage of the sensor does."""
    if name == "saturation" and sensor is not None:
        return np.minimum(mean, sensor.full_well_e / sensor.exposure_e), error
    if name == "quantisation" and sensor is not None:
        step = sensor.full_well_e / (2**sensor.bits - 1) / sensor.exposure_e
        low, high = (np.rint((mean + side * 3 * error) / step) for side in (-1, 1))
        # Between two numbers a small error decides.
        return np.rint(mean / step) * step, np.where(low == high, error, step)
    return mean, error
