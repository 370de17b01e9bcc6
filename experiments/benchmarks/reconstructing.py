"""How fast emission by depth is found: times beside the floor, errors against the truth.

    python -m experiments.benchmarks.reconstructing

The floor is the time of the Fourier transforms alone, with as many iterations: an iteration is a
transform of all depth planes and its inverse. Outputs are compared with fits of ten times as many
iterations, and with the flame. Times are the best of some rounds, on all cores.
"""

from dataclasses import replace
from functools import partial

import numba
import numpy as np
from scipy import fft

from experiments.benchmarks.report import command_line, finish
from experiments.timing import in_turn
from lf_flame import Layer, LightField, PlenopticCamera, Scene, render
from lf_flame.scenes.flames import flame_texture
from lf_flame.tomography import FrustumGrid, ReconstructionPlan
from lf_flame.tomography.penalised_fit import FrequencyFit
from lf_flame.tomography.reconstruction_plan import ITERATIONS

CAMERA = PlenopticCamera(
    main_lens_focal_mm=150,
    focus_distance_mm=326,
    lenslet_focal_mm=0.4,
    lenslet_pitch_mm=0.112,
    views=15,
    lenslets=(100, 100),
)
SHEETS_MM = [9.0, 3.0, -3.0, -9.0]
VOLUME_MM = np.linspace(-9.5, 9.5, 20)
PLACES = -0.12, 0.05, 0.1, -0.05
"""Distances of the flames from the optical axis, relative to their height."""

ROUNDS, NOISE = 5, 0.01
WANTED = {"four planes": 0.3, "twenty planes": 3.0, "a frame after the first": 0.1}

COLUMNS = {
    "what": ("what", ""),
    "views": ("views", ""),
    "seconds": ("seconds", ".3g"),
    "wanted": ("wanted", ".3g"),
    "iterations": ("iterations", ""),
    "floor, seconds": ("floor, seconds", ".2g"),
    "from convergence": ("from convergence, rms of the peak", ".1e"),
    "largest": ("largest", ".1e"),
    "error": ("worst plane's error", ".2%"),
}


def flames(camera: PlenopticCamera, frame: int = 0) -> Scene:
    """Four flames behind each other, which flicker by 3 % of their height from frame to frame."""
    height = 0.6 * camera.field_mm(0.0)[0] * (1 + 0.03 * np.sin(0.7 * frame))
    glow = flame_texture(height, height / 10, cell_mm=height / 150)
    size = height, 0.64 * height
    places = zip(SHEETS_MM, PLACES, strict=True)
    return Scene([Layer(glow, depth, size, (0.0, 2 * place * height)) for depth, place in places])


def recorded(camera: PlenopticCamera, frame: int = 0) -> LightField:
    """Light field of the flames with noise."""
    views = render(flames(camera, frame), camera).views
    noise = np.random.default_rng(frame).standard_normal(views.shape, dtype=np.float32)
    return LightField(views + np.float32(NOISE * views.max()) * noise)


def count_iterations(call) -> int:
    """Count the iterations of the splitting in a call."""
    found, plain = [], FrequencyFit.solve
    FrequencyFit.solve = lambda fit, torus: found.append(0) or plain(fit, torus)
    try:
        call()
    finally:
        FrequencyFit.solve = plain
    return len(found)


def transforms(planes: int, size: tuple[int, int], iterations: int) -> None:
    """Transform float32 planes there and back, as often as iterations do."""
    torus, workers = np.ones((planes, *size), np.float32), numba.get_num_threads()
    for _ in range(iterations):
        torus = fft.irfft2(fft.rfft2(torus, workers=workers), s=size, workers=workers)


def row(what: str, camera: PlenopticCamera, depths_mm, warm: bool = False) -> dict:
    """Time one case."""
    grid = FrustumGrid(camera, depths_mm)
    # Views that a round aperture cuts are not fitted; rendering them takes long.
    whole = replace(camera, aperture_diameter_mm=None)
    light_field = recorded(whole, int(warm))
    plan = ReconstructionPlan(grid)
    start = plan.reconstruct(recorded(whole)) if warm else None

    def ours():
        return (plan if warm else ReconstructionPlan(grid)).reconstruct(light_field, start=start)

    iterations = count_iterations(ours)
    size = plan.operators.gram.size
    times = in_turn(ours, partial(transforms, len(grid.depths_mm), size, iterations), rounds=ROUNDS)
    found = times.results[0]
    longer = ReconstructionPlan(grid, strength=found.strength, iterations=10 * ITERATIONS)
    off = found.emission - longer.reconstruct(light_field).emission
    peak = float(found.emission.max())
    result = {
        "what": what,
        "views": f"{grid.view_count} of {camera.lenslets[0]} x {camera.lenslets[1]}",
        "seconds": times.best[0],
        "wanted": WANTED[what],
        "iterations": iterations,
        "floor, seconds": times.best[1],
        "from convergence": float(np.sqrt(np.mean(np.square(off)))) / peak,
        "largest": float(np.abs(off).max()) / peak,
    }
    if len(grid.depths_mm) == len(SHEETS_MM):
        layers = flames(whole, int(warm)).layers
        truth = [grid.crop(grid.average(layer, k)) for k, layer in enumerate(layers)]
        errors = [np.linalg.norm(a - b) / np.linalg.norm(b)
                  for a, b in zip(found.emission, truth, strict=True)]  # fmt: skip
        result["error"] = float(max(errors))
    return result


def main() -> None:
    """Measure, print and write."""
    asked = command_line(__doc__).parse_args()
    camera = CAMERA.with_views(5) if asked.small else CAMERA
    camera = replace(camera, lenslets=(40, 40)) if asked.small else camera
    round_stop = replace(camera, aperture_diameter_mm=camera.views * camera.view_step_mm)
    few = replace(camera, views=9, lenslets=(41, 41))
    rows = [
        row("four planes", camera, SHEETS_MM),
        row("four planes", round_stop, SHEETS_MM),
        row("four planes", few, SHEETS_MM),
        row("a frame after the first", camera, SHEETS_MM, warm=True),
        row("a frame after the first", few, SHEETS_MM, warm=True),
        *([] if asked.small else [row("twenty planes", camera, VOLUME_MM)]),
    ]
    notes = [f"{numba.get_num_threads()} threads; {NOISE:.0%} noise; no bootstrap."]
    title = "Speed of emission by depth"
    finish(asked.out, "reconstructing", title, {"rows": rows}, COLUMNS, notes)


if __name__ == "__main__":
    main()
