"""Height and flicker of a flame from a video of light fields at full size, through the command."""

import csv
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from experiments.tomography.tasks import Row
from lf_flame import PAPER_CAMERA, Layer, Scene, render
from lf_flame.scenes.flames import flame_texture

FRAMES, FRAMES_PER_SECOND = 24, 48.0
FREQUENCY_HZ = 11.0
HEIGHT_MM, SWING_MM = 24.0, 3.0
BURNER_MM = 15.0
"""Below the optical axis; every flame stands on it."""

TASK = "video, 15 x 15 views of 270 x 540"

WAYS = {
    "lf-flame flicker, the middle view": (),
    "lf-flame flicker, refocused on the flame": ("--slope", 0.0),
}


def _height_mm(frame: int) -> float:
    return HEIGHT_MM + SWING_MM * np.sin(2 * np.pi * FREQUENCY_HZ * frame / FRAMES_PER_SECOND)


def _bright_mm(frame: int) -> float:
    """Height up to which the flame is brighter than half its peak, by its own fine texture."""
    cell = 0.02
    line = flame_texture(_height_mm(frame), 2.4, cell_mm=cell).max(axis=1)
    first = int(np.argmax(line > line.max() / 2))  # rows from the top
    above, below = line[first - 1], line[first]
    share = (line.max() / 2 - above) / (below - above)
    return _height_mm(frame) - (first - 0.5 + share) * cell


def video(rng: np.random.Generator) -> Iterator[Row]:
    """Follow a flame that flickers, at 1 % of noise, one frame in memory at a time."""
    with tempfile.TemporaryDirectory() as folder:
        frames = Path(folder, "video")
        frames.mkdir()
        for frame in range(FRAMES):
            np.save(frames / f"frame{frame:03d}.npy", _record(frame, rng))
        for method, options in WAYS.items():
            list(_follow(frames, method, options))  # Loops are compiled, once per installation.
            yield from _follow(frames, method, options)


def _record(frame: int, rng: np.random.Generator) -> np.ndarray:
    height = _height_mm(frame)
    glow = flame_texture(height, 2.4, cell_mm=0.1)
    layer = Layer(glow, 0.0, (height, 2 * 3.2 * 2.4), (BURNER_MM - height / 2, 0.0))
    views = render(Scene([layer]), PAPER_CAMERA).views
    noise = rng.standard_normal(views.shape, dtype=np.float32)
    return views + np.float32(0.01 * views.max()) * noise


def _follow(frames: Path, method: str, options: tuple) -> Iterator[Row]:
    lenslet_mm = PAPER_CAMERA.field_mm(0.0)[0] / PAPER_CAMERA.lenslets[0]
    command = [Path(sys.executable).with_name("lf-flame"), "flicker", frames, *options]
    command += ["--frames-per-second", FRAMES_PER_SECOND, "--pixel-mm", lenslet_mm]
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder, "out")
        begin = time.perf_counter()
        subprocess.run([*map(str, command), "--out", str(out)], check=True, capture_output=True)
        seconds = time.perf_counter() - begin
        with (out / "flame.csv").open(newline="", encoding="utf-8") as file:
            heights = np.array([float(row["height_mm"]) for row in csv.DictReader(file)])
        found = json.loads((out / "flicker.json").read_text(encoding="utf-8"))
    # The program's heights begin at the picture's lower edge: a constant away from ours.
    off = heights - [_bright_mm(frame) for frame in range(FRAMES)]
    spread = float(np.abs(off - off.mean()).max() / lenslet_mm)
    yield Row(TASK, "1 %", method, "height's error, lenslets, at most", spread, 1.0, seconds)
    hertz = abs(float(found["flicker"]["frequency_hz"]) - FREQUENCY_HZ) * FRAMES / FRAMES_PER_SECOND
    yield Row(TASK, "1 %", method, "frequency's error, 1 / duration", hertz, 1.0, seconds)
    # Reading, measuring, drawing and the program's start.
    yield Row(TASK, "1 %", method, "seconds a frame", seconds / FRAMES, 1 / 3, seconds)
