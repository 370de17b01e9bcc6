"""How many frames a second each step of `lf-flame process` does, and what a minute at 1 kHz costs.

    python -m experiments.benchmarks.video --out results/benchmarks

Steps are timed in turn on one thread, as in each of many processes. The floor of a step reads what
it reads and writes what it writes once: a file from the disk's cache, arrays in memory. Then all
frames are processed by two processes, and by a local Dask cluster of two.
"""

import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from shutil import rmtree
from tempfile import TemporaryDirectory

import numpy as np
import tifffile

from experiments.benchmarks.report import command_line, finish
from experiments.timing import in_turn
from lf_flame import PAPER_CAMERA
from lf_flame._common.threads import one_thread
from lf_flame._common.workers import worker_pool
from lf_flame.commands.frames import FrameReader
from lf_flame.commands.reading_options import Reading
from lf_flame.datasets.clusters import cluster_executor
from lf_flame.flame_video import find_steps, process_frames
from lf_flame.flame_video.processing.steps import Frame
from lf_flame.formats.raw.reading import plan_raw, read_frame
from lf_flame.scenes.flames import flame_texture

VIEWS = 9
STEPS = ("refocus@0.5", "height", "contour", "emission")
WORKERS = ("processes", "workers of a cluster")
ROUNDS = 9
"""Number of times that all frames are processed in each of the two ways, in turn."""

MINUTE = 60_000
"""Number of frames of a minute at 1 kHz."""

CORE_HOUR = 0.04
"""Price of an hour of one core in a cloud, in dollars: assumed."""

COLUMNS = {
    "what": ("what", ""),
    "ms": ("ms a frame", ".4g"),
    "frames a second": ("frames a second", ".4g"),
    "floor ms": ("floor ms", ".3g"),
    "over floor": ("over the floor", ".3g"),
    "core hours": ("core hours a minute at 1 kHz", ".3g"),
    "dollars": (f"dollars, at {CORE_HOUR:g} a core hour", ".3g"),
}


def write_frames(folder: Path, lenslets: int, count: int) -> list[Path]:
    """Write raw frames of 16 bits: a flame behind lenslets of `VIEWS` pixels, with noise."""
    rng, paths = np.random.default_rng(0), []
    flame = flame_texture(0.6 * lenslets, 0.08 * lenslets, cell_mm=1)
    image = np.zeros((lenslets, lenslets))
    top, left = lenslets // 5, (lenslets - flame.shape[1]) // 2
    image[top : top + len(flame), left : left + flame.shape[1]] = flame
    raw = np.kron(image, np.ones((VIEWS, VIEWS)))
    for number in range(count):
        noisy = 3000 * raw + 100 + 10 * rng.standard_normal(raw.shape)
        paths.append(folder / f"frame_{number:04d}.tif")
        tifffile.imwrite(paths[-1], np.rint(noisy).astype(np.uint16))
    return paths


def measure(folder: Path, lenslets: int, count: int, small: bool) -> list[dict]:
    """Time every step on one thread, then all frames by processes and by a cluster."""
    paths = write_frames(folder, lenslets, count)
    camera = replace(PAPER_CAMERA, views=VIEWS, lenslets=(lenslets, lenslets))
    plan, raw = plan_raw(paths[0], pitch=float(VIEWS))
    light_field = plan.decode(raw)
    depths = (-8.0, 0.0, 8.0)
    steps = find_steps(",".join(STEPS), camera=camera, depths_mm=depths, strength=0.001)
    frame = Frame(light_field)
    values = [step(frame) for step in steps]  # compiles
    cube, image = light_field.views, values[0]["refocus_0.5"].values
    cells = np.empty((len(depths), *image.shape), np.float32)

    def again(step: Callable, prepared: np.ndarray | None = None) -> None:
        fresh = Frame(light_field)
        if prepared is not None:
            fresh.image = prepared
        step(fresh)

    alone = image.astype(np.float64)
    measured = {
        "read a file": (lambda: read_frame(paths[0]), paths[0].read_bytes),
        "decode": (lambda: plan.decode(raw), lambda: (raw.max(), np.copyto(cube.copy(), cube))),
        STEPS[0]: (partial(again, steps[0]), lambda: (cube.max(), image.copy())),
        "height": (partial(again, steps[1], alone), alone.max),
        "contour": (partial(again, steps[2], alone), alone.max),
        f"emission on {len(depths)} planes": (
            partial(again, steps[3]), lambda: (cube.max(), cells.copy())
        ),
    }  # fmt: skip
    calls = [call for pair in measured.values() for call in pair]
    with one_thread():
        best = in_turn(*calls, rounds=1 if small else 3).best
    rows = [_row(what, best[2 * k], floor=best[2 * k + 1]) for k, what in enumerate(measured)]
    rows.append(_row("all steps", sum(best[::2]), floor=sum(best[1::2])))
    reader = FrameReader(paths[0], Reading(pitch=float(VIEWS)))
    go = partial(
        process_frames, paths, steps=find_steps("refocus@0.5,height"), times_s=range(count),
        read=reader,
    )  # fmt: skip
    with worker_pool(2) as pool, cluster_executor(local=2) as cluster:
        calls = [
            partial(_anew, partial(go, executor=executor), folder / name)
            for name, executor in (("pool", pool), ("cluster", cluster))
        ]
        spent = in_turn(*calls, rounds=1 if small else ROUNDS)
    for name, median in zip(WORKERS, np.median(spent.seconds, axis=1) / count, strict=True):
        rows.append(_row(f"read, decode, refocus, height by 2 {name}", 2 * float(median)))
        rows[-1]["frames a second"] = 1 / float(median)
    return rows


def _anew(go: Callable[[Path], object], out: Path) -> None:
    """Process all frames into a folder that is not there yet."""
    rmtree(out, ignore_errors=True)
    go(out)


def _row(what: str, per_frame: float, floor: float | None = None) -> dict:
    """Make a row of the seconds of one core for a frame."""
    hours = MINUTE * per_frame / 3600
    row = {"what": what, "ms": 1e3 * per_frame, "frames a second": 1 / per_frame}
    if floor is not None:
        row |= {"floor ms": 1e3 * floor, "over floor": per_frame / floor}
    return row | {"core hours": hours, "dollars": CORE_HOUR * hours}


def main() -> None:
    """Measure, print and write."""
    parser = command_line(__doc__)
    parser.add_argument("--frames", type=int, default=64, help="frames of the whole runs")
    asked = parser.parse_args()
    lenslets, count = (24, 16) if asked.small else (228, asked.frames)
    side = lenslets * VIEWS
    sys.stderr.write(f"measuring: {count} frames of {side} x {side} pixels\n")
    with TemporaryDirectory() as folder:
        rows = measure(Path(folder), lenslets, count, asked.small)
    raw_gb = MINUTE * 2 * side**2 / 1e9
    kept_gb = MINUTE * 4 * lenslets**2 / 1e9
    notes = [
        f"Frames of {side} x {side} pixels of 16 bits, {VIEWS} x {VIEWS} views. A minute at 1 kHz "
        f"is {MINUTE} frames, {raw_gb:.3g} GB of raw files; an image refocused at one depth takes "
        f"{kept_gb:.3g} GB before compression in {MINUTE} files, and each plane of emission as "
        f"much."
    ]
    finish(asked.out, "video", "Frames a second of each step", {"rows": rows}, COLUMNS, notes)


if __name__ == "__main__":
    main()
