"""Other penalties and solvers beside ours, on smooth and on sharp-edged emission."""

import time
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from experiments.tomography.phantoms import (
    BLOCK,
    EXACT,
    Recorder,
    overlapping_flames,
    paper_flames,
    shrunk,
    truth_on,
)
from experiments.tomography.tasks import DEPTHS_MM, OURS, Row, relative_errors, timed
from experiments.tomography.tikhonov import fit_tikhonov
from lf_flame import PAPER_CAMERA, Layer, LightField, Scene, render
from lf_flame.tomography import FrustumGrid, ProjectionOperator, reconstruct
from lf_flame.tomography.penalties import VARIATION
from lf_flame.tomography.plane_fit import average_blocks

VARIATION_METHOD = "total variation"
LSMR_METHOD = "Tikhonov by LSMR, strength of least true error"

STRENGTHS = (1e-3, 1e-2, 1e-1)
"""Of Tikhonov's fit; the one of least true error is shown, which a user could not choose."""


ITERATIONS = 200
"""Of LSMR; it stands after fewer at these strengths."""


def sharp_edges() -> Scene:
    """Draw a disc and a square that glow evenly, in line."""
    y, x = np.mgrid[-1:1:200j, -1:1:200j]
    disc = (np.hypot(y, x) < 0.8).astype(float)
    square = 0.7 * (np.maximum(np.abs(y), np.abs(x)) < 0.7)
    return Scene(
        [Layer(disc, 3.0, (5.0, 5.0), (0.0, -0.8)), Layer(square, -4.0, (5.0, 5.0), (0.4, 0.8))]
    )


SCENES: dict[str, Callable[[], Scene]] = {
    "a disc and a square, small": sharp_edges,
    "four flames behind each other, small": lambda: shrunk(
        overlapping_flames(DEPTHS_MM, cell_mm=0.4), 1 / 4
    ),
}


def solvers(rng: np.random.Generator) -> Iterator[Row]:
    """Fit with a penalty on roughness, on total variation, and by LSMR; time the adjoint."""
    camera = replace(PAPER_CAMERA, lenslets=(72, 84))
    for task, make in SCENES.items():
        scene = make()
        grid = FrustumGrid(camera, scene.depths_mm)
        truth = truth_on(grid, scene)
        clean = render(scene, camera, tolerance=EXACT).views
        for share in (0.02, 0.1):
            noise = np.float32(share * clean.max()) * rng.standard_normal(clean.shape, np.float32)
            light_field = LightField(clean + noise)
            for method, find in METHODS.items():
                begin = time.perf_counter()
                worst = min(max(relative_errors(one, truth)) for one in find(light_field, grid))
                seconds = time.perf_counter() - begin
                yield Row(task, f"{share:.0%}", method, "worst plane's error", worst, None, seconds)
    yield adjoint(rng)


def _by_tikhonov(light_field: LightField, grid: FrustumGrid) -> Iterator[np.ndarray]:
    operator = ProjectionOperator(grid)
    for strength in STRENGTHS:
        yield grid.crop(fit_tikhonov(operator, light_field.views, strength, ITERATIONS))


METHODS: dict[str, Callable[[LightField, FrustumGrid], Iterator[np.ndarray]]] = {
    OURS: lambda light_field, grid: iter([reconstruct(light_field, grid).emission]),
    VARIATION_METHOD: lambda light_field, grid: iter(
        [reconstruct(light_field, grid, penalty=VARIATION).emission]
    ),
    LSMR_METHOD: _by_tikhonov,
}


def adjoint(rng: np.random.Generator, rounds: int = 9) -> Row:
    """Time the operator's adjoint relative to the operator, in turns, at the paper's size."""
    scene, camera = paper_flames()
    grid = FrustumGrid(camera, DEPTHS_MM, BLOCK)
    operator = ProjectionOperator(grid)
    views = average_blocks(Recorder(scene, camera).with_noise(0.01, rng), camera, BLOCK)
    stack = operator.rmatvec(views.ravel())
    pairs = []
    for _ in range(rounds):
        _, back = timed(lambda _a, _b: operator.rmatvec(views.ravel()), None, None)
        _, forth = timed(lambda _a, _b: operator.matvec(stack), None, None)
        pairs.append((back / forth, back))
    ratio, seconds = np.median(pairs, axis=0)
    what = "seconds over the operator's"
    return Row("adjoint, four planes", "1 %", "adjoint", what, float(ratio), 1.5, float(seconds))
