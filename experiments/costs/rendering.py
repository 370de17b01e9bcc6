"""What accuracy costs in time: error against seconds, for each integration method and each effect.

All runs take one thread of one machine, one after the other, compiled beforehand, so that ratios
are fair. Errors are root-mean-square over the image relative to its brightest pixel, against an
image multiplied out in float64 (`lf_flame.simulation.reference.closed_form`).
"""

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numba
import numpy as np
import pandas as pd

from experiments import timing
from experiments.timing import race
from lf_flame._common import provenance
from lf_flame._common.atomic_files import finite
from lf_flame._common.config import to_json
from lf_flame.datasets.config import read_config
from lf_flame.datasets.sampling import draw_sample, simulate_sample
from lf_flame.optics.camera import PlenopticCamera
from lf_flame.optics.sensor import Sensor
from lf_flame.scenes.flames import HALF_WIDTH, flame_texture
from lf_flame.scenes.scene import Layer, Scene
from lf_flame.scenes.shapes import shape_texture
from lf_flame.simulation.exact import integrate
from lf_flame.simulation.optical_pass import OpticalPass
from lf_flame.simulation.plan import plan_effects
from lf_flame.simulation.polygons import expected_pairs, split_planes
from lf_flame.simulation.rays import trace
from lf_flame.simulation.reference.closed_form import closed_form
from lf_flame.simulation.reference.forward import trace_forward
from lf_flame.simulation.rendering import render
from lf_flame.simulation.slabs import slice_scene

CONFIGS = ("data_gen/shapes.toml", "data_gen/flames.toml")
"""Data sets whose scenes are taken if no others are given."""

PER_PIXEL = tuple(4.0**k for k in range(-1, 8))
"""Rays per pixel of the forward methods."""

PER_AXIS = (1, *(n * 2**k for k in range(9) for n in (2, 3)))
"""Rays per pixel and axis of the backward methods."""


TOLERANCE = 1e-3
"""Of the images that are rendered with and without an effect."""

CENTRAL_VIEWS = 5
"""Views along an axis, out of the camera's own, on which the methods of integration are
compared."""


@dataclass(frozen=True)
class Study:
    """A scene on which the methods of integration are compared.

    Attributes
    ----------
    name, title : str
        In the tables, and over the panel of the figure.
    scene : Scene
    camera : PlenopticCamera
    """

    name: str
    title: str
    scene: Scene
    camera: PlenopticCamera

    @property
    def pixels(self) -> int:
        """Pixels of the image."""
        return self.camera.views**2 * math.prod(self.camera.lenslets)

    @property
    def hides(self) -> bool:
        """Whether a layer hides another."""
        return any(layer.opaque for layer in self.scene.layers)


@dataclass(frozen=True)
class Method:
    """A method of integration.

    Attributes
    ----------
    label : str
    draw : callable
        From a study and a setting to an image.
    settings : sequence of numbers
    per_pixel : callable or None
        From a setting to the rays for each pixel; None where there are none.
    share : float
        Share of a study's time: the slow ones need it to get anywhere.
    theory, theory_hidden : float or None
        The error of a picture with edges falls as ``rays**-theory``; with the second exponent, if
        there is one, where a layer hides another.
    """

    label: str
    draw: Callable[[Study, float], np.ndarray]
    settings: Sequence[float] = (0,)
    per_pixel: Callable[[float], float] | None = None
    share: float = 0.0
    theory: float | None = None
    theory_hidden: float | None = None

    def theory_for(self, study: Study) -> float | None:
        """Exponent by theory for a scene."""
        return (study.hides and self.theory_hidden) or self.theory


def _forward(study: Study, per_pixel: float, sequence: str) -> np.ndarray:
    rays = math.ceil(study.pixels * per_pixel)
    return trace_forward(study.scene, study.camera, rays, sequence)


def _backward(study: Study, per_axis: float, finite_width: bool) -> np.ndarray:
    image = _blank(study.camera)
    trace(
        _planes(study.scene),
        OpticalPass(study.camera),
        "views",
        per_axis,
        image,
        finite_width=finite_width,
    )
    return image


def _exact(study: Study, _setting: float) -> np.ndarray:
    image = _blank(study.camera)
    integrate(_planes(study.scene), OpticalPass(study.camera), "views", image)
    return image


def _planes(scene: Scene) -> list:
    return slice_scene(scene, {}, absorption=False, dimming={"occlusion"})


def _blank(camera: PlenopticCamera) -> np.ndarray:
    return np.zeros((camera.views, camera.views, *camera.lenslets), np.float32)


METHODS = {
    "random": Method(
        "forward, random (Monte Carlo)",
        partial(_forward, sequence="random"),
        PER_PIXEL,
        lambda n: n,
        share=0.38,
        theory=1 / 2,
    ),
    "quasi": Method(
        "forward, quasi-random",
        partial(_forward, sequence="quasi"),
        PER_PIXEL,
        lambda n: n,
        share=0.38,
        theory=5 / 8,
    ),
    "midpoint": Method(
        "backward, midpoint rule",
        partial(_backward, finite_width=False),
        PER_AXIS,
        lambda n: n**2,
        share=0.12,
        theory=1 / 2,
    ),
    "thin": Method(
        "backward, finite-width rays",
        partial(_backward, finite_width=True),
        PER_AXIS,
        lambda n: n**2,
        share=0.12,
        theory=1.0,
        theory_hidden=1 / 2,
    ),
    "exact": Method("exact integrator", _exact),
}
"""The methods of integration. Theory: Monte Carlo; quasi-Monte Carlo in 4 dimensions with an edge;
n midpoints along an axis miss an edge by up to 1/n; boxes miss it by the square of that, except for
those in which two layers have an edge, one of n along an axis."""


def study_scenes(shapes: Path, flames: Path) -> list[Study]:
    """Set up the scenes of the study from the templates of both data sets.

    Optics, pixels, objects and depths are the data sets'. So that slow methods get somewhere, the
    objects stand on the axis, one in front of the other, and no more is recorded than the central
    views of the lenslets that see them.

    Parameters
    ----------
    shapes, flames : Path
        Data-set configurations.
    """
    config = read_config(shapes)
    layers = [
        replace(layer, centre_mm=(0.0, 0.0)) for layer in config.template.draw(None)[0].layers
    ]
    depths = ", ".join(f"{layer.depth_mm:g}" for layer in layers)
    title = f"{len(layers)} shapes at {depths} mm"
    found = [Study("shapes", title, Scene(layers), _central(config.camera, layers))]
    config = read_config(flames)
    smallest = min(config.template.draw(None)[0].layers, key=lambda layer: layer.size_mm[0])
    flame = replace(smallest, centre_mm=(0.0, 0.0))
    camera = _central(config.camera, [flame])
    found.append(Study("flame", f"a flame at {flame.depth_mm:g} mm", Scene([flame]), camera))
    disc = _disc(flame.size_mm[0] / 3, flame.depth_mm - 20.0)
    title = "the same flame, a disc 20 mm in front of it"
    found.append(Study("hidden", title, Scene([flame, disc]), camera))
    return found


def _disc(diameter_mm: float, depth_mm: float) -> Layer:
    """Make a black disc on the axis."""
    size = (diameter_mm, diameter_mm)
    coverage = shape_texture("circle", size, diameter_mm / 20)
    return Layer(np.zeros(coverage.shape), depth_mm, size, opaque=True, coverage=coverage)


def _central(camera: PlenopticCamera, layers: Sequence[Layer]) -> PlenopticCamera:
    views = min(camera.views, CENTRAL_VIEWS)
    return _framed(replace(camera, views=views, pixel_pitch_mm=camera.pixel_mm), layers)


def _framed(camera: PlenopticCamera, layers: Sequence[Layer]) -> PlenopticCamera:
    """Record as many lenslets as it takes for all views to see all of layers on the axis."""
    lenslets = []
    for axis in (0, 1):
        needed = 1
        for layer in layers:
            lenslet_mm = camera.field_mm(layer.depth_mm)[axis] / camera.lenslets[axis]
            aside = abs(layer.depth_mm) / camera.focus_distance_mm * camera.view_step_mm
            seen_mm = layer.size_mm[axis] + aside * camera.views
            needed = max(needed, math.ceil(seen_mm / lenslet_mm) + 2)
        lenslets.append(needed)
    return replace(camera, lenslets=tuple(lenslets))


@dataclass(frozen=True)
class Trial:
    """A scene and a camera that call for an effect."""

    scene: Scene
    camera: PlenopticCamera


def effect_trials(camera: PlenopticCamera, height_mm: float = 6.0) -> dict[str, Trial]:
    """Set up, for each effect, a small flame before a camera in which the effect matters.

    Parameters
    ----------
    camera : PlenopticCamera
        Its optics and views; the lenslets follow from the scene.
    height_mm : float, optional
        Height of the flame, which decides the size of the images.
    """
    texture = flame_texture(height_mm, height_mm / 8)
    size = (height_mm, 2 * HALF_WIDTH * height_mm / 8)
    near, far = Layer(texture, 10.0, size), Layer(texture, 30.0, size)
    sooty = replace(near, optical_thickness=0.2 * texture)
    lone, camera = Scene([near]), _framed(camera, [near, far])

    def before(scene: Scene = lone, **changes) -> Trial:
        return Trial(scene, replace(camera, **changes))

    width = camera.aperture_mm
    return {
        "defocus": before(),
        "occlusion": before(Scene([near, _disc(height_mm / 4, -10.0)])),
        "self_absorption": before(Scene([sooty, far])),
        "thickness": before(Scene([replace(near, thickness_mm=height_mm / 4)])),
        "cos4": before(falloff_corrected=False),
        "round_aperture": before(aperture_diameter_mm=width),
        "f_number_mismatch": before(aperture_diameter_mm=1.1 * width),
        "vignetting": before(rim_diameter_mm=width, rim_distance_mm=40.0),
        "lenslet_diffraction": before(wavelength_nm=550.0),
        "main_lens_diffraction": before(wavelength_nm=550.0),
        "lenslet_rotation": before(lenslet_rotation_rad=2e-3),
        "lenslet_pitch_error": before(lenslet_pitch_error=2e-3),
        "chromatic": before(chromatic_shift=0.01),
        "shot_noise": before(sensor=Sensor(8000.0)),
        "read_noise": before(sensor=Sensor(8000.0, read_noise_e=20.0)),
        "quantisation": before(sensor=Sensor(8000.0, bits=8)),
        "saturation": before(sensor=Sensor(8000.0, full_well_e=6000.0)),
    }


def measure_costs(
    progress: Callable | None = None,
    budget_s: float = 420.0,
    studies: Sequence[Study] | None = None,
    trials: Mapping[str, Trial] | None = None,
    configs: Sequence[Path] = tuple(map(Path, CONFIGS)),
) -> tuple[Sequence[Study], pd.DataFrame, pd.DataFrame, dict]:
    """Measure error against seconds, for `experiments.costs.rendering_report.write_report`.

    Parameters
    ----------
    progress : callable, optional
        Passes on an iterable of steps, given how many are done and how many there are.
    budget_s : float, optional
        Time that the methods of integration may take in all, which bounds their rays; references
        and effects take a minute or two on top.
    studies : sequence of Study, optional
        Default: `study_scenes` of the data sets in CONFIGS.
    trials : mapping of str to Trial, optional
        Default: `effect_trials` of the camera of the latter.
    configs : sequence of Path, optional
        Data-set configurations of which one sample is made both ways.

    Returns
    -------
    sequence of Study
    DataFrame
        Error against seconds of each method of integration.
    DataFrame
        What each effect costs, and what leaving it out does.
    dict
        The record; in ``samples`` what a sample of each data set takes.
    """
    started, shapes, flames = time.perf_counter(), *map(Path, CONFIGS)
    studies = study_scenes(shapes, flames) if studies is None else studies
    trials = effect_trials(read_config(flames).camera) if trials is None else trials
    found = {"accuracy": [], "effects": [], "samples": []}
    steps = _measure(studies, trials, configs, budget_s)
    total = len(METHODS) * len(studies) + len(trials) + len(configs)
    with _one_thread():
        for table, rows in progress(steps, 0, total) if progress else steps:
            found[table] += rows
    accuracy, effects = (pd.DataFrame(found[table]) for table in ("accuracy", "effects"))
    record = {
        "studies": {study.name: _described(study) for study in studies},
        "threads": 1,
        "budget_s": budget_s,
        "wall_s": time.perf_counter() - started,
        **{table: [finite(row) for row in rows] for table, rows in found.items()},
        **provenance.environment(),
    }
    return studies, accuracy, effects, record


def _described(study: Study) -> dict:
    """JSON values of a study: its camera, and what the layers are."""
    layers = [
        {"depth_mm": a.depth_mm, "size_mm": a.size_mm, "cells": a.texture.shape, "opaque": a.opaque}
        for a in study.scene.layers
    ]
    return {"title": study.title, "camera": to_json(study.camera), "layers": layers}


@contextmanager
def _one_thread() -> Iterator[None]:
    """Run compiled loops on one thread, and put the number back."""
    before = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        yield
    finally:
        numba.set_num_threads(before)


def work(study: Study, name: str, per_pixel: float) -> tuple[str, float]:
    """Say which of the plan's times a backward method of a study takes, and how often.

    Parameters
    ----------
    study : Study
    name : {"exact", "thin"}
    per_pixel : float
        Rays for each pixel.

    Returns
    -------
    kind : str
        A key of `lf_flame.simulation.plan.NANOSECONDS`.
    count : float
    """
    planes = len(study.scene.layers)
    if name == "thin":
        return ("dimmed" if study.hides else "ray"), study.pixels * planes * per_pixel
    if not study.hides:
        return "exact", study.pixels * planes
    _, behind = split_planes(_planes(study.scene))
    return "polygon", expected_pairs(behind, OpticalPass(study.camera)) * len(behind)


def _measure(studies, trials, configs, budget_s: float) -> Iterator[tuple[str, list[dict]]]:
    """Yield rows of the tables, as they are measured."""
    for study in studies:
        reference = closed_form(study.scene, study.camera)
        for name, method in METHODS.items():
            allowance = method.share * budget_s / len(studies)
            yield "accuracy", _measure_method(study, name, reference, allowance)
    for name, trial in trials.items():
        yield "effects", [_measure_effect(name, trial)]
    for path in configs:
        yield "samples", [_measure_sample(path)]


def _measure_method(study: Study, name: str, reference: np.ndarray, budget_s: float) -> list[dict]:
    """Run a method at growing settings until the next would take more than is left."""
    method, rows = METHODS[name], []
    method.draw(study, method.settings[0])  # compiles
    started = time.perf_counter()
    for setting in method.settings:
        per_pixel = method.per_pixel(setting) if method.per_pixel else 0
        if rows:
            next_s = rows[-1]["seconds"] * per_pixel / rows[-1]["rays_per_pixel"]
            spent = time.perf_counter() - started
            if min(timing.REPETITIONS * next_s, next_s + timing.LONG_S) > budget_s - spent:
                break
        seconds, (image,) = race(partial(method.draw, study, setting))
        error = math.sqrt(np.mean((image - reference) ** 2)) / reference.max()
        if rows and error == rows[-1]["error"]:
            continue  # rounded up to the same rays as before
        rows.append(
            {
                "scene": study.name,
                "method": name,
                "rays_per_pixel": per_pixel,
                "seconds": seconds.min(),
                "error": error,
            }
        )
    return rows


def _measure_effect(name: str, trial: Trial) -> dict:
    """Render with an effect forced off and on; all else as planned."""
    planned = plan_effects(trial.scene, trial.camera, TOLERANCE, {name: True})
    calls = [partial(_views, trial, {name: on}) for on in (False, True)]
    for call in calls:
        call()  # compiles
    seconds, images = race(*calls)
    images = [image.astype(np.float64) for image in images]
    (off, on), runs = seconds[:, 0], seconds.shape[1]
    quarter = min(max(1, runs // 4), runs - 1)
    change = images[1] - images[0]
    return {
        "effect": name,
        "bound": planned[name].bound,
        "error_max": float(np.abs(change).max() / images[1].max()),
        "error_rms": math.sqrt(np.mean(change**2)) / images[1].max(),
        "seconds_off": off,
        "seconds_on": on,
        "seconds_added": on - off,
        "seconds_spread": (seconds[:, quarter] - seconds[:, 0]).max(),
        "seconds_planned": planned[name].seconds,
        "integrator": planned.integrator,
        "pixels": images[1].size,
        "criterion": planned[name].criterion,
    }


def _measure_sample(path: Path) -> dict:
    """Make one sample of a data set straight from the scene, and through its light field."""
    config = read_config(path)
    slopes = [float(config.camera.depth_to_slope(depth)) for depth in config.depths_mm]
    ways = [partial(simulate_sample, config, slopes, 0, forced) for forced in (False, True)]
    for way in ways:
        way()  # compiles
    draw = partial(draw_sample, config, 0)
    seconds, (_, straight, through) = race(draw, *ways)
    drawing, short, long = seconds[:, 0]
    return {
        "data": config.kind,
        "not_separable": straight["plan"].not_separable,
        "seconds_drawing": drawing,
        "seconds_straight": short,
        "seconds_through_light_field": long,
        "ratio": long / short,
        "largest_difference": max(
            float(np.abs(straight[name] - through[name]).max()) for name in ("input", "target")
        ),
    }


def _views(trial: Trial, forced: dict[str, bool]) -> np.ndarray:
    return render(trial.scene, trial.camera, TOLERANCE, effects=forced, seed=1).views
