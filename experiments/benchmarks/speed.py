"""How fast the simulator is: ratios within one run, against named baselines, outputs compared.

    make benchmarks

Each pair is timed in turn, again and again, and the best of each counts, so that what else the
machine does hits both alike. Times by themselves depend on the machine; the ratios carry over.
"""

import argparse
import math
import subprocess
import sys
import time
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import numba
import numpy as np
import pandas as pd
from numba import njit

from experiments._kernels import sum_rows
from experiments.benchmarks.report import write_table
from experiments.timing import best_of
from lf_flame import PAPER_CAMERA, Layer, PlenopticCamera, Scene, render
from lf_flame._common.provenance import environment
from lf_flame._common.threads import as_counters, pieces, shared
from lf_flame.datasets.config import read_config
from lf_flame.refocus import _kernels as refocus_kernels
from lf_flame.refocus import all_in_focus, find_sharpest_slopes, shift_and_sum
from lf_flame.simulation import _exact_kernels, _ray_kernels
from lf_flame.simulation.exact import integrate
from lf_flame.simulation.optical_pass import OpticalPass
from lf_flame.simulation.rays import trace
from lf_flame.simulation.slabs import slice_scene

SOME_LINES = slice(20, None, 45)
"""Lines of the image on which many rays are traced."""

FOUR_SLOPES = [2.3, 1.2, 0.0, -1.2]

CACHED_ROWS = 3
"""Rows of 15 x 15 views of 180 pixels that the second-level cache holds: half a megabyte."""

COLUMNS = ["what", "ours", "baseline", "unit", "ratio", "wanted", "outputs differ by"]


def difference(one: np.ndarray, other: np.ndarray) -> str:
    """Root-mean-square difference relative to the brightest pixel."""
    rms = math.sqrt(np.mean(np.square(one - other, dtype=np.float64)))
    return f"{rms / one.max():.1e}"


def trace_with_numpy(layer: Layer, camera: PlenopticCamera, rays: int) -> np.ndarray:
    """Trace single rays by 2x2 matrices in NumPy and bin them, as a first program would."""
    n, (lines, columns) = camera.views, camera.lenslets
    back = np.linalg.inv(camera.object_to_array(layer.depth_mm))
    s = camera.lenslet_to_sensor()
    sub = (np.arange(rays) + 0.5) / rays - 0.5
    hits = []
    for axis, lenslets in ((0, lines), (1, columns)):
        place = (np.arange(lenslets) - (lenslets - 1) / 2) * camera.lenslet_pitch_mm
        view = (np.arange(n) - (n - 1) / 2) * camera.pixel_mm
        chief = place * camera.lenslet_focal_mm / camera.image_distance_mm
        delta = sub * camera.lenslet_pitch_mm
        q = (chief[None, :] + view[:, None])[..., None] + sub * camera.pixel_mm
        q, delta = np.broadcast_arrays(q[..., :, None], delta)
        state = np.stack([place[None, :, None, None] + delta, (q - s[0, 0] * delta) / s[0, 1]])
        height = -np.einsum("j,j...->...", back[0], state).reshape(n, lenslets, -1)
        edges = layer.cell_edges_mm(axis)
        cell = np.floor((height - edges[0]) / (edges[1] - edges[0])).astype(int)
        hits.append(np.where((cell < 0) | (cell >= edges.size - 1), edges.size - 1, cell))
    padded = np.pad(layer.texture, ((0, 1), (0, 1)))
    pixels = np.arange(lines * columns).reshape(lines, columns)
    count = hits[0].shape[2]
    image = np.empty((n, n, lines, columns), np.float32)
    for v in range(n):
        for u in range(n):
            light = padded[hits[0][v][:, None, :, None], hits[1][u][None, :, None, :]]
            which = np.broadcast_to(pixels[:, :, None, None], light.shape).ravel()
            sums = np.bincount(which, light.ravel(), lines * columns)
            image[v, u] = sums.reshape(lines, columns) / count**2
    return image


@njit(cache=True)
def trace_with_a_loop(texture, edges, scale, centres, widths, rays, out):
    """Trace single rays in one fused loop that nobody tuned: all arithmetic for every ray."""
    n, _, lines, columns = out.shape
    for v in range(n):
        for u in range(n):
            for t in range(lines):
                for s in range(columns):
                    light = 0.0
                    for i in range(rays):
                        for j in range(rays):
                            for k in range(rays):
                                for m in range(rays):
                                    a, b = (i + 0.5) / rays - 0.5, (j + 0.5) / rays - 0.5
                                    c, d = (k + 0.5) / rays - 0.5, (m + 0.5) / rays - 0.5
                                    y = centres[0][v, t] + widths[0][0] * a + widths[0][1] * b
                                    x = centres[1][u, s] + widths[1][0] * c + widths[1][1] * d
                                    row = math.floor((y - edges[0]) * scale[0])
                                    column = math.floor((x - edges[1]) * scale[1])
                                    inside = 0 <= row < texture.shape[0]
                                    if inside and 0 <= column < texture.shape[1]:
                                        light += texture[row, column]
                    out[v, u, t, s] = light / rays**4


def baseline_loop(layer: Layer, camera: PlenopticCamera, rays: int) -> np.ndarray:
    """Set up the loop above."""
    out = np.empty((camera.views, camera.views, *camera.lenslets), np.float32)
    optics = OpticalPass(camera)
    footprints = [optics.footprint(layer.depth_mm, axis) for axis in (0, 1)]
    edges = [layer.cell_edges_mm(axis) for axis in (0, 1)]
    first = np.array([edge[0] for edge in edges])
    scale = np.array([1 / (edge[1] - edge[0]) for edge in edges])
    centres = tuple(footprint.centres_mm for footprint in footprints)
    widths = tuple((f.lenslet_width_mm, f.pixel_width_mm) for f in footprints)
    trace_with_a_loop(layer.texture, first, scale, centres, widths, rays, out)
    return out


@shared
def bare_integrate_rows(queue, columns, start, weight, first, last, out):
    """Do what `integrate_rows` does, for one plane, with no code for any effect."""
    for k in pieces(queue, weight.shape[1] * weight.shape[2]):
        a, c = k // weight.shape[2], k % weight.shape[2]
        if not weight[0, a, c].any():
            continue
        total = np.empty(columns.shape[2])
        for b in range(columns.shape[1]):
            inside = total[first[0, b] : last[0, b]]
            inside[:] = 0.0
            for i in range(weight.shape[3]):
                w = weight[0, a, c, i]
                cells = columns[start[0, a, c] + i, b, first[0, b] : last[0, b]]
                for d in range(inside.size):
                    inside[d] += w * cells[d]
            for d in range(first[0, b], last[0, b]):
                out[a, b, c, d] += np.float32(total[d])


@shared
def bare_trace(queue, emission, rows, columns, down, right, stride, seen, first, last, share, out):
    """Trace every ray of every pixel by itself, for one plane, with no code for any effect."""
    for k in pieces(queue, seen.size):
        a, c = k // seen.shape[1], k % seen.shape[1]
        if not seen[a, c]:
            continue
        for b in range(first.size):
            for d in range(first[b], last[b]):
                light = 0.0
                for i in range(rows.shape[3]):
                    row, low = rows[0, a, c, i], down[0, a, c, i]
                    for j in range(columns.shape[3]):
                        at, far = row + columns[0, b, d, j], right[0, b, d, j]
                        upper = emission[at] + far * (emission[at + 1] - emission[at])
                        lower = emission[at + stride]
                        lower += far * (emission[at + stride + 1] - emission[at + stride])
                        light += upper + low * (lower - upper)
                out[a, b, c, d] += np.float32(light * share)


def captured(kernels, kernel: str, call) -> tuple:
    """Arguments with which the package calls a kernel of a module."""
    found, original = [], getattr(kernels, kernel)
    setattr(kernels, kernel, lambda *args: found.append(args) or original(*args))
    try:
        call()
    finally:
        setattr(kernels, kernel, original)
    return found[0]


def blank(camera: PlenopticCamera) -> np.ndarray:
    """Make a dark light field whose memory has been touched."""
    return np.full((camera.views, camera.views, *camera.lenslets), 0, np.float32)


def layer_for(camera: PlenopticCamera, depth_mm: float = 10.0, share: float = 1.3) -> Layer:
    """Make a full-frame layer of smooth light on cells of about 0.1 mm."""
    size = tuple(share * side for side in camera.field_mm(depth_mm))
    cells = [round(side / 0.1) for side in size]
    y, x = (np.linspace(0, 6 * np.pi, n) for n in cells)
    return Layer(1 + 0.5 * np.outer(np.sin(y), np.cos(x)), depth_mm, size)


def ray_rows() -> list[tuple]:
    """Time the ray integrator on one core against NumPy and against an untuned loop."""
    numba.set_num_threads(1)
    camera = replace(PAPER_CAMERA, views=5, lenslets=(60, 60))
    layer, optics, image = layer_for(camera), OpticalPass(camera), blank(camera)
    planes = slice_scene(Scene([layer]), {}, absorption=False, dimming=set())

    def ours():
        image[:] = 0
        trace(planes, optics, "views", 9, image)

    rays = captured(_ray_kernels, "trace_apart", ours)[1]
    per_pixel = rays.rows.shape[3] * rays.columns.shape[3]
    traced = camera.views**2 * math.prod(camera.lenslets) * per_pixel
    found = {}

    def by_numpy():
        found["NumPy, 2x2 matrices and binning"] = trace_with_numpy(layer, camera, 3)

    def by_loop():
        found["untuned Numba loop"] = baseline_loop(layer, camera, 3)

    seconds, *others = best_of(7, ours, by_numpy, by_loop)
    singles = camera.views**2 * math.prod(camera.lenslets) * 81
    return [
        (f"ray integrator, one core, against {name}", traced / seconds / 1e6, singles / s / 1e6,
         "Mray/s", (traced / seconds) / (singles / s), "at least 150 Mray/s",
         difference(image, other))
        for s, (name, other) in zip(others, found.items(), strict=True)
    ]  # fmt: skip


def bare_rows() -> list[tuple]:
    """Time kernels that know about effects against bare ones, on scenes that need none."""
    numba.set_num_threads(1)
    rows = []
    camera = replace(PAPER_CAMERA, views=9, lenslets=(120, 160))
    layer, optics, image, other = (
        layer_for(camera),
        OpticalPass(camera),
        blank(camera),
        blank(camera),
    )
    planes = slice_scene(Scene([layer]), {}, absorption=False, dimming=set())
    args = captured(
        _exact_kernels, "integrate_rows", lambda: integrate(planes, optics, "views", image)
    )
    lines, start, weight, _, _, first, last, _, _ = args
    pair = best_of(
        15,
        lambda: _exact_kernels.integrate_rows(*args),
        lambda: bare_integrate_rows(lines, start, weight, first, last, other),
    )
    pixels = image.size / 1e6
    rows.append(
        (
            "exact kernel, nothing kept, against a bare one",
            pixels / pair[0],
            pixels / pair[1],
            "Mpixel/s",
            pair[0] / pair[1],
            "time ratio at most 1.05",
        )
    )
    args = captured(_ray_kernels, "trace_apart", lambda: trace(planes, optics, "views", 4, image))
    table, ray_table, weights, seen, share, _ = args
    cells, stride = table.emission, int(table.stride[0])
    bare = (cells, ray_table.rows, ray_table.columns, *weights, stride, *seen, share, other)
    pair_rays = best_of(9, lambda: _ray_kernels.trace_apart(*args), lambda: bare_trace(*bare))
    rays = image.size * ray_table.rows.shape[3] * ray_table.columns.shape[3] / 1e6
    rows.append(("ray kernel, nothing kept, against a bare one", rays / pair_rays[0],
                 rays / pair_rays[1], "Mray/s", pair_rays[0] / pair_rays[1],
                 "time ratio at most 1.05"))  # fmt: skip
    image[:], other[:] = 0, 0
    _ray_kernels.trace_apart(*args)
    bare_trace(*bare)
    return [(*row, difference(image, other)) for row in rows]


def exact_rows() -> list[tuple]:
    """Time the exact integrator: a full-frame layer, and the shape scene against rays."""
    numba.set_num_threads(numba.config.NUMBA_NUM_THREADS)
    camera = PAPER_CAMERA
    layer, optics, image = layer_for(camera), OpticalPass(camera), blank(camera)
    planes = slice_scene(Scene([layer]), {}, absorption=False, dimming=set())
    seconds, written = best_of(
        5, lambda: integrate(planes, optics, "views", image), lambda: np.add(image, 1, out=image)
    )
    rate, floor = image.size / seconds / 1e6, image.size / written / 1e6
    rows = [(f"exact integrator, full-frame layer, {numba.get_num_threads()} cores, against "
             "NumPy adding 1 to the image", rate, floor, "Mpixel/s", rate / floor,
             "at least 300 Mpixel/s", "")]  # fmt: skip
    config = read_config("data_gen/shapes.toml")
    scene, _ = config.template.draw(None)
    planes = slice_scene(scene, {}, absorption=False, dimming=set())
    small = replace(PAPER_CAMERA, views=15, lenslets=(90, 180))
    optics, exact = OpticalPass(small), blank(small)
    numba.set_num_threads(1)
    integrate(planes, optics, "views", exact)
    some = exact[:, :, SOME_LINES]
    (ours,) = best_of(5, lambda: integrate(planes, optics, "views", blank(small)))
    for finite_width, name in ((True, "ray integrator"), (False, "midpoint rule")):
        count, seconds, rays = _rays_for(1e-3, planes, optics, finite_width, some)
        theirs = seconds * exact.shape[2] / some.shape[2]
        what = (
            f"exact integrator against the {name} ({count} x {count} rays), shape scene, one core"
        )
        numbers = (ours * 1e3, theirs * 1e3, "ms", theirs / ours)
        rows.append((what, *numbers, "at least 100 times", difference(some, rays)))
    return rows


def _rays_for(error: float, planes, optics: OpticalPass, finite_width: bool, truth: np.ndarray):
    """Fewest rays, in steps of a half, whose error is small enough, their time and image."""
    count = 2
    while True:
        _trace_some(planes, optics, 1, finite_width, truth)
        started = time.perf_counter()
        image = _trace_some(planes, optics, count, finite_width, truth)
        seconds = time.perf_counter() - started
        rms = math.sqrt(np.mean(np.square(image - truth, dtype=np.float64)))
        if rms <= error * truth.max():
            return count, seconds, image
        count = math.ceil(1.5 * count)


def _trace_some(
    planes, optics: OpticalPass, rays: int, finite_width: bool, like: np.ndarray
) -> np.ndarray:
    image = np.zeros_like(like)
    trace(planes, optics, "views", rays, image, SOME_LINES, finite_width=finite_width)
    return image


def whole_rows() -> list[tuple]:
    """Render and refocus a paper-sized light field, and start the program."""
    numba.set_num_threads(numba.config.NUMBA_NUM_THREADS)
    config = read_config("data_gen/shapes.toml")
    scene, _ = config.template.draw(None)
    slopes = [config.camera.depth_to_slope(depth) for depth in config.depths_mm]

    def both():
        shift_and_sum(render(scene, config.camera), slopes)

    (seconds,) = best_of(7, both)
    cores = numba.get_num_threads()
    return [
        (f"paper-sized light field rendered and refocused at 4 slopes, {cores} cores",
         seconds * 1e3, math.nan, "ms", math.nan, "under 300 ms", ""),
    ]  # fmt: skip


def reading_rows() -> list[tuple]:
    """Refocus four planes, and only sum them, against reading the light field once."""
    views = np.random.default_rng(0).random((15, 15, 90, 180), np.float32)
    pixels, sums = views.reshape(15 * 15, -1), np.empty(15 * 15, np.float32)
    rows, what = [], "four planes of 15 x 15 x 90 x 180"
    for cores in sorted({1, numba.config.NUMBA_NUM_THREADS}):
        numba.set_num_threads(cores)
        planes, reading = best_of(
            200, lambda: shift_and_sum(views, FOUR_SLOPES), lambda: sum_rows(pixels, sums)
        )
        rows.append((f"{what}, {cores} core(s), against reading them once", planes * 1e3,
                     reading * 1e3, "ms", planes / reading, "at most 5 times", ""))  # fmt: skip
    numba.set_num_threads(1)
    reading, cached = best_of(200, lambda: sum_rows(pixels, sums))[0], _sums_in_cache_s(views)
    rows.append((f"the same sums alone, 1 core, with {CACHED_ROWS} of the {views.shape[2]} rows, "
                 "which the cache holds, again and again, against reading all once", cached * 1e3,
                 reading * 1e3, "ms", cached / reading, "", ""))  # fmt: skip
    return rows


def _sums_in_cache_s(views: np.ndarray) -> float:
    """Seconds of the compiled loops for as many rows as there are, but always the same few."""
    loops, found = refocus_kernels.shift_and_sum, []

    def again_and_again(*arguments):
        *given, _, bad, out = arguments
        done = np.zeros(1, np.int64)
        begun = time.perf_counter()
        for _ in range(views.shape[2] // CACHED_ROWS):
            done[:] = 0
            loops(*given, as_counters(done), bad, out)
        found.append(time.perf_counter() - begun)

    few = np.ascontiguousarray(views[:, :, :CACHED_ROWS])
    with patch.object(refocus_kernels, "shift_and_sum", again_and_again):
        for _ in range(200):
            shift_and_sum(few, FOUR_SLOPES)
    return min(found)


def refocusing_rows() -> list[tuple]:
    """Refocus colour against grey, of the same bytes; the memory of a search and a slope map."""
    numba.set_num_threads(numba.config.NUMBA_NUM_THREADS)
    colour = np.random.default_rng(0).random((15, 15, 90, 180, 3), np.float32)
    grey, slopes = colour.reshape(15, 15, 90, 540), FOUR_SLOPES
    ours, theirs = best_of(
        15, lambda: shift_and_sum(colour, slopes), lambda: shift_and_sum(grey, slopes)
    )
    one = shift_and_sum(colour[..., 1], slopes)
    rates = colour.nbytes / ours / 1e9, grey.nbytes / theirs / 1e9
    rows = [
        ("four planes of 15 x 15 x 90 x 180 in colour, against grey of as many bytes", *rates,
         "GB/s", rates[0] / rates[1], "the grey rate",
         difference(shift_and_sum(colour, slopes)[..., 1], one)),
    ]  # fmt: skip
    views = np.random.default_rng(0).random((15, 15, 270, 540), np.float32)
    for what, search in (
        (
            "slope search",
            lambda some: find_sharpest_slopes(some, np.linspace(-1, 1, 41), tiles=(9, 18)),
        ),
        ("slope map", lambda some: all_in_focus(some, np.linspace(-1, 1, 41))),
    ):
        held = views.nbytes / 1e6
        most = held + _traced_peak(search, views) / 1e6
        rows.append((f"{what} of 15 x 15 x 270 x 540, memory with the light field, against it",
                     most, held, "MB", most / held, "at most 2 times", ""))  # fmt: skip
    return rows


def _traced_peak(search: Callable, views: np.ndarray) -> int:
    """Bytes of arrays that are held at once, at most, beside the light field."""
    search(views[:4, :4, :60, :60])  # whatever is kept
    tracemalloc.start()
    try:
        search(views)
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def start_rows() -> list[tuple]:
    """Import the package in a new process."""

    def start(code: str) -> Callable:
        return lambda: subprocess.run([sys.executable, "-c", code], check=True)

    numbas = "import numba, numpy"
    rows = []
    for code, rival, name, wanted in (
        ("import lf_flame", "", "Python alone", "under 300 ms"),
        ("import lf_flame.refocus", numbas, numbas, "within 150 ms"),
        ("from lf_flame.refocus import refocus", numbas, numbas, "within 150 ms"),
        ("from lf_flame import render", numbas, numbas, ""),
        ("from lf_flame.refocus import all_in_focus", numbas, numbas, ""),
    ):
        ours, theirs = best_of(5, start(code), start(rival))
        rows.append((f"{code}, against {name}", ours * 1e3, theirs * 1e3, "ms", ours / theirs,
                     wanted, ""))  # fmt: skip
    return rows


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("experiments/results/benchmarks"))
    out = parser.parse_args().out
    rows = []
    for part in (
        ray_rows,
        bare_rows,
        exact_rows,
        whole_rows,
        reading_rows,
        refocusing_rows,
        start_rows,
    ):
        sys.stderr.write(f"measuring: {part.__doc__.splitlines()[0]}\n")
        rows += part()
    table = pd.DataFrame(rows, columns=COLUMNS)
    formats = ("", ".4g", ".4g", "", ".3g", "", "")
    write_table(out / "speed", "Speed of the simulator", table, formats, environment())


if __name__ == "__main__":
    main()
