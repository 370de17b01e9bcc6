"""Accuracy against time in simulation: error against seconds, for each method and each effect.

Methods and effects run on one thread, one after the other, compiled beforehand, so that ratios are
fair. Errors are root-mean-square over the image relative to its brightest pixel, against an image
multiplied out in float64 by the reference tracer.
"""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
from numba import njit

from experiments import timing
from experiments.effects.effects import Trial, effect_trials
from experiments.effects.tracer import flat_views
from experiments.inputs import DATA_SETS
from experiments.report import markdown, panels, step_bar, write_report
from experiments.timing import in_turn
from lf_flame._common.config import to_json
from lf_flame._common.threads import one_thread
from lf_flame.datasets.config import read_config
from lf_flame.optics.camera import PlenopticCamera
from lf_flame.optics.ray_bundle import trace_footprint
from lf_flame.scenes.scene import Layer, Scene
from lf_flame.scenes.shapes import shape_texture
from lf_flame.simulation.integration import integrate
from lf_flame.simulation.optical_pass import OpticalPass
from lf_flame.simulation.planning.plan import plan_effects
from lf_flame.simulation.rays import trace
from lf_flame.simulation.rendering import render
from lf_flame.simulation.slabs import slice_scene

TOLERANCE = 1e-3
"""Tolerance of the images that are rendered with and without an effect."""


@dataclass(frozen=True)
class Study:
    """Scene and camera on which methods are compared; the title is that of its panel."""

    name: str
    title: str
    scene: Scene
    camera: PlenopticCamera


@dataclass(frozen=True)
class Method:
    """A method of integration, its numbers of rays for each pixel, and its share of the time."""

    label: str
    colour: str
    marker: str
    draw: Callable[[Study, int], np.ndarray]
    rays: Sequence[int] = (0,)
    share: float = 0.0


def _by_library(study: Study, rays: int) -> np.ndarray:
    """Integrate by about so many rays for each pixel, or exactly for 0 rays."""
    image = np.zeros((study.camera.views,) * 2 + study.camera.lenslets, np.float32)
    planes = slice_scene(study.scene, {}, absorption=False, attenuating={"occlusion"})
    optics = OpticalPass(study.camera)
    if rays:
        trace(planes, optics, "views", math.isqrt(rays), image)
    else:
        integrate(planes, optics, "views", image)
    return image


def _by_random_rays(study: Study, rays: int) -> np.ndarray:
    """Trace random rays backward from each pixel into flat layers (Monte Carlo)."""
    camera, layers = study.camera, []
    for layer in study.scene.front_to_back:
        seen = [trace_footprint(camera, layer.depth_mm, axis) for axis in (0, 1)]
        places = [(x.centres_mm, x.lenslet_width_mm, x.pixel_width_mm) for x in seen]
        corner = [float(layer.cell_edges_mm[axis][0]) for axis in (0, 1)]
        passing = 1.0 - np.broadcast_to(layer.opacity, layer.texture.shape)
        layers.append((layer.texture.astype(float), passing, *corner, *layer.size_mm, *places))
    image = np.empty((camera.views, camera.views, *camera.lenslets))
    _trace_random_rays(tuple(layers), rays, image)
    return image


@njit(cache=True)
def _trace_random_rays(layers, rays, image):
    np.random.seed(0)  # noqa: NPY002 - Numba's own generator
    for v, u, t, s in np.ndindex(image.shape):
        light = 0.0
        for _ in range(rays):
            share = 1 / rays
            a, b = np.random.random() - 0.5, np.random.random() - 0.5  # noqa: NPY002
            c, d = np.random.random() - 0.5, np.random.random() - 0.5  # noqa: NPY002
            for k in range(len(layers)):
                texture, passing, top, left, height, width, rows, columns = layers[k]
                y = rows[0][v, t] + rows[1] * a + rows[2] * b
                x = columns[0][u, s] + columns[1] * c + columns[2] * d
                i = math.floor((y - top) / height * texture.shape[0])
                j = math.floor((x - left) / width * texture.shape[1])
                if 0 <= i < texture.shape[0] and 0 <= j < texture.shape[1]:
                    light += share * texture[i, j]
                    share *= passing[i, j]
        image[v, u, t, s] = light


SQUARES = (1, *((n * 2**k) ** 2 for k in range(9) for n in (2, 3)))

METHODS = {
    "random": Method("random rays (Monte Carlo)", "#D55E00", "o", _by_random_rays,
                     [4**k for k in range(10)], share=0.6),
    "thin": Method("rays of finite width", "#0072B2", "D", _by_library, SQUARES, share=0.4),
    "exact": Method("exact integrator", "#000000", "*", _by_library),
}  # fmt: skip


def study_scenes(shapes: Path, flames: Path) -> list[Study]:
    """Set up the scenes of the study with optics, pixels and objects of both data sets.

    To keep slow methods affordable, the objects are on the axis, one in front of the other,
    and only the central views of the lenslets that see them are recorded.
    """
    config = read_config(shapes)
    layers = [replace(x, centre_mm=(0.0, 0.0)) for x in config.template.draw(None)[0].layers]
    title = f"{len(layers)} shapes at {', '.join(f'{x.depth_mm:g}' for x in layers)} mm"
    found = [Study("shapes", title, Scene(layers), _framed(config.camera, layers))]
    config = read_config(flames)
    flame = min(config.template.draw(None)[0].layers, key=lambda layer: layer.size_mm[0])
    flame = replace(flame, centre_mm=(0.0, 0.0))
    camera = _framed(config.camera, [flame])
    side = flame.size_mm[0] / 3
    coverage = shape_texture("circle", (side, side), side / 20)
    depth = flame.depth_mm - 20.0
    disc = Layer(np.zeros(coverage.shape), depth, (side, side), opaque=True, coverage=coverage)
    return [
        *found,
        Study("flame", f"a flame at {flame.depth_mm:g} mm", Scene([flame]), camera),
        Study("hidden", "the same flame behind a disc", Scene([flame, disc]), camera),
    ]


def _framed(camera: PlenopticCamera, layers: Sequence[Layer]) -> PlenopticCamera:
    """Keep the central views, and the lenslets by which they see all of layers on the axis."""
    views, lenslets = min(camera.views, 5), []
    for axis in (0, 1):
        needed = 1
        for layer in layers:
            lenslet_mm = camera.field_mm(layer.depth_mm)[axis] / camera.lenslets[axis]
            aside = abs(layer.depth_mm) / camera.focus_distance_mm * camera.view_step_mm
            needed = max(needed, (layer.size_mm[axis] + aside * views) / lenslet_mm + 2)
        lenslets.append(math.ceil(needed))
    few = replace(camera, views=views, pixel_pitch_mm=camera.pixel_mm)
    return replace(few, lenslets=tuple(lenslets))


def measure_costs(
    budget_s: float = 150.0,
    studies: Sequence[Study] | None = None,
    trials: Mapping[str, Trial] | None = None,
) -> dict:
    """Measure methods on studies and effects on trials; defaults: the paper's data sets.

    The budget, the time of all methods together, bounds their rays.
    """
    started = time.perf_counter()
    studies = study_scenes(*DATA_SETS) if studies is None else studies
    if trials is None:
        camera = replace(read_config(DATA_SETS[1]).camera, lenslets=(56, 64))
        trials = effect_trials(camera, lenslets_high=46)
    accuracy: list[dict] = []
    with one_thread():
        for study in step_bar(studies):
            truth = flat_views(study.scene, study.camera)
            hides = any(layer.opaque for layer in study.scene.layers)  # needs rays
            for name in [name for name in METHODS if name != "exact" or not hides]:
                accuracy += _measure_method(study, name, truth, budget_s / len(studies))
        effects = [_measure_effect(*item) for item in step_bar(trials.items())]
    return {
        "studies": {x.name: {"title": x.title, "camera": to_json(x.camera)} for x in studies},
        "budget_s": budget_s,
        "wall_s": time.perf_counter() - started,
        "accuracy": accuracy,
        "effects": effects,
    }


def _measure_method(study: Study, name: str, truth: np.ndarray, budget_s: float) -> list[dict]:
    """Run a method with ever more rays until the next run would take more than its share."""
    method, rows = METHODS[name], []
    method.draw(study, method.rays[0])  # compiles
    started = time.perf_counter()
    for rays in method.rays:
        if rows:
            next_s = rows[-1]["seconds"] * rays / rows[-1]["rays_per_pixel"]
            left_s = method.share * budget_s - (time.perf_counter() - started)
            if min(timing.ROUNDS * next_s, next_s + timing.LONG_S) > left_s:
                break
        times = in_turn(partial(method.draw, study, rays), warm_up=False)
        error = _error(times.results[0], truth)
        if not rows or error != rows[-1]["error"]:  # not rounded up to the same rays as before
            row = {"scene": study.name, "method": name, "rays_per_pixel": rays}
            rows.append(row | {"seconds": float(times.best[0]), "error": error})
    return rows


def _measure_effect(name: str, trial: Trial) -> dict:
    """Render with an effect forced off and on; all else as planned."""
    planned = plan_effects(*trial, TOLERANCE, {name: True})
    calls = [partial(render, *trial, TOLERANCE, effects={name: on}, seed=1) for on in (False, True)]
    times = in_turn(*calls)
    without, image = (found.views.astype(np.float64) for found in times.results)
    seconds_off, seconds_on = times.best.tolist()
    return {
        "effect": name,
        "bound": planned[name].bound,
        "error_max": float(np.abs(image - without).max() / image.max()),
        "error_rms": _error(without, image),
        "seconds_off": seconds_off,
        "seconds_on": seconds_on,
        "seconds_added": seconds_on - seconds_off,
        "seconds_planned": planned.seconds,
        "integrator": planned.integrator,
    }


def _error(image: np.ndarray, truth: np.ndarray) -> float:
    """Root-mean-square error relative to the brightest pixel."""
    return float(math.sqrt(np.mean((image - truth) ** 2)) / truth.max())


def seconds_for(points: pd.DataFrame, level: float) -> str:
    """Seconds that one method takes for an error, interpolated between two settings."""
    seconds, error = np.log(points["seconds"]), np.log(np.minimum.accumulate(points["error"]))
    if math.log(level) < error.iloc[-1]:
        return "not reached"
    found = math.exp(np.interp(math.log(level), error[::-1], seconds[::-1]))
    coarsest = len(points) > 1 and level > points["error"].iloc[0]
    return f"{'<' if coarsest else ''}{found:.2g} s"


EFFECTS = {
    "effect": ("effect", ""),
    "bound": ("bound", lambda x: f"{math.inf if pd.isna(x) else x:.2g}"),
    "error_max": ("largest change", ".2g"),
    "error_rms": ("rms change", ".2g"),
    "seconds_off": ("without (s)", ".4f"),
    "seconds_added": ("adds (s)", "+.4f"),
    "seconds_planned": ("plan says, in all (s)", ".4f"),
    "integrator": ("integrator", ""),
}


def write(out: Path, record: dict) -> Path:
    """Write ``costs.md``, its figure, its record, and the tables ``accuracy`` and ``effects``."""
    studies, accuracy = record["studies"], pd.DataFrame(record["accuracy"])
    rows = []
    for (scene, name), points in accuracy.groupby(["scene", "method"], sort=False):
        row = {"scene": studies[scene]["title"], "method": METHODS[name].label}
        row |= {f"{level:g}": seconds_for(points, level) for level in (0.1, 0.01, 0.001)}
        rows.append(row | {"smallest error": f"{points['error'].min():.1e}"})
    body = [
        """Error: root-mean-square over the image, relative to its brightest pixel, against the
closed form in float64. Seconds: from scene to image, the fastest of a few runs, compiled
beforehand, on one thread.""",
        "![Error against seconds](costs.png)",
        "## Seconds to reach an error",
        "Interpolated between two settings; `<`: even the coarsest setting errs less.",
        markdown(rows),
        "## Effects",
        """A small flame with what calls for the effect, rendered with the effect forced on and
forced off. Changes are relative to the brightest pixel. The bound is the plan's, for any pixel; for
noise it limits the root mean square.""",
        markdown(record["effects"], EFFECTS),
    ]
    return write_report(
        out, "costs", "What accuracy costs in time: simulation", record, body,
        tables={"accuracy": accuracy, "effects": pd.DataFrame(record["effects"])},
        pictures={"costs": figure(studies, accuracy)},
    )  # fmt: skip


def figure(studies: Mapping[str, dict], accuracy: pd.DataFrame):
    """Draw error against seconds, one panel for each scene."""
    titles, size = [study["title"] for study in studies.values()], (4.6 * len(studies), 5.2)
    picture, axes = panels(titles, size, "seconds on one thread", sharex=True, sharey=True)
    for scene, axis in zip(studies, axes, strict=True):
        for name, method in METHODS.items():
            points = accuracy[(accuracy["scene"] == scene) & (accuracy["method"] == name)]
            axis.loglog(
                points["seconds"], points["error"], color=method.colour, marker=method.marker,
                markersize=13 if method.marker == "*" else 5, label=method.label,
                linestyle="-" if method.share else "",
            )  # fmt: skip
    axes[0].set_ylabel("root-mean-square error, relative to the brightest pixel")
    handles = axes[0].get_legend_handles_labels()
    picture.legend(*handles, loc="outside lower center", ncols=5, frameon=False)
    return picture
