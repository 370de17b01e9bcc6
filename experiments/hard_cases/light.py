"""Images in and out of focus, stops, sums of many rays and slabs, and absorbers."""

import math
from dataclasses import replace
from decimal import Decimal, localcontext

import numpy as np

from experiments.effects.tracer import flat_views
from experiments.hard_cases.optics import PITCH, STEP
from experiments.hard_cases.report import UNIT32, Values, hard_case
from lf_flame import Layer, PlenopticCamera, Scene, plan_effects, render
from lf_flame._common.arrays import centred
from lf_flame.optics.camera import PAPER_CAMERA
from lf_flame.optics.ray_bundle import object_to_array, trace_footprint
from lf_flame.simulation.rendering import render_plan

CAMERA = replace(PAPER_CAMERA, views=4, lenslets=(10, 12))
ONE_PIXEL = replace(CAMERA, views=1, lenslets=(1, 1))
RAYS = {"integrator": "rays", "rays": 24}

WIDE = (300.0, 300.0)
"""Size of a layer that fills the field at all depths used here."""


def cells(rows: int = 8, columns: int = 9, seed: int = 5) -> np.ndarray:
    """Draw a rough texture."""
    return np.random.default_rng(seed).uniform(0.2, 1.0, (rows, columns))


def rendered(layers, camera: PlenopticCamera = CAMERA, **options) -> np.ndarray:
    """Render layers by the package."""
    return render(Scene(layers), camera, **options).views.astype(float)


def traced(layers, camera: PlenopticCamera = CAMERA) -> np.ndarray:
    """Multiply out the image of layers by the reference tracer."""
    return flat_views(Scene(layers), camera)


def filling(texture, depth: float, part: float, camera: PlenopticCamera = CAMERA) -> Layer:
    """Make a layer as large as a part of all that the pixels see at a depth."""
    sizes = []
    for axis in (0, 1):
        bundle = trace_footprint(camera, depth, axis)
        widths = abs(bundle.lenslet_width_mm) + abs(bundle.pixel_width_mm)
        sizes.append(part * float(np.ptp(bundle.centres_mm) + widths))
    return Layer(texture, depth, tuple(sizes))


@hard_case(
    "light at an object's edge on a lenslet's edge, shifted by 1e-13 mm",
    "floor of each ray's height",
    "weights by area",
    1e-11,
)
def on_the_edge() -> Values:
    unit, obvious, ours = CAMERA.field_mm(0.0)[0] / 10, [], []
    focused = object_to_array(CAMERA, 0.0)[0]
    slopes = centred(64) * CAMERA.aperture_mm / CAMERA.focus_distance_mm / 64
    for shift in (-1e-13, 0.0, 1e-13):
        cell = Layer([[1.0]], 0.0, (2 * unit, 2 * unit), (shift, shift))
        height = focused[0] * (unit + shift) + focused[1] * slopes
        for options in ({}, RAYS):
            ours.append(rendered([cell], **options)[:, :, 4, 5].mean())
            obvious.append(np.mean(np.floor(height / CAMERA.lenslet_pitch_mm) >= -1))
    return Values(np.ones(6), obvious, ours)


def at_the_middle(layer: Layer, camera: PlenopticCamera = CAMERA) -> np.ndarray:
    """Look up the cell on which each bundle is centred; 0 outside the layer."""
    index = []
    for axis in (0, 1):
        edges = layer.cell_edges_mm[axis]
        centres = trace_footprint(camera, layer.depth_mm, axis).centres_mm
        index.append(np.clip(np.searchsorted(edges, centres), 0, len(edges)))
    return np.pad(layer.texture, 1)[index[0][:, None, :, None], index[1][None, :, None, :]]


@hard_case(
    "cells from 1 nm to a lenslet, in and out of focus, of the brightest pixel",
    "cell at the bundle's middle",
    "exact integrals",
    4 * UNIT32,
)
def fine_cells() -> Values:
    exact, obvious, ours = [], [], []
    for depth in (0.0, 10.0):
        lenslet = abs(trace_footprint(CAMERA, depth, 0).lenslet_width_mm)
        chequered = np.indices((20, 24)).sum(axis=0) % 2
        for layer in (
            Layer([[1.0]], depth, (1e-6, 1e-6), (0.01, 0.02)),
            Layer(cells(700, 700), depth, (1.0, 1.0)),
            Layer(chequered, depth, (10 * lenslet, 12 * lenslet)),
            filling([[0.7]], depth, 0.6),
        ):
            image = traced([layer])
            exact.append(image / image.max())
            obvious.append(at_the_middle(layer) / image.max())
            ours.append(rendered([layer]) / image.max())
    return Values(np.array(exact), np.array(obvious), np.array(ours), scale=1.0)


@hard_case(
    "focal plane whose image is 1.5e8 mm away, in its own image",
    "B = a0 + i0 (1 - a0/f)",
    "chain from the focal plane: B is 0",
    1e-6,
)
def far_image() -> Values:
    camera = replace(CAMERA, focus_distance_mm=150.0 * (1 + 1e-6))
    layer = filling(cells(4, 5), 0.0, 0.7, camera)
    exact = traced([layer], camera)
    f, a0, i0 = camera.main_lens_focal_mm, camera.focus_distance_mm, camera.image_distance_mm
    blur = (a0 + i0 * (1 - a0 / f)) / camera.lenslet_focal_mm * camera.pixel_mm
    centre = (float(blur * (1 - camera.views) / 2),) * 2  # of the first view
    obvious = exact.copy()
    obvious[0, 0] = traced([replace(layer, centre_mm=centre)], camera)[0, 0]
    return Values(exact, obvious, rendered([layer], camera), exact.max())


@hard_case(
    "share of the light that a stop of 1 mm to 1 nm passes",
    "a ray passes with all of its breadth",
    "the part of its box that passes",
    1e-4,
    10,
)
def closed_stop() -> Values:
    exact, obvious, ours, width = [], [], [], float(STEP * PITCH * PAPER_CAMERA.views)
    for diameter in (1.0, 1e-3, 1e-6):
        camera = replace(CAMERA, views=5, pixel_pitch_mm=None, aperture_diameter_mm=diameter)
        exact.append(math.pi / 4 * diameter**2 / width**2)
        places = centred(5 * 9) * camera.aperture_mm / (5 * 9)
        obvious.append(np.mean(np.hypot(*np.meshgrid(places, places)) <= diameter / 2))
        layer = filling([[1.0]], 10.0, 3.0, camera)
        ours.append(rendered([layer], camera, integrator="rays", rays=9)[:, :, 5, 6].mean())
    return Values(np.array(exact), obvious, ours)


@hard_case("20 million rays into one pixel", "float32 sum", "float64 sums", UNIT32)
def many_rays() -> Values:
    ours = rendered([Layer([[0.1]], 5.0, WIDE)], ONE_PIXEL, integrator="rays", rays=4472)
    rays = np.full(4472**2, 0.1, np.float32)
    return Values(0.1, np.add.accumulate(rays, out=rays)[-1] / rays.size, ours[0, 0, 0, 0])


@hard_case(
    "a flame in 512 slabs or 64 colours", "each added to a float32 image", "float64", 2 * UNIT32, 5
)
def many_slabs() -> Values:
    flame = Scene([Layer([[0.1]], 5.0, WIDE, thickness_mm=2.0)])
    plan = replace(plan_effects(flame, ONE_PIXEL, effects={"thickness": True}), slabs=(512,))
    plans = plan, replace(plan, rays=RAYS["rays"])
    ours = [render_plan(flame, ONE_PIXEL, one).views[0, 0, 0, 0] for one in plans]
    camera = replace(ONE_PIXEL, chromatic_shift=1e-3)
    plan = plan_effects(flame, camera, effects={"chromatic": True, "thickness": False})
    ours.append(render_plan(flame, camera, replace(plan, colours=64)).views[0, 0, 0, 0])
    obvious = [np.add.accumulate(np.full(n, 0.1 / n, np.float32))[-1] for n in (512, 512, 64)]
    return Values(np.full(3, 0.1), obvious, ours)


def share_that_leaves(tau: float) -> float:
    """``(1 - exp(-tau)) / tau``, to more digits than there are."""
    if tau < 1e-20:
        return 1.0
    with localcontext(prec=60):
        return float((1 - (-Decimal(tau)).exp()) / Decimal(tau))


TAUS = np.array([0.0, 1e-300, 1e-17, 1e-12, 1e-8, 1e-5, 0.3, 50.0, 1e4])


@hard_case(
    "cells of optical thickness 0, 1e-17 ... 1e4 before a bright ground",
    "(1 - exp(-tau))/tau in float32",
    "expm1; by rays and exactly",
    1e-6,
)
def absorbing_cells() -> Values:
    """Three lenslets per cell: in the middle one every ray of a pixel meets the same cell."""
    camera, ground = replace(CAMERA, lenslets=(9, 9)), Layer([[2.0]], 20.0, WIDE)
    size, tau = camera.field_mm(0.0), TAUS.reshape(3, 3)
    flame = Layer(np.ones((3, 3)), 0.0, size, optical_thickness=tau)
    found = [
        rendered([flame, ground], camera, effects={"self_absorption": True}, **options)
        for options in ({}, RAYS)
    ]
    exact = np.array([share_that_leaves(one) + 2 * math.exp(-one) for one in TAUS])
    single = TAUS.astype(np.float32)
    obvious = (1 - np.exp(-single)) / single + 2 * np.exp(-single)
    ours = np.array([image[:, :, 1::3, 1::3] for image in found])
    shape = ours.shape
    exact, obvious = (np.broadcast_to(x.reshape(3, 3), shape) for x in (exact, obvious))
    return Values(exact, obvious, ours)
