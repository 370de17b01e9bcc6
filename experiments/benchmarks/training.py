"""How fast a training step is: ratios within one run, against plain Keras, losses compared.

    make benchmarks

All steps are timed in turn, again and again, and the best of each counts, so that what else the
machine does hits all alike. The floor is what Adam must read and write at the bandwidth, and what
the layers must multiply at the rate, that this machine shows in the same run. A ratio is a time
over that of our whole step; a difference is the largest of the first losses, relative.
"""

import argparse
import math
import os
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from unittest.mock import patch

# Of NumPy. Two threads that multiply wait for each other wherever the machine does other things;
# the time of one, over the number of cores, is what a floor needs.
os.environ["OPENBLAS_NUM_THREADS"] = "1"

import keras
import numpy as np
import pandas as pd

from experiments.benchmarks.report import write_table
from experiments.timing import best_times, seconds
from lf_flame._common.provenance import cpu_count, environment
from lf_flame._common.threads import pieces, shared
from lf_flame.learning import _adam
from lf_flame.learning.decoder import build_decoder
from lf_flame.learning.trainers import ArrayTrainer

STEPS = 10
"""Whose losses are compared, and which are timed together."""

ALIKE = 1e-4
"""Largest relative difference of losses that should be the same."""

ROUNDS = 3

BLOCK = 1 << 14
"""Elements that a thread takes at a time."""

TURN_S = 0.1
"""A call that takes less, of the floor, is repeated for so long in its turn."""

RATE = 1e-4
DROPOUT = 0.3
PLANES = 4

COLUMNS = ["what", "step", "ms", "ratio", "largest difference", "remarks"]

GRADIENTS = "ours: forward and backward"
DENSE = "ours: Adam of the dense kernel"
OTHERS = "ours: Adam of the rest"
COPIES = "ours: copying batches"
PYTHON = "ours: Python and what is left"


@dataclass(frozen=True)
class Case:
    """Size of the work: the backbone's feature map [h, w, channels], samples in a batch, image."""

    depth: str
    features: tuple[int, int, int]
    batch: int
    image: tuple[int, int] = (90, 180)

    def __str__(self):
        return f"{self.depth}, {'x'.join(map(str, self.features))}, batch {self.batch}"

    def decoder(self, dropout: float = DROPOUT) -> keras.Model:
        """Build the decoder, each time with the same weights."""
        return build_decoder(self.features, self.image, PLANES, dropout)

    def samples(self) -> tuple[np.ndarray, np.ndarray]:
        """Features, half of them zero as behind a ReLU, and targets for an epoch of STEPS."""
        rng, count = np.random.default_rng(0), STEPS * self.batch
        features = rng.standard_normal((count, *self.features), np.float32)
        targets = rng.random((count, PLANES, *self.image, 1), np.float32)
        return np.maximum(features, 0), targets

    def batches(self) -> np.ndarray:
        """Give the indices of the samples, a batch in each row."""
        return np.arange(STEPS * self.batch).reshape(STEPS, -1)


def cases(small: bool) -> list[Case]:
    """Everything that is measured, or the same with few channels and pixels."""
    if small:
        return [Case("conv5", (3, 6, 32), 2, (9, 18))]
    maps = {"conv5": (3, 6, 2048), "conv4": (6, 12, 1024)}
    return [Case(depth, shape, batch) for depth, shape in maps.items() for batch in (2, 16)]


class PlainKeras:
    """Keras as one would call it."""

    def __init__(self, case: Case, samples: tuple, xla: bool, dropout: float = DROPOUT):
        self._samples, self._model = samples, case.decoder(dropout)
        self._model.compile(keras.optimizers.Adam(RATE), "mse", jit_compile=xla)

    def step(self, batch: np.ndarray) -> float:
        """Train on a batch."""
        features, targets = self._samples
        return float(self._model.train_on_batch(features[batch], targets[batch]))

    def losses(self, batches: np.ndarray) -> list[float]:
        """Train on the batches; the loss of each, not the running mean that Keras returns."""
        found = []
        for batch in batches:
            self._model.reset_metrics()
            found.append(self.step(batch))
        return found


def largest_difference(losses: list[float], theirs: list[float]) -> str:
    """Largest relative difference, which ends the program where it is more than rounding."""
    found = float(np.max(np.abs(np.divide(losses, theirs) - 1)))
    if not found <= ALIKE:
        sys.exit(f"Losses must be those of plain Keras to {ALIKE:g}, but differ by {found:.1e}.")
    return f"{found:.1e}"


class Timed:
    """An array whose indexing goes through a function that times it."""

    def __init__(self, take: Callable):
        self._take = take

    def __getitem__(self, indices):
        return self._take(indices)


def profile(trainer: ArrayTrainer, batches: np.ndarray) -> dict[str, float]:
    """Train on the batches with a stopwatch around what the trainer calls; seconds of a step."""
    spent = dict.fromkeys((GRADIENTS, DENSE, OTHERS, COPIES), 0.0)

    def timed(part: str, call: Callable) -> Callable:
        def wrapped(*args):
            started = time.perf_counter()
            result = call(*args)
            spent[part] += time.perf_counter() - started
            return result

        return wrapped

    samples = [Timed(timed(COPIES, array.__getitem__)) for array in trainer.arrays["train"]]
    gradients = trainer.gradients
    with (
        patch.dict(trainer.arrays, train=samples),
        patch.object(gradients, "run_batch", timed(GRADIENTS, gradients.run_batch)),
        patch.object(_adam, "update_product", timed(DENSE, _adam.update_product)),
        patch.object(_adam, "update_all", timed(OTHERS, _adam.update_all)),
    ):
        whole = seconds(partial(run, trainer.train_in_order, batches))
    spent[PYTHON] = whole - sum(spent.values())
    return {part: time / len(batches) for part, time in spent.items()}


def run(step: Callable, batches: np.ndarray) -> None:
    """Take one step for each batch."""
    for batch in batches:
        step(batch)


@shared
def touch(queue, values):
    """Read and write every element once, in place as Adam does."""
    for block in pieces(queue, -(-values.size // BLOCK)):
        for k in range(block * BLOCK, min((block + 1) * BLOCK, values.size)):
            values[k] += np.float32(1)


class Floor:
    """What a step takes at least: Adam's bytes and the layers' products; `calls` are to be timed.

    Adam reads and writes parameters, means and squares, and reads gradients; not that of the dense
    layer's kernel, which is never written down.
    """

    def __init__(self, case: Case):
        decoder = case.decoder()
        kernel = decoder.get_layer("basis").kernel
        sizes = {x.path: math.prod(x.shape) for x in decoder.trainable_variables}
        self._bytes = 4 * (7 * sum(sizes.values()) - sizes[kernel.path])
        self._state = np.zeros(3 * sum(sizes.values()), np.float32)
        products = matrix_products(decoder, case.batch)
        self._multiply_adds = sum(a.size * b.shape[1] for a, b, _ in products)
        self.calls = [partial(touch, self._state), *(partial(np.matmul, *x) for x in products)]

    def rows(self, touch_s: float, *products_s: float) -> list[tuple]:
        """Rows of the table, from the times of `calls`."""
        rate = 2 * self._state.nbytes / touch_s
        adam, products = self._bytes / rate, sum(products_s) / cpu_count()
        multiplied = self._multiply_adds / 1e9
        return [
            ("floor", adam + products, "", "bytes and products, one after the other"),
            ("floor: Adam's bytes", adam, "",
             f"{self._bytes / 1e6:.4g} MB at {rate / 1e9:.3g} GB/s"),
            ("floor: matrix products", products, "",
             f"{multiplied:.3g} G multiply-adds at {multiplied / products:.3g} G/s"),
        ]  # fmt: skip


def matrix_products(decoder: keras.Model, batch: int) -> list[tuple]:
    """Operands and place of the products in a step: forward, to the inputs and to the kernels.

    Left out are the gradient of the dense layer's kernel, whose arithmetic can hide behind Adam's
    memory, and the last convolution, a thousandth of all.
    """
    rng, found = np.random.default_rng(0), []
    layers = [x for x in decoder.layers if hasattr(x, "kernel") and x.name != "planes"]
    for layer in layers:
        *inner, outputs = layer.kernel.shape
        rows = batch * math.prod(layer.output.shape[1:-1])
        shapes = ((rows, math.prod(inner)), (math.prod(inner), outputs), (rows, outputs))
        inputs, kernel, back = (rng.random(shape, np.float32) for shape in shapes)
        found.append((inputs, kernel))
        if layer is not layers[0]:
            found.append((back, kernel.T))
        if layer.name != "basis":
            found.append((inputs.T, back))
    return [(a, b, np.empty((a.shape[0], b.shape[1]), np.float32)) for a, b in found]


def measure(case: Case, rounds: int) -> list[tuple]:
    """Compare the losses of some first steps, then time all in turn."""
    samples, batches = case.samples(), case.batches()
    trainer = ArrayTrainer(case.decoder(), RATE, case.batch, {"train": samples})
    plain, xla = (PlainKeras(case, samples, jit) for jit in (False, True))
    without = [PlainKeras(case, samples, jit, dropout=0.0).losses(batches) for jit in (True, False)]
    ours = largest_difference([trainer.train_in_order(k) for k in batches], plain.losses(batches))
    floor, profiles = Floor(case), []

    def our_clock() -> float:
        profiles.append(profile(trainer, batches))
        return sum(profiles[-1].values())

    def clock(baseline: PlainKeras) -> float:
        return seconds(partial(run, baseline.step, batches)) / len(batches)

    clocks = [our_clock, partial(clock, plain), partial(clock, xla)]
    clocks += [partial(seconds, call) for call in floor.calls]
    _, plain_s, xla_s, *floor_s = best_times(rounds, TURN_S, clocks)
    parts = min(profiles, key=lambda parts: sum(parts.values()))
    differences = ours, largest_difference(*without)
    rows = rows_of(parts, (plain_s, xla_s), floor.rows(*floor_s), differences)
    return [(str(case), *row) for row in rows]


def rows_of(parts: dict, keras_s: tuple, floor_rows: list, differences: tuple) -> list[tuple]:
    """Rows of the table for one case."""
    ours, (plain, xla), least = sum(parts.values()), keras_s, floor_rows[0][1]
    rows = [
        ("ours", ours, differences[0],
         f"takes {ours / plain:.3g} of the time of plain Keras, {ours / least:.3g} of the floor's"),
        ("plain Keras", plain, "", "train_on_batch, jit_compile=False"),
        ("plain Keras, XLA", xla, differences[1], "jit_compile=True; its dropout draws other "
         "numbers, so losses are compared without dropout"),
        *floor_rows,
        *((part, time, "", "") for part, time in parts.items()),
    ]  # fmt: skip
    return [(step, 1e3 * time, time / ours, *rest) for step, time, *rest in rows]


def arguments() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("experiments/results/benchmarks"))
    parser.add_argument("--small", action="store_true", help="small decoders, to try the program")
    if keras.backend.backend() != "tensorflow":
        parser.error(f"KERAS_BACKEND must be tensorflow, got {keras.backend.backend()}")
    return parser.parse_args()


def main() -> None:
    """Measure, print and write."""
    asked, rows = arguments(), []
    for case in cases(asked.small):
        sys.stderr.write(f"measuring: {case}\n")
        rows += measure(case, 1 if asked.small else ROUNDS)
        keras.backend.clear_session()
    write_table(
        asked.out / "training",
        "Speed of a training step",
        pd.DataFrame(rows, columns=COLUMNS),
        ("", "", ".4g", ".3g", "", ""),
        environment(),
        notes=f"The paper's decoder and Adam; mean of {STEPS} steps. Ratio: the time over ours. "
        f"Difference: of the first {STEPS} losses, relative to plain Keras. Floor: Adam reads and "
        "writes parameters, means and squares, and reads the gradients that are written down, as "
        "fast as adding 1 to as many numbers in place (Numba); NumPy multiplies matrices of the "
        "layers' shapes, on one thread, and its time is divided by the cores.\n\n",
    )


if __name__ == "__main__":
    main()
