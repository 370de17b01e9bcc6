"""How fast the simulator is: ratios within one run, against named baselines, outputs compared.

    make benchmarks

All calls of a row are timed in turn (`experiments.timing.in_turn`). Times by themselves depend on
the machine; the ratios carry over.
"""

import math
import sys
import tracemalloc
from collections.abc import Callable
from dataclasses import replace

import numba
import numpy as np
from numba import njit

from experiments.benchmarks.report import command_line, finish, ratio
from experiments.timing import Times, in_turn
from lf_flame import PAPER_CAMERA, Layer, PlenopticCamera, Scene
from lf_flame._common.threads import parallel
from lf_flame.refocus import all_in_focus, find_sharpest_slopes, shift_and_sum
from lf_flame.simulation import _exact_kernels, _ray_kernels
from lf_flame.simulation.exact import integrate
from lf_flame.simulation.optical_pass import OpticalPass
from lf_flame.simulation.rays import trace
from lf_flame.simulation.slabs import slice_scene

FOUR_SLOPES = [2.3, 1.2, 0.0, -1.2]

COLUMNS = {
    "what": ("what", ""),
    "ours": ("ours", ".4g"),
    "baseline": ("baseline", ".4g"),
    "unit": ("unit", ""),
    "ratio": ("ratio", ".3g"),
    "quartiles": ("quartiles", ""),
    "wanted": ("wanted", ""),
    "outputs differ by": ("outputs differ by", ""),
}

NOTES = ["Best of some rounds. Ratio: ours over the baseline, median and quartiles of the rounds."]


def difference(one: np.ndarray, other: np.ndarray) -> str:
    """Root-mean-square difference relative to the brightest pixel."""
    rms = math.sqrt(np.mean(np.square(one - other, dtype=np.float64)))
    return f"{rms / one.max():.1e}"


def rates(
    what: str, unit: str, times: Times, work: tuple[float, float], wanted: str, differ: str = ""
) -> dict:
    """Make a row of the work, in millions, that each of two calls does in a second."""
    ours, baseline = (amount / 1e6 / best for amount, best in zip(work, times.best, strict=True))
    row = {"what": what, "ours": ours, "baseline": baseline, "unit": unit}
    row |= ratio(times, 1, 0, work[0] / work[1])
    return row | {"wanted": wanted, "outputs differ by": differ}


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


@parallel(lambda weight: weight.shape[1] * weight.shape[2])
def bare_integrate_rows(k, columns, start, weight, first, last, out):
    """Do what `integrate_rows` does, for one plane, with no code for any effect."""
    a, c = k // weight.shape[2], k % weight.shape[2]
    if not weight[0, a, c].any():
        return
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


@parallel(lambda seen: seen.size)
def bare_trace(k, emission, rows, columns, down, right, stride, seen, first, last, share, out):
    """Trace every ray of every pixel by itself, for one plane, with no code for any effect."""
    a, c = k // seen.shape[1], k % seen.shape[1]
    if not seen[a, c]:
        return
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


def ray_rows() -> list[dict]:
    """Time the ray integrator on one core against an untuned loop."""
    numba.set_num_threads(1)
    camera = replace(PAPER_CAMERA, views=5, lenslets=(60, 60))
    layer, optics, image = layer_for(camera), OpticalPass(camera), blank(camera)
    planes = slice_scene(Scene([layer]), {}, absorption=False, dimming=set())

    def ours():
        image[:] = 0
        trace(planes, optics, "views", 9, image)

    rays = captured(_ray_kernels, "trace_apart", ours)[1]
    times = in_turn(ours, lambda: baseline_loop(layer, camera, 3), rounds=7)
    work = image.size * rays.rows.shape[3] * rays.columns.shape[3], image.size * 3**4
    differ = difference(image, times.results[1])
    what = "ray integrator, one core, against untuned Numba loop"
    return [rates(what, "Mray/s", times, work, "at least 150 Mray/s", differ)]


def bare_rows() -> list[dict]:
    """Time kernels that know about effects against bare ones, on scenes that need none."""
    numba.set_num_threads(1)
    camera = replace(PAPER_CAMERA, views=9, lenslets=(120, 160))
    layer, optics = layer_for(camera), OpticalPass(camera)
    image, other = blank(camera), blank(camera)
    planes = slice_scene(Scene([layer]), {}, absorption=False, dimming=set())
    exact = captured(
        _exact_kernels, "integrate_rows", lambda: integrate(planes, optics, "views", image)
    )
    lines, start, weight, _, _, first, last, _, _ = exact
    rays = captured(_ray_kernels, "trace_apart", lambda: trace(planes, optics, "views", 4, image))
    table, ray_table, weights, seen, share, _ = rays
    bare = (table.emission, ray_table.rows, ray_table.columns, *weights, int(table.stride[0]))
    per_pixel = ray_table.rows.shape[3] * ray_table.columns.shape[3]
    rows = []
    for name, unit, work, kernel, bare_kernel in (
        ("exact", "Mpixel/s", 1, lambda: _exact_kernels.integrate_rows(*exact),
         lambda: bare_integrate_rows(lines, start, weight, first, last, other)),
        ("ray", "Mray/s", per_pixel, lambda: _ray_kernels.trace_apart(*rays),
         lambda: bare_trace(*bare, *seen, share, other)),
    ):  # fmt: skip
        image[:], other[:] = 0, 0
        kernel()
        bare_kernel()
        differ = difference(image, other)
        times = in_turn(kernel, bare_kernel, rounds=12)
        what = f"{name} kernel, nothing kept, against a bare one"
        rows.append(rates(what, unit, times, 2 * (work * image.size,), "at least 0.95", differ))
    return rows


def exact_rows() -> list[dict]:
    """Time the exact integrator on a full-frame layer, on all cores."""
    numba.set_num_threads(numba.config.NUMBA_NUM_THREADS)
    layer, optics, image = layer_for(PAPER_CAMERA), OpticalPass(PAPER_CAMERA), blank(PAPER_CAMERA)
    planes = slice_scene(Scene([layer]), {}, absorption=False, dimming=set())
    times = in_turn(
        lambda: integrate(planes, optics, "views", image),
        lambda: np.add(image, 1, out=image),
        rounds=5,
    )
    what = f"exact integrator, full-frame layer, {numba.get_num_threads()} cores, against NumPy "
    what += "adding 1 to the image"
    return [rates(what, "Mpixel/s", times, 2 * (image.size,), "at least 300 Mpixel/s")]


def colour_rows() -> list[dict]:
    """Refocus colour against grey, of the same bytes."""
    numba.set_num_threads(numba.config.NUMBA_NUM_THREADS)
    colour = np.random.default_rng(0).random((15, 15, 90, 180, 3), np.float32)
    grey = colour.reshape(15, 15, 90, 540)
    times = in_turn(
        lambda: shift_and_sum(colour, FOUR_SLOPES),
        lambda: shift_and_sum(grey, FOUR_SLOPES),
        rounds=15,
    )
    differ = difference(times.results[0][..., 1], shift_and_sum(colour[..., 1], FOUR_SLOPES))
    what = "four planes of 15 x 15 x 90 x 180 in colour, against grey of as many bytes"
    return [rates(what, "MB/s", times, 2 * (colour.nbytes,), "the grey rate", differ)]


def memory_rows() -> list[dict]:
    """Measure the memory of a search and of a slope map."""
    views = np.random.default_rng(0).random((15, 15, 270, 540), np.float32)
    slopes = np.linspace(-1, 1, 41)
    held, rows = views.nbytes / 1e6, []
    for what, search in (
        ("slope search", lambda some: find_sharpest_slopes(some, slopes, tiles=(9, 18))),
        ("slope map", lambda some: all_in_focus(some, slopes)),
    ):
        most = held + _traced_peak(search, views) / 1e6
        what += " of 15 x 15 x 270 x 540, memory with the light field, against it"
        row = {"what": what, "ours": most, "baseline": held, "unit": "MB", "ratio": most / held}
        rows.append(row | {"wanted": "at most 2 times"})
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


PARTS = (ray_rows, bare_rows, exact_rows, colour_rows, memory_rows)


def main() -> None:
    """Measure, print and write."""
    asked, rows = command_line(__doc__).parse_args(), []
    for part in PARTS[:2] if asked.small else PARTS:
        sys.stderr.write(f"measuring: {part.__doc__}\n")
        rows += part()
    finish(asked.out, "speed", "Speed of the simulator", {"rows": rows}, COLUMNS, NOTES)


if __name__ == "__main__":
    main()
