"""What accuracy costs in time: error against seconds, for each integration method and each effect.

All runs take one thread of one machine, one after the other, compiled beforehand, so that ratios
are fair. Errors are root-mean-square over the image relative to its brightest pixel, against an
image multiplied out in float64 by the reference tracer.
"""

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numba
import numpy as np

from experiments import timing
from experiments.command_parts import step_bar
from experiments.costs.integration_methods import METHODS
from experiments.costs.rendering_scenes import Study, study_scenes
from experiments.effects.effects import Trial, effect_trials
from experiments.effects.tracer import flat_views
from experiments.paths import DATA_SETS
from experiments.timing import in_turn
from lf_flame._common.config import to_json
from lf_flame._common.threads import one_thread
from lf_flame.datasets.config import read_config
from lf_flame.simulation.planning.decisions import plan_effects
from lf_flame.simulation.rendering import render

TOLERANCE = 1e-3
"""Tolerance of the images that are rendered with and without an effect."""

LENSLETS, LENSLETS_HIGH = (56, 64), 46
"""Window of the camera that sees the flame of an effect, and height of this flame in lenslets."""

WHOLE = (
    ("exact integrator", False, 1e-3),
    ("rays", False, 1e-2),
    ("rays", False, 1e-3),
    ("rays, a round stop", True, 1e-2),
)
"""How a whole light field is rendered: by which integrator, through a round stop, tolerance."""


def measure_costs(
    budget_s: float = 420.0,
    studies: Sequence[Study] | None = None,
    trials: Mapping[str, Trial] | None = None,
    configs: Sequence[Path] = DATA_SETS,
) -> dict:
    """Measure error against seconds, on the paper's data sets where no others are given.

    The budget is the time of all methods of integration, which bounds their rays; references and
    effects take a minute or two on top. Studies and trials are the scenes of the methods and of the
    effects; of each data set of `configs` a scene is rendered whole.
    """
    started = time.perf_counter()
    studies = study_scenes(*DATA_SETS) if studies is None else studies
    if trials is None:
        camera = replace(read_config(DATA_SETS[1]).camera, lenslets=LENSLETS)
        trials = effect_trials(camera, LENSLETS_HIGH)
    with one_thread():
        share_s = budget_s / len(studies)
        accuracy = [row for one in step_bar(studies) for row in _measure_methods(one, share_s)]
        effects = [_measure_effect(*item) for item in step_bar(trials.items())]
    whole = [_measure_whole(path) for path in step_bar(configs)]
    return {
        "studies": {study.name: _described(study) for study in studies},
        "threads": 1,
        "budget_s": budget_s,
        "wall_s": time.perf_counter() - started,
        "accuracy": accuracy,
        "effects": effects,
        "whole": sum(whole, []),
    }


def _described(study: Study) -> dict:
    """JSON values of a study: its camera, and what the layers are."""
    layers = [
        {"depth_mm": a.depth_mm, "size_mm": a.size_mm, "cells": a.texture.shape, "opaque": a.opaque}
        for a in study.scene.layers
    ]
    return {"title": study.title, "camera": to_json(study.camera), "layers": layers}


def _measure_methods(study: Study, budget_s: float) -> Iterator[dict]:
    reference = flat_views(study.scene, study.camera)
    for name, method in METHODS.items():
        yield from _measure_method(study, name, reference, method.share * budget_s)


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
            if min(timing.ROUNDS * next_s, next_s + timing.LONG_S) > budget_s - spent:
                break
        times = in_turn(partial(method.draw, study, setting), warm_up=False)
        error = _error(times.results[0], reference)
        if rows and error == rows[-1]["error"]:
            continue  # rounded up to the same rays as before
        row = {"scene": study.name, "method": name, "rays_per_pixel": per_pixel}
        rows.append(row | {"seconds": float(times.best[0]), "error": error})
    return rows


def _measure_whole(path: Path) -> list[dict]:
    """Render a scene of a data set as large as its camera records it, on all cores."""
    config, cores = read_config(path), numba.get_num_threads()
    scene, camera = config.template.draw(None)[0], config.camera
    reference = flat_views(scene, camera)
    stop = replace(camera, aperture_diameter_mm=camera.aperture_mm)
    rows = []
    for name, has_stop, tolerance in WHOLE:
        seen_by = stop if has_stop else camera
        integrator = "exact" if name.startswith("exact") else "rays"
        plan = plan_effects(scene, seen_by, tolerance)
        call = partial(render, scene, seen_by, tolerance, integrator=integrator)
        times = in_turn(call)
        found = times.results[0].views
        rows.append(
            {
                "data": config.kind,
                "integrator": name,
                "tolerance": tolerance,
                "pixels": found.size,
                "cores": cores,
                "seconds": float(times.best[0]),
                "seconds_planned": plan.seconds[integrator] / cores,
                "error": _error(found, reference) if seen_by is camera else math.nan,
            }
        )
    return rows


def _measure_effect(name: str, trial: Trial) -> dict:
    """Render with an effect forced off and on; all else as planned."""
    planned = plan_effects(trial.scene, trial.camera, TOLERANCE, {name: True})
    calls = [partial(_views, trial, {name: on}) for on in (False, True)]
    times = in_turn(*calls)
    images = [image.astype(np.float64) for image in times.results]
    off, on = times.best.tolist()
    change = images[1] - images[0]
    return {
        "effect": name,
        "bound": planned[name].bound,
        "error_max": float(np.abs(change).max() / images[1].max()),
        "error_rms": math.sqrt(np.mean(change**2)) / images[1].max(),
        "seconds_off": off,
        "seconds_on": on,
        "seconds_added": on - off,
        "seconds_spread": float(times.spread.max()),
        "seconds_planned": planned[name].seconds,
        "integrator": planned.integrator,
        "pixels": images[1].size,
        "criterion": planned[name].criterion,
    }


def _views(trial: Trial, forced: dict[str, bool]) -> np.ndarray:
    return render(trial.scene, trial.camera, TOLERANCE, effects=forced, seed=1).views


def _error(image: np.ndarray, reference: np.ndarray) -> float:
    """Root-mean-square error relative to the brightest pixel."""
    return float(math.sqrt(np.mean((image - reference) ** 2)) / reference.max())
