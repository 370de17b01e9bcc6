"""How fast a training step is: ratios within one run, against plain Keras, losses compared.

    make benchmarks

All steps are timed in turn, again and again, and the best of each counts, so that what else the
machine does hits all alike. The floor is what Adam must read and write at the bandwidth, and what
the layers must multiply at the rate, that this machine shows in the same run. A ratio is a time
over that of our whole step; a difference is the largest of the first losses, relative.
"""

import math
import os
import sys
from dataclasses import dataclass
from functools import partial

# Of NumPy. Two threads that multiply wait for each other wherever the machine does other things;
# the time of one, over the number of cores, is what a floor needs.
os.environ["OPENBLAS_NUM_THREADS"] = "1"

import keras
import numpy as np

from experiments.benchmarks.report import command_line, finish, ratio
from experiments.timing import Times, in_turn
from lf_flame._common.provenance import cpu_count
from lf_flame._common.threads import parallel
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

COLUMNS = {
    "what": ("what", ""),
    "step": ("step", ""),
    "ms": ("ms", ".4g"),
    "ratio": ("ratio", ".3g"),
    "quartiles": ("quartiles", ""),
    "largest difference": ("largest difference", ""),
    "remarks": ("remarks", ""),
}


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


def run(trainer, batches: np.ndarray) -> list[float]:
    """Take one step for each batch, and list the losses."""
    return [trainer(batch) for batch in batches]


@parallel(lambda values: -(-values.size // BLOCK))
def touch(block, values):
    """Read and write every element once, in place as Adam does."""
    for k in range(block * BLOCK, min((block + 1) * BLOCK, values.size)):
        values[k] += np.float32(1)


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


def floor_calls(case: Case) -> tuple[list, float, int]:
    """Give calls that show bandwidth and rate of products, and how much of both a step takes.

    Adam reads and writes parameters, means and squares, and reads gradients; not that of the dense
    layer's kernel, which is never written down.
    """
    decoder = case.decoder()
    kernel = decoder.get_layer("basis").kernel
    sizes = {x.path: math.prod(x.shape) for x in decoder.trainable_variables}
    state = np.zeros(3 * sum(sizes.values()), np.float32)
    products = matrix_products(decoder, case.batch)
    calls = [partial(touch, state), *(partial(np.matmul, *x) for x in products)]
    bytes_of_adam = 4 * (7 * sum(sizes.values()) - sizes[kernel.path])
    share = bytes_of_adam / (2 * state.nbytes)  # of what the first call reads and writes
    return calls, share, sum(a.size * b.shape[1] for a, b, _ in products)


def measure(case: Case, rounds: int) -> list[dict]:
    """Compare the losses of some first steps, then time all in turn."""
    samples, batches = case.samples(), case.batches()
    trainer = ArrayTrainer(case.decoder(), RATE, case.batch, {"train": samples})
    plain, xla = (PlainKeras(case, samples, jit) for jit in (False, True))
    without = [PlainKeras(case, samples, jit, dropout=0.0).losses(batches) for jit in (True, False)]
    ours = largest_difference(run(trainer.train_in_order, batches), plain.losses(batches))
    calls, share, multiplied = floor_calls(case)
    steps = [trainer.train_in_order, plain.step, xla.step]
    times = in_turn(*(partial(run, step, batches) for step in steps), *calls,
                    rounds=rounds, turn_s=TURN_S)  # fmt: skip
    return [
        {"what": str(case), **row}
        for row in rows_of(times, share, multiplied, (ours, largest_difference(*without)))
    ]


def rows_of(times: Times, share: float, multiplied: int, differences: tuple) -> list[dict]:
    """Rows of a case: the times of a step, ours first, and of the floor."""
    ours, plain, xla = (1e3 * times.best[:3] / STEPS).tolist()
    adam = 1e3 * share * float(times.best[3])
    products = 1e3 * float(times.best[4:].sum()) / cpu_count()
    least, rate = adam + products, multiplied / products / 1e6
    rows = [
        {"step": "ours", "ms": ours, "largest difference": differences[0], "remarks":
         f"takes {ours / plain:.3g} of the time of plain Keras, {ours / least:.3g} of the floor's"},
        {"step": "plain Keras", "ms": plain, **ratio(times, 1, 0), "remarks":
         "train_on_batch, jit_compile=False"},
        {"step": "plain Keras, XLA", "ms": xla, **ratio(times, 2, 0), "largest difference":
         differences[1], "remarks": "jit_compile=True; its dropout draws other numbers, so losses "
         "are compared without dropout"},
        {"step": "floor", "ms": least, "remarks": "bytes and products, one after the other"},
        {"step": "floor: Adam's bytes", "ms": adam, "remarks": "at the bandwidth of this run"},
        {"step": "floor: matrix products", "ms": products, "remarks":
         f"{multiplied / 1e9:.3g} G multiply-adds at {rate:.3g} G/s"},
    ]  # fmt: skip
    blank = {"quartiles": "", "largest difference": ""}
    return [{"step": "", "ms": 0, "ratio": row["ms"] / ours} | blank | row for row in rows]


def main() -> None:
    """Measure, print and write."""
    parser = command_line(__doc__)
    if keras.backend.backend() != "tensorflow":
        parser.error(f"KERAS_BACKEND must be tensorflow, got {keras.backend.backend()}")
    asked, rows = parser.parse_args(), []
    for case in cases(asked.small):
        sys.stderr.write(f"measuring: {case}\n")
        rows += measure(case, 1 if asked.small else ROUNDS)
        keras.backend.clear_session()
    notes = [
        f"The paper's decoder and Adam; mean of {STEPS} steps. Ratio: the time over ours, median "
        f"and quartiles of the rounds. Difference: of the first {STEPS} losses, relative to plain "
        "Keras. Floor: Adam reads and writes parameters, means and squares, and reads the "
        "gradients that are written down, as fast as adding 1 to as many numbers in place (Numba); "
        "NumPy multiplies matrices of the layers' shapes, on one thread, and its time is divided "
        "by the cores."
    ]
    finish(asked.out, "training", "Speed of a training step", {"rows": rows}, COLUMNS, notes)


if __name__ == "__main__":
    main()
