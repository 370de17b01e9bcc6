"""Bounds of the effect plan against random scenes and cameras with every imperfection."""

import signal
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import partial
from multiprocessing import get_context

import numba
import numpy as np
import pandas as pd

from experiments.report import markdown, step_bar
from lf_flame.errors import InputError
from lf_flame.optics.camera import PlenopticCamera
from lf_flame.optics.sensor import STAGES, Sensor
from lf_flame.scenes.flames import HALF_WIDTH, draw_wrinkles, flame_texture
from lf_flame.scenes.scene import Layer, Scene
from lf_flame.simulation.planning.plan import EffectPlan, plan_effects
from lf_flame.simulation.rendering import render, render_plan

TOLERANCE = 0.05
"""Tolerance of the plans whose decisions the images follow."""

RAY_COUNTS = (12, 36, 108)
"""Rays per pixel and axis that are tried where an effect needs rays: few have an error."""

TOLERANCES = (TOLERANCE, TOLERANCE / 10)
"""Tolerances that are tried where it needs none: images are off by about as much."""

WHOLE = "whole image"
"""Name of the line that compares images at the tolerance and at a tenth of it, as a whole."""

MOST_SECONDS = 30
"""Processor time after which a scene is left: a few need minutes at a tenth of the tolerance."""

ROUNDING = 1e-6
"""Rounding of float32 images, relative to the brightest pixel."""

WITHOUT = {
    "round_aperture": ("f_number_mismatch",),
    "occlusion": ("main_lens_diffraction",),
    "self_absorption": ("main_lens_diffraction",),
}
"""Effects left out while another is measured, because they differ without it. Where layers occlude
or absorb, diffraction at the main lens takes each lenslet's light as a whole."""


def _draw_camera(rng: np.random.Generator) -> PlenopticCamera:
    """Draw a small camera, each imperfection of which is there about every second time."""

    def maybe(value, otherwise=None):
        return value if rng.random() < 0.5 else otherwise

    sensors = Sensor(1e4), Sensor(1e4, full_well_e=6e3), Sensor(1e8, 1e10, 16, 0.1)
    return PlenopticCamera(
        main_lens_focal_mm=rng.uniform(120, 180),
        focus_distance_mm=326.0,
        lenslet_focal_mm=0.4,
        lenslet_pitch_mm=0.112,
        views=int(rng.integers(1, 6)),
        lenslets=(6, 8),
        aperture_diameter_mm=maybe(rng.uniform(60, 95)),
        rim_diameter_mm=maybe(rng.uniform(50, 140)),
        rim_distance_mm=rng.uniform(0, 30),
        wavelength_nm=maybe(rng.uniform(450, 700)),
        chromatic_shift=maybe(10 ** rng.uniform(-5, -3), 0.0),
        lenslet_rotation_rad=maybe(10 ** rng.uniform(-6, -2), 0.0),
        lenslet_pitch_error=maybe(10 ** rng.uniform(-6, -2), 0.0),
        falloff_corrected=bool(rng.random() < 0.5),
        sensor=maybe(sensors[rng.integers(3)]),
    )


def _draw_layer(rng: np.random.Generator) -> Layer:
    """Draw a flame, a rough texture or a card, with properties of matter every second time."""
    place = {"depth_mm": rng.uniform(-20, 30), "centre_mm": rng.uniform(-0.4, 0.4, 2)}
    kind = rng.choice(["flame", "noise", "card"])
    if kind == "card":
        return Layer(rng.uniform(size=(3, 4)), size_mm=(0.8, 0.9), opaque=True, **place)
    matter = {"thickness_mm": rng.choice([0.0, 10 ** rng.uniform(-4, 1)])}
    matter["optical_thickness"] = rng.choice([0.0, 10 ** rng.uniform(-5, 0)])
    if kind == "noise":
        cells = rng.integers(1, 16, 2)
        return Layer(rng.uniform(size=cells), size_mm=(1.2, 1.4), **place, **matter)
    height, radius = rng.uniform(3, 20), rng.uniform(0.8, 3)
    texture = flame_texture(height, radius, draw_wrinkles(rng), 0.06 * radius, 0.04)
    return Layer(texture, size_mm=(height, 2 * HALF_WIDTH * radius), **place, **matter)


@contextmanager
def _limited(seconds: float) -> Iterator[None]:
    """Raise TimeoutError after so much processor time, however busy the machine is."""

    def stop(*_):
        raise TimeoutError

    signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)


def measure_scene(seed: int, number: int) -> list[dict] | None:
    """Plan a random scene, and force each effect that arises against what was decided.

    Returns a row for each effect that has a bound: ``scene``, ``effect``, ``bound``, ``change`` and
    ``error`` of the rays that showed it; None if the scene was refused, as with two surfaces at one
    place. After `MOST_SECONDS` the rows found so far are returned.
    """
    try:
        rng = np.random.default_rng([seed, number])
        camera = _draw_camera(rng)
        scene = Scene([_draw_layer(rng) for _ in range(rng.integers(1, 4))])
        plan = plan_effects(scene, camera, TOLERANCE, integrator="rays", rays=1)  # decisions alone
    except InputError:
        return None
    rows: list[dict] = []
    with suppress(TimeoutError), _limited(MOST_SECONDS):
        for row in _rows(scene, camera, plan):
            rows.append({"scene": number, **row})
    return rows


def _rows(scene: Scene, camera: PlenopticCamera, plan: EffectPlan) -> Iterator[dict]:
    """Compare each effect with its bound, and then the whole image with a finer one."""
    quiet = dict.fromkeys(STAGES, False)
    decided = {effect.name: effect.kept for effect in plan.effects} | quiet
    try:
        image = render(scene, camera, TOLERANCE, effects=quiet).views.astype(float)
    except InputError:
        return
    for effect in plan.effects:
        statistical = effect.name in ("shot_noise", "read_noise", "quantisation")  # bound a mean
        no_stop = effect.name == "f_number_mismatch" and not decided["round_aperture"]
        if not np.isfinite(effect.bound) or effect.bound == 0 or statistical or no_stop:
            continue
        off = dict.fromkeys(WITHOUT.get(effect.name, ()), False)
        states = [decided | off | {effect.name: on} for on in (False, True)]
        try:
            change, error = _largest_change(scene, camera, states, effect.bound, image.max())
        except InputError:  # the forced image is refused
            continue
        bound = float(effect.bound)
        yield {"effect": effect.name, "bound": bound, "change": change, "error": error}
    try:
        finer = render(scene, camera, TOLERANCE / 10, effects=quiet).views.astype(float)
    except InputError:
        return
    change = float(np.sqrt(np.mean((image - finer) ** 2)) / (finer.max() or 1.0))
    yield {"effect": WHOLE, "bound": TOLERANCE, "change": change, "error": 0.0}


def _largest_change(scene, camera, states, bound: float, brightest: float) -> tuple[float, float]:
    """Largest change of a pixel between two states, and the error of the rays that showed it.

    Both are relative to the brightest pixel, of these images or of the one as decided. Thick layers
    have as many slabs in both images, which use rays if a state needs them: the fewest, or else the
    largest tolerance, that show the change to be within the bound and their error, which is how far
    fewer rays, or the larger tolerance, were off in both.
    """
    by_rays = partial(plan_effects, scene, camera, TOLERANCE, integrator="rays")
    plans = [by_rays(state, rays=RAY_COUNTS[0]) for state in states]
    rays = any(plan.traced for plan in plans)
    before: list[np.ndarray] = []
    for step in RAY_COUNTS if rays else TOLERANCES:
        if not rays:
            plans = [plan_effects(scene, camera, step, state) for state in states]
        slabs = tuple(map(max, *(plan.slabs for plan in plans)))
        alike = {"slabs": slabs} if all("thickness" in plan.kept for plan in plans) else {}
        plans = [replace(plan, rays=step if rays else None, **alike) for plan in plans]
        images = [render_plan(scene, camera, plan, seed=1).views.astype(float) for plan in plans]
        peak = max(brightest, *(image.max() for image in images)) or 1.0
        change = float(np.abs(images[0] - images[1]).max() / peak)
        pairs = zip(images, before, strict=False)
        error = sum(float(np.abs(one - other).max() / peak) for one, other in pairs)
        if change <= bound + error + ROUNDING:
            break
        before = images
    return change, error


def check_bounds(scenes: int, seed: int) -> dict:
    """Compare changes with their bounds on random scenes, in a process per core.

    Ratios, bound over change, are those of changes above the rounding and ten times the error of
    the rays. A violation is a change above the bound and that error.
    """
    with ProcessPoolExecutor(
        mp_context=get_context("spawn"), initializer=numba.set_num_threads, initargs=(1,)
    ) as pool:
        found = list(step_bar(pool.map(partial(measure_scene, seed), range(scenes)), scenes))
    lines = pd.DataFrame([row for rows in found if rows for row in rows])
    refused = sum(rows is None for rows in found)
    violates = lines.change > lines.bound + lines.error + ROUNDING
    sure = (lines.change > ROUNDING) & (lines.error < lines.change / 10)
    lines = lines.assign(ratio=(lines.bound / lines.change).where(sure), violates=violates)
    table = lines.groupby("effect", sort=False).agg(
        scenes=("effect", "size"),
        smallest=("ratio", "min"),
        median=("ratio", "median"),
        largest=("ratio", "max"),
        violations=("violates", "sum"),
    )
    return {
        "scenes": scenes,
        "refused": refused,
        "most_seconds": MOST_SECONDS,
        "left": scenes - refused - int((lines.effect == WHOLE).sum()),
        "seed": seed,
        "tolerance": TOLERANCE,
        "rows": table.reset_index().to_dict("records"),
        "violations": lines[violates].to_dict("records"),
    }


def body(found: dict) -> list[str]:
    """Write the table, and what it means, as Markdown."""
    ratios = ("smallest", "median", "largest")
    columns = {name: (name, ".3g" if name in ratios else "") for name in found["rows"][0]}
    return [
        "## Bounds on random scenes",
        f"Bound over the largest change of a pixel in {found['scenes']} random scenes, "
        f"{found['refused']} of them refused, before cameras with each imperfection half of the "
        f"time; {found['left']} were left after {MOST_SECONDS} s of processor time, or as no "
        "number of parts is enough at a tenth of the tolerance, and count as far as they came. "
        "Each effect is forced against what the plan decided, all else as decided. Ratios "
        "are those of changes above the rounding of float32 and ten times the error of the rays; a "
        f"violation is a change above the bound plus the error. The line {WHOLE} compares "
        "images at the tolerance with those at a tenth of it, as a root mean square.",
        markdown(found["rows"], columns, missing="nan"),
    ]
