"""Adam's update (Kingma & Ba 2015, section 2, last paragraph) as compiled loops, in place.

There is one pass over memory: each element of parameter, mean and square is read once and written
once. Element-wise array operations would read and write all of them several times. One thread
updates each element, so the bits do not depend on the number of threads.
"""

import numpy as np
from numba import njit

from lf_flame._common.threads import pieces, shared

BLOCK = 1 << 14
"""Number of elements that a thread updates at a time; four arrays of this size fit its cache."""

SMALL = 1 << 17
"""Largest number of elements for one thread alone, which finishes before others have started."""


def _update(parameter, mean, square, gradient, rate, weight1, weight2, epsilon):
    """Update one block; `rate` includes the bias corrections, the weights are 1 - beta."""
    for k in range(parameter.size):
        g = gradient[k]
        mean[k] += (g - mean[k]) * weight1
        square[k] += (g * g - square[k]) * weight2
        parameter[k] -= rate * mean[k] / (np.sqrt(square[k]) + epsilon)


def _update_large(queue, parameter, mean, square, gradient, rate, weight1, weight2, epsilon):
    """Update a flat parameter from its gradient."""
    size = parameter.size
    for block in pieces(queue, (size + BLOCK - 1) // BLOCK):
        part = slice(block * BLOCK, min(size, (block + 1) * BLOCK))
        update(
            parameter[part], mean[part], square[part], gradient[part],
            rate, weight1, weight2, epsilon,
        )  # fmt: skip


def _update_product(queue, parameter, mean, square, left, right, rate, weight1, weight2, epsilon):
    """Update a matrix with the gradient left.T @ right, without storing that gradient.

    The gradient of a dense layer's kernel is the product of its inputs (samples, rows) and the
    gradient of its outputs (samples, columns). For a batch of two it is as large as the kernel and
    has almost no information.
    """
    rows, columns = parameter.shape
    blocks = (columns + BLOCK - 1) // BLOCK
    for job in pieces(queue, rows * blocks):
        row, block = job // blocks, job % blocks
        part = slice(block * BLOCK, min(columns, (block + 1) * BLOCK))
        gradient = np.zeros(part.stop - part.start, np.float32)
        for sample in range(left.shape[0]):
            add(gradient, left[sample, row], right[sample, part])
        update(
            parameter[row, part], mean[row, part], square[row, part], gradient,
            rate, weight1, weight2, epsilon,
        )  # fmt: skip


def _add(total, factor, values):
    for k in range(total.size):
        total[k] += factor * values[k]


# Python's error for a division by zero would prevent vectorised loops.
update = njit(error_model="numpy")(_update)
add = njit(error_model="numpy")(_add)
update_large = shared(_update_large, error_model="numpy")
update_product = shared(_update_product, error_model="numpy")


def update_all(parameter, *others):
    """Update a flat parameter from its gradient, see `_update_large`; small ones on one thread."""
    work = update_large.alone if parameter.size <= SMALL else update_large
    work(parameter, *others)
