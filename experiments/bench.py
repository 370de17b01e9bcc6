"""How fast refocusing, decoding, rendering and training are, against floors and named rivals.

All calls of a case are timed in turn, so that other load on the machine slows all equally: ratios
within one run carry over to other machines, milliseconds do not. A floor is a time below which the
task cannot be done: its inputs and outputs cross once, as fast as a compiled loop on all cores
reads as many bytes. A rival does the same task by NumPy, SciPy or Keras, and its output is compared
with ours.
"""

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import keras
import numba
import numpy as np
import pandas as pd
from scipy import ndimage

from experiments.inputs import DATA_SETS
from experiments.report import markdown, step_bar, write_report
from experiments.timing import in_turn, read_once
from lf_flame import render, shift_and_sum
from lf_flame._common.arrays import centred
from lf_flame._common.threads import one_thread
from lf_flame.datasets.config import read_config
from lf_flame.formats import DecodePlan, LensletGrid
from lf_flame.learning.decoder import build_decoder
from lf_flame.learning.fitting import Batches, shuffled_batches
from lf_flame.learning.training import compile_for_training
from lf_flame.optics.ray_bundle import trace_footprint

SLOPES = (2.1, 1.15, 0.35, -1.25)

STEPS = 30
"""Number of training steps that are timed together."""

ROUNDS, LEAST_S = 3, 1.0
"""Smallest number of rounds of a case, and of seconds that they take together."""


@dataclass(frozen=True)
class Other:
    """A floor or a rival of a case; `compare` writes how its output and ours differ."""

    name: str
    call: Callable
    compare: Callable[..., str] | None = None


@dataclass(frozen=True)
class Case:
    """A task of the package, and its floors and rivals; a call does it `repeats` times."""

    task: str
    what: str
    ours: Callable
    others: Sequence[Other]
    repeats: int = 1


def floor(*arrays: np.ndarray, what: str = "input and output read once") -> Other:
    """Make the floor of a task that must read and write these arrays."""
    return Other(f"floor: {what}", lambda: [read_once(x) for x in arrays])


def largest_difference(theirs: np.ndarray | float, ours: np.ndarray | float) -> str:
    """Largest difference of a pixel, relative to the brightest, or of a training loss."""
    return f"differ by {np.max(np.abs(ours - theirs)) / np.max(np.abs(theirs)):.0e} at most"


def refocusing_cases(small: bool) -> Iterator[Case]:
    """Yield light fields of noise, on which any error of a shift shows, at four slopes."""
    sizes = [(5, 5, 12, 18)] if small else [(15, 15, 90, 180), (15, 15, 270, 540)]
    for shape in sizes:
        views = np.random.default_rng(0).random(shape, np.float32)
        ours = partial(shift_and_sum, views, SLOPES)
        separable = Other("NumPy, separable, matrix products", partial(by_products, views, SLOPES),
                          largest_difference)  # fmt: skip
        what = f"four planes of {' x '.join(map(str, shape))}"
        others = [floor(views, ours()), separable]
        single = partial(on_one_thread, ours)
        if shape is sizes[0]:
            yield Case("refocusing", f"{what}, one thread for ours", single, others)
        yield Case("refocusing", f"{what}, {numba.get_num_threads()} threads", ours, others)


def on_one_thread(call: Callable) -> object:
    """Make a call, with compiled loops on one thread."""
    with one_thread():
        return call()


def by_products(views: np.ndarray, slopes: Sequence[float]) -> np.ndarray:
    """Shift and sum over v, where the lines gathered are contiguous, then over u."""
    images = np.empty((len(slopes), *views.shape[2:]), np.float32)
    for image, slope in zip(images, slopes, strict=True):
        down, right = (slope * centred(n) for n in views.shape[:2])
        sums = np.stack([_shifted_sum(views[:, u], down) for u in range(views.shape[1])])
        image[:] = _shifted_sum(sums.swapaxes(1, 2), right).swapaxes(0, 1)
    return images / np.float32(views.shape[0] * views.shape[1])


def _shifted_sum(lines: np.ndarray, shifts: np.ndarray) -> np.ndarray:
    """Gather lines[k, line], shifted by whole lines, and weigh and sum them in one product."""
    whole = np.floor(shifts).astype(int)
    places = np.clip(whole[:, None] + np.arange(lines.shape[1] + 1), 0, lines.shape[1] - 1)
    moved, rest = lines[np.arange(len(lines))[:, None], places], (shifts - whole).astype(np.float32)
    near, far = np.tensordot(np.stack([1 - rest, rest]), moved, axes=1)
    return near[:-1] + far[1:]


def decoding_cases(small: bool) -> Iterator[Case]:
    """Yield raw images of 12 bits, smooth texture seen through lenslets, with a white image."""
    square = LensletGrid(50.3, 61.2, 10.03, 0.001)
    illum = LensletGrid(50.3, 61.2, 14.29, -0.0005, "hexagonal")
    sizes = [("grey", (160, 200), square, 9, None)]
    if not small:
        sizes = [
            ("grey", (1024, 1024), square, 9, None),
            ("grey", (2048, 2048), square, 9, None),
            ("Bayer, hexagonal", (5368, 7728), illum, 15, "grbg"),
        ]
    for what, shape, grid, views, bayer in sizes:
        rng = np.random.default_rng(0)
        coarse = rng.uniform(300, 4000, [n // 16 + 2 for n in shape]).astype(np.float32)
        raw = np.rint(ndimage.zoom(coarse, 16, order=1)[: shape[0], : shape[1]]).astype(np.uint16)
        white = np.full(shape, 4000, np.uint16)
        started = time.perf_counter()
        plan = DecodePlan(grid, shape=shape, views=views, white=white, bayer=bayer)
        planned = time.perf_counter() - started
        found = plan.decode(raw).views
        others = [floor(raw, found)]
        if not bayer:
            places = part_places(grid, shape, views)
            others.append(Other("SciPy map_coordinates, one thread, without the white image",
                partial(by_interpolation, raw, places, found.shape), correlation))  # fmt: skip
        pixels = f"{shape[0]} x {shape[1]} pixels, {what}"
        what = f"{pixels}, to {views} x {views} views; its plan took {planned:.2g} s"
        yield Case("decoding", what, lambda plan=plan, raw=raw: plan.decode(raw).views, others)


def part_places(grid: LensletGrid, shape: tuple[int, int], views: int) -> np.ndarray:
    """Middles of the parts of all micro-images, shape (2, v, u, t, s)."""
    rows, columns = grid.block(shape)
    down, along = (centred(views) * step / views for step in (grid.row_pitch, grid.pitch))
    y, x = grid.position(rows[:, None], columns[None, :])
    dy, dx = grid.rotated(down[:, None], along[None, :])
    return np.stack([y + dy[:, :, None, None], x + dx[:, :, None, None]])


def by_interpolation(raw: np.ndarray, places: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Interpolate at the middle of each part of each micro-image, linearly."""
    found = ndimage.map_coordinates(raw, places, np.float32, order=1, mode="nearest")
    return found.reshape(shape)


def correlation(theirs: np.ndarray, ours: np.ndarray) -> str:
    """Correlation of the views without their edges."""
    inner = (slice(1, -1), slice(1, -1), slice(2, -2), slice(2, -2))
    found = np.corrcoef(theirs[inner].ravel(), ours[inner].ravel())[0, 1]
    return f"views correlate by {found:.4f}"


def rendering_cases(small: bool) -> Iterator[Case]:
    """Yield a scene of each data set as its camera records it, from scene to light field."""
    for path in DATA_SETS[:1] if small else DATA_SETS:
        config = read_config(path)
        scene, camera = config.template.draw(None)[0], config.camera
        camera = camera.with_views(3) if small else camera
        dense = Other("NumPy, dense matrices, float64", partial(_dense, scene, camera), error)
        image = floor(np.ones((camera.views,) * 2 + camera.lenslets, np.float32))
        for integrator in ("exact", "rays"):
            call = partial(rendered, scene, camera, 1e-3, integrator)
            what = f"{config.kind}, {integrator}, tolerance 0.001"
            yield Case("rendering", what, call, [image, dense])
        stop = replace(camera, aperture_diameter_mm=camera.aperture_mm)
        call = partial(rendered, scene, stop, 1e-2, "rays")
        yield Case("rendering", f"{config.kind}, rays, a round stop, tolerance 0.01", call, [image])


def _dense(scene, camera) -> np.ndarray:
    """Multiply each texture by the share of a pixel's rays in its rows, and in its columns."""
    image = 0.0
    for layer in scene.layers:
        shares = []
        for axis in (0, 1):
            seen = trace_footprint(camera, layer.depth_mm, axis)
            edges = layer.cell_edges_mm[axis] - seen.centres_mm.reshape(-1, 1)
            a, b = abs(seen.lenslet_width_mm), max(abs(seen.pixel_width_mm), 1e-6)
            ends = (-a - b, 1), (b - a, -1), (a - b, -1), (a + b, 1)  # of a trapezoid, twice
            ramps = (sign * np.maximum(edges - end / 2, 0) ** 2 for end, sign in ends)
            shares.append(np.diff(sum(ramps) / (2 * a * b), axis=1))
        image = image + shares[0] @ layer.texture @ shares[1].T
    n = camera.views
    return image.reshape(n, camera.lenslets[0], n, camera.lenslets[1]).swapaxes(1, 2)


def rendered(scene, camera, tolerance: float, integrator: str) -> np.ndarray:
    """Render the views of a scene."""
    return render(scene, camera, tolerance=tolerance, integrator=integrator).views


def error(theirs: np.ndarray, ours: np.ndarray) -> str:
    """Root-mean-square difference relative to the brightest pixel."""
    return f"rms difference {math.sqrt(np.mean((ours - theirs) ** 2)) / theirs.max():.0e}"


def training_cases(small: bool) -> Iterator[Case]:
    """Yield steps of the paper's recipe: the decoder after the frozen backbone, by Adam."""
    sizes = [("conv5", (3, 6, 2048), 2), ("conv4", (6, 12, 1024), 2), ("conv4", (6, 12, 1024), 16)]
    sizes, image = ([("small", (3, 6, 32), 2)], (9, 18)) if small else (sizes, (90, 180))
    for depth, shape, batch in sizes:
        keras.backend.clear_session()
        rng, count = np.random.default_rng(0), STEPS * batch
        features = np.maximum(rng.standard_normal((count, *shape), np.float32), 0)
        targets = rng.random((count, 4, *image, 1), np.float32)
        decoders = [build_decoder(shape, image, 4, 0.3) for _ in range(3)]
        for decoder, xla in zip(decoders[1:], (False, True), strict=True):
            decoder.compile(keras.optimizers.Adam(1e-4), "mse", jit_compile=xla)
        ours, plain, compiled = (
            partial(fit_once, network, shuffled_batches(features, targets, batch, seed=1))
            for network in (compile_for_training(decoders[0], 1e-4, STEPS), *decoders[1:])
        )
        # Parameters and both moments of Adam are read and written once.
        size = sum(math.prod(x.shape) for x in decoders[0].trainable_variables)
        moments = np.ones(6 * size, np.float32)
        others = [
            floor(*[moments] * STEPS, what="Adam's parameters and moments cross once"),
            Other("Keras's own fit", plain, largest_difference),
            Other("Keras's own fit with XLA (its dropout draws other numbers)", compiled),
        ]  # fmt: skip
        what = f"a step after {depth}, features of {' x '.join(map(str, shape))}, batch {batch}"
        yield Case("training", what, ours, others[: 2 if small else 3], STEPS)  # XLA compiles long


def fit_once(network: keras.Model, batches: Batches) -> float:
    """Train for an epoch; the mean loss."""
    options = {"steps_per_epoch": batches.steps, "shuffle": False, "verbose": 0}
    return network.fit(batches, **options).history["loss"][0]


COLUMNS = {
    "what": ("what", ""),
    "ours_ms": ("ours (ms)", ".4g"),
    "other": ("beside", ""),
    "other_ms": ("takes (ms)", ".4g"),
    "ratio": ("over ours", ".3g"),
    "q1": ("lower quartile", ".3g"),
    "q3": ("upper", ".3g"),
    "outputs": ("outputs", ""),
}


def measure(small: bool = False) -> dict:
    """Time all cases, or few small ones; returns the record, in ``rows`` the table."""
    started, rows = time.perf_counter(), []
    for task in (refocusing_cases, decoding_cases, rendering_cases, training_cases):
        for case in step_bar(task(small)):
            rows += measure_case(case, small)
    threads = numba.get_num_threads()
    return {"threads": threads, "wall_s": time.perf_counter() - started, "rows": rows}


def measure_case(case: Case, small: bool = False) -> list[dict]:
    """Compare the outputs of the first calls, then time all in turn; a row for each other."""
    calls = [case.ours, *(other.call for other in case.others)]
    first, *theirs = (call() for call in calls)
    rounds, least_s = (1, 0.0) if small else (ROUNDS, LEAST_S)
    times, rows = in_turn(*calls, rounds=rounds, least_s=least_s, warm_up=False), []
    for k, (other, output) in enumerate(zip(case.others, theirs, strict=True), 1):
        median, low, high = times.ratio(k, 0)
        rows.append({
            "task": case.task,
            "what": case.what,
            "ours_ms": 1e3 * float(times.best[0]) / case.repeats,
            "other": other.name,
            "other_ms": 1e3 * float(times.best[k]) / case.repeats,
            "ratio": median,
            "q1": low,
            "q3": high,
            "outputs": other.compare(output, first) if other.compare else "",
        })  # fmt: skip
    return rows


def write(out: Path, record: dict) -> Path:
    """Write ``bench.*`` from the record of `measure`."""
    table, body = pd.DataFrame(record["rows"]), []
    for task, rows in table.groupby("task", sort=False):
        body += [f"## {task.capitalize()}", markdown(rows, COLUMNS)]
    note = f"""On {record["threads"]} threads. Milliseconds are the best of three rounds or
more; ratios, of the other's time over ours, are median and quartiles of all rounds. Nothing can be
faster than a floor."""
    return write_report(
        out, "bench", "Speed beside floors and rivals", record,
        [note, *body], tables={"bench": table},
    )  # fmt: skip
