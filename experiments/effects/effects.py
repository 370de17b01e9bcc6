"""Each effect, rendered by the library, against the reference tracer and closed forms.

A trial is a small flame before a camera, with what calls for one effect. Pixels are those that the
effect changes most, and as many drawn at random. All numbers are relative to the brightest pixel.
"""

import math
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from experiments.effects import bounds
from experiments.effects.tracer import trace_pixels
from experiments.report import markdown, panels, step_bar, write_report
from lf_flame._common.config import to_json
from lf_flame.optics.camera import PAPER_CAMERA, PlenopticCamera
from lf_flame.optics.sensor import STAGES, Sensor
from lf_flame.scenes.flames import HALF_WIDTH, flame_texture
from lf_flame.scenes.scene import Layer, Scene
from lf_flame.simulation.planning.plan import plan_effects
from lf_flame.simulation.rendering import render

TOLERANCE = 1e-3
"""Tolerance of the images that the library makes."""

PIXELS, RAYS, REPEATS, SEED = 24, 2**12, 8, 1
"""Number of pixels traced for each effect, half of them those that change most; number of rays
through each lenslet in each randomisation; number of randomisations."""

WINDOW = (20, 24)
"""Number of lenslet rows and columns that are recorded, in the middle of each array."""


def _sold(**optics) -> PlenopticCamera:
    """Camera with pixels of 1.4 um, and square lenslets instead of hexagonal ones."""
    return PlenopticCamera(**optics, lenslets=WINDOW, pixel_pitch_mm=0.0014)


CAMERAS = {
    "paper": replace(PAPER_CAMERA, lenslets=WINDOW),
    # Two cameras that were sold, by the metadata of their files (devices.mla.lensPitch and
    # .sensorOffset.z, devices.sensor.pixelPitch, devices.lens.focalLength) in imageio's samples;
    # focused at a hand's and at an arm's length.
    "Lytro F01": _sold(
        main_lens_focal_mm=6.84, focus_distance_mm=150.0, lenslet_focal_mm=0.025,
        lenslet_pitch_mm=0.014, views=10,
    ),
    "Lytro Illum": _sold(
        main_lens_focal_mm=24.2, focus_distance_mm=500.0, lenslet_focal_mm=0.037,
        lenslet_pitch_mm=0.020, views=14,
    ),
}  # fmt: skip
"""Cameras by name, without imperfections; each trial adds its own."""

DIFFRACTION = {"lenslet_diffraction": ("lenslet",), "main_lens_diffraction": ("main_lens",)}
"""Openings whose diffraction the tracer adds, by effect."""

NOISE = ("shot_noise", "read_noise")
"""Effects whose change is a root-mean-square over the image, and has a closed form."""


Trial = tuple[Scene, PlenopticCamera]
"""A scene and a camera that call for an effect."""


def effect_trials(camera: PlenopticCamera, lenslets_high: int = 16) -> dict[str, Trial]:
    """Set up, for each effect, a small flame before a camera in which the effect matters.

    Sizes and depths follow from the camera: the flame is as many lenslets high as given, and its
    layers have the slopes 0.4, 0.8 and -0.4.
    """
    near, far, front = (camera.slope_to_depth(slope) for slope in (0.4, 0.8, -0.4))
    height = lenslets_high * camera.field_mm(near)[0] / camera.lenslets[0]
    texture = flame_texture(height, height / 8, cell_mm=height / 60)
    size = (height, 2 * HALF_WIDTH * height / 8)
    flame, behind = Layer(texture, near, size), Layer(texture, far, size)
    card = Layer(np.zeros((1, 1)), front, (height / 4, height / 5), opaque=True)
    thick_mm = camera.slope_to_depth(0.5) - camera.slope_to_depth(0.3)
    lone = Scene([flame])

    def before(scene: Scene = lone, **changes) -> Trial:
        return scene, replace(camera, **changes)

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


def measure_effect(name: str, camera: str, trial: Trial, rays: int = RAYS) -> dict:
    """Compare one effect of the library with its reference.

    Returns ``effect`` and ``camera``; ``reference`` and ``library`` in the pixel where they differ
    most (for noise: root-mean-square over the image) and their ``difference``; ``rms_difference``
    over the pixels; ``reference_error``, the standard error in that pixel; ``change``, the largest
    that the effect makes by the reference; ``bound``, the plan's; ``looseness``, bound over change.
    """
    on, off = (_render(trial, name, kept) for kept in (True, False))
    peak = max(float(off.max()), 1e-300)
    bound = plan_effects(*trial, TOLERANCE)[name].bound
    compare = _compare_noise if name in NOISE else _compare_pixels
    reference, library, rms, error, change = (
        float(value) / peak for value in compare(name, trial, on, off, rays)
    )
    return {
        "effect": name,
        "camera": camera,
        "reference": reference,
        "library": library,
        "difference": library - reference,
        "rms_difference": rms,
        "reference_error": error,
        "change": change,
        "bound": bound,
        "looseness": bound / change if change > 0 else math.nan,
    }


def _render(trial: Trial, name: str, kept: bool) -> np.ndarray:
    """Image with or without an effect, without the other causes that its trial brings."""
    forced = dict.fromkeys([*STAGES, *DIFFRACTION], False) | {name: kept}
    if name == "round_aperture":
        forced["f_number_mismatch"] = False
    if name == "f_number_mismatch":
        forced["round_aperture"] = True  # the matched round aperture is what it departs from
    image = render(*trial, TOLERANCE, effects=forced, seed=SEED)
    return image.views.astype(np.float64)


def _compare_noise(name: str, trial: Trial, on: np.ndarray, off: np.ndarray, _rays: int) -> tuple:
    """Noise by EMVA 1288: variance of the electrons is their mean, or that of the read noise."""
    sensor = trial[1].sensor
    electrons = off * sensor.exposure_e if name == "shot_noise" else sensor.read_noise_e**2
    reference = math.sqrt(np.mean(electrons)) / sensor.exposure_e
    library = math.sqrt(np.mean((on - off) ** 2))
    error = reference / math.sqrt(2 * on.size)  # of a root-mean-square of so many draws
    return reference, library, abs(library - reference), error, reference


def _compare_pixels(name: str, trial: Trial, on: np.ndarray, off: np.ndarray, rays: int) -> tuple:
    """Compare some pixels with the tracer, behind which the sensor is a closed form."""
    pixels = _choose_pixels(on, off)
    patterns = DIFFRACTION.get(name, ())
    mean, error = trace_pixels(*trial, pixels, rays, REPEATS, SEED, patterns)
    reference, error = _behind_the_sensor(name, trial[1].sensor, mean, error)
    at = tuple(pixels.T)
    difference = on[at] - reference
    worst = int(np.abs(difference).argmax())
    rms, change = np.sqrt(np.mean(difference**2)), np.abs(reference - off[at]).max()
    return reference[worst], on[at][worst], rms, error[worst], change


def _choose_pixels(on: np.ndarray, off: np.ndarray) -> np.ndarray:
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


def run_effects(out: Path, scenes: int, seed: int = 0, rays: int = RAYS) -> Path:
    """Measure all effects, check the bounds on random scenes, and write ``effects.*``.

    `rays` of the tracer are a power of 2.
    """
    started = time.perf_counter()
    trials = [
        (name, camera, trial)
        for camera, optics in CAMERAS.items()
        for name, trial in effect_trials(optics).items()
    ]
    record = {
        "cameras": {name: to_json(camera) for name, camera in CAMERAS.items()},
        "tolerance": TOLERANCE,
        "pixels": PIXELS,
        "rays": rays,
        "repeats": REPEATS,
        "seed": SEED,
        "rows": [measure_effect(*trial, rays) for trial in step_bar(trials)],
        "bounds": bounds.check_bounds(scenes, seed),
    } | {"wall_s": time.perf_counter() - started}
    return write_report(
        out, "effects", "Every effect beside a reference tracer", record, body(record),
        tables={"effects": pd.DataFrame(record["rows"])},
        pictures={"effects": _figure(record["rows"])},
    )  # fmt: skip


COLUMNS = {
    "effect": ("effect", ""),
    "reference": ("reference", ".4f"),
    "library": ("library", ".4f"),
    "difference": ("difference", ".1e"),
    "rms_difference": ("rms", ".1e"),
    "reference_error": ("error of the reference", ".0e"),
    "change": ("largest change", ".2g"),
    "bound": ("bound", ".2g"),
    "looseness": ("bound / change", ".2f"),
}


def body(record: dict) -> list[str]:
    """Write the tables, and what they rest on, as Markdown."""
    parts = [
        "A small flame with what calls for the effect, rendered at tolerance "
        f"{record['tolerance']:g}, compared with `experiments/effects/tracer.py`: {record['rays']} "
        f"rays through each lenslet in each of {record['repeats']} randomisations, in "
        f"{record['pixels']} pixels, half of them those that change most. Saturation and "
        "quantisation of the traced light are closed forms, and so is noise (EMVA 1288), as a "
        "root-mean-square over the image.",
        "All values are relative to the brightest pixel without the effect. Reference and library: "
        "in the pixel where they differ most. rms: of the differences over all traced pixels. "
        "Largest change: made by the effect, by the reference. Bound: the plan's, for any pixel.",
        "![Change, bound and difference of each effect](effects.png)",
    ]
    for name, camera in record["cameras"].items():
        rows = [row for row in record["rows"] if row["camera"] == name]
        parts += [
            f"## {name}",
            "Main lens of {main_lens_focal_mm:g} mm, focused at {focus_distance_mm:g} mm; a window "
            "of {lenslets[0]} x {lenslets[1]} lenslets of {lenslet_pitch_mm:g} mm, each with "
            "{views} x {views} views.".format(**camera),
            markdown(rows, COLUMNS, missing="inf"),
        ]
    return [*parts, *bounds.body(record["bounds"])]


def _figure(rows: list[dict]) -> Figure:
    """Draw the change, the bound and the difference from the tracer for each camera and effect."""
    cameras = list(dict.fromkeys(row["camera"] for row in rows))
    drawn, axes = panels(cameras, (3.6 * len(cameras) + 1, 5), sharey=True)
    for axis, camera in zip(axes, cameras, strict=True):
        one = pd.DataFrame([row for row in rows if row["camera"] == camera])
        apart = one.difference.abs().clip(lower=1e-7)
        axis.hlines(one.index, apart, one.change, color="0.85", zorder=0)
        axis.plot(one.bound.clip(upper=50), one.index, "k|", ms=10, label="bound of the plan")
        axis.plot(one.change, one.index, "o", color="#0072B2", ms=5, label="largest change")
        axis.plot(apart, one.index, "X", color="#D55E00", ms=5, label="library - tracer")
        axis.set(xscale="log", xlim=(5e-8, 60), ylim=(len(one) - 0.5, -0.5))
        axis.set_yticks(one.index, [name.replace("_", " ") for name in one.effect])
    drawn.supxlabel("relative to the brightest pixel (differences below 1e-7 at 1e-7)", fontsize=9)
    drawn.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return drawn
