"""What accuracy costs in time: error against seconds, for each integration method and each effect.

All runs take one thread of one machine, one after the other, compiled beforehand, so that ratios
are fair. Errors are root-mean-square over the image relative to its brightest pixel, against an
image multiplied out in float64 (`lf_flame.simulation.reference.closed_form`).
"""

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path

import numba
import numpy as np
import pandas as pd

from experiments import timing
from experiments.costs.integration_methods import METHODS, study_planes
from experiments.costs.rendering_scenes import CONFIGS, Study, Trial, effect_trials, study_scenes
from experiments.timing import race
from lf_flame._common import provenance
from lf_flame._common.atomic_files import finite
from lf_flame._common.config import to_json
from lf_flame.datasets.config import read_config
from lf_flame.datasets.sampling import draw_sample, simulate_sample
from lf_flame.simulation.optical_pass import OpticalPass
from lf_flame.simulation.planning.decisions import plan_effects
from lf_flame.simulation.planning.time_estimates import lit_pixels
from lf_flame.simulation.polygons import expected_pairs, split_planes
from lf_flame.simulation.reference.closed_form import closed_form
from lf_flame.simulation.rendering import render

TOLERANCE = 1e-3
"""Of the images that are rendered with and without an effect."""


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
    found = {"accuracy": [], "effects": [], "samples": [], "whole": []}
    steps = _measure(studies, trials, configs, budget_s)
    total = len(METHODS) * len(studies) + len(trials) + 2 * len(configs)
    with _threads(1):
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
def _threads(count: int) -> Iterator[None]:
    """Run compiled loops on some threads, and put the number back."""
    before = numba.get_num_threads()
    numba.set_num_threads(count)
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
        A key of `lf_flame.simulation.planning.time_estimates.NANOSECONDS`.
    count : float
    """
    optics, layers = OpticalPass(study.camera), study.scene.layers
    seen = [lit_pixels(layer, optics) for layer in layers]
    if name == "thin":
        lit = sum(pixels for pixels, _ in seen)
        return ("dimmed", lit * per_pixel) if study.hides else ("ray", lit * math.sqrt(per_pixel))
    if not study.hides:
        return "exact", sum(pixels * (1 + cells) for pixels, cells in seen)
    _, behind = split_planes(study_planes(study.scene))
    return "polygon", expected_pairs(behind, optics) * len(behind)


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
    for path in configs:
        with _threads(numba.config.NUMBA_NUM_THREADS):
            yield "whole", _measure_whole(path)


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


def _measure_whole(path: Path) -> list[dict]:
    """Render a scene of a data set as large as its camera records it, on all cores."""
    config, cores = read_config(path), numba.get_num_threads()
    scene, camera = config.template.draw(None)[0], config.camera
    reference = closed_form(scene, camera)
    stop = replace(camera, aperture_diameter_mm=camera.aperture_mm)
    rows = []
    for name, seen_by, tolerance, integrator in (
        ("exact integrator", camera, 1e-3, "exact"),
        ("rays", camera, 1e-2, "rays"),
        ("rays", camera, 1e-3, "rays"),
        ("rays, a round stop", stop, 1e-2, "rays"),
    ):
        plan = plan_effects(scene, seen_by, tolerance)
        call = partial(render, scene, seen_by, tolerance, integrator=integrator)
        call()  # compiles
        seconds, (found,) = race(lambda call=call: call().views)
        error = math.sqrt(np.mean((found - reference) ** 2)) / reference.max()
        rows.append(
            {
                "data": config.kind,
                "integrator": name,
                "tolerance": tolerance,
                "pixels": found.size,
                "cores": cores,
                "seconds": seconds.min(),
                "seconds_planned": plan.seconds[integrator] / cores,
                "error": error if seen_by is camera else math.nan,
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
    routes = (replace(config, route=route) for route in ("direct", "exact"))
    ways = [partial(simulate_sample, route, slopes, 0) for route in routes]
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
