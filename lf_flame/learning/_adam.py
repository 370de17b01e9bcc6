"""Adam's update (Kingma & Ba 2015, section 2, last paragraph) as compiled loops, in place.

There is one pass over memory: each element of parameter, mean and square is read once and written
once. Element-wise array operations would read and write all of them several times. One thread
updates each element, so the bits do not depend on the number of threads.
"""

import numpy as np
from numba import njit

from lf_flame._common.threads import parallel

BLOCK = 1 << 14
"""Number of elements that a thread updates at a time; four arrays of this size fit its cache."""


# Python's error for a division by zero would prevent vectorised loops.
@njit(error_model="numpy")
def update(parameter, mean, square, gradient, rate, weight1, weight2, epsilon):
    """Update one block; `rate` includes the bias corrections, the weights are 1 - beta."""
    for k in range(parameter.size):
        g = gradient[k]
        mean[k] += (g - mean[k]) * weight1
        square[k] += (g * g - square[k]) * weight2
        parameter[k] -= rate * mean[k] / (np.sqrt(square[k]) + epsilon)


@parallel(lambda parameter: -(-parameter.size // BLOCK))
def update_all(block, parameter, mean, square, gradient, rate, weight1, weight2, epsilon):
    """Update a flat parameter from its gradient."""
    size = parameter.size
    part = slice(block * BLOCK, min(size, (block + 1) * BLOCK))
    update(
        parameter[part], mean[part], square[part], gradient[part],
        rate, weight1, weight2, epsilon,
    )  # fmt: skip


@parallel(lambda parameter: len(parameter) * -(-parameter.shape[1] // BLOCK))
def update_product(job, parameter, mean, square, left, right, rate, weight1, weight2, epsilon):
    """Update a matrix with the gradient left.T @ right, without storing that gradient.

    The gradient of a dense layer's kernel is the product of its inputs (samples, rows) and the
    gradient of its outputs (samples, columns). For a batch of two it is as large as the kernel and
    has almost no information.
    """
    rows, columns = parameter.shape
    blocks = (columns + BLOCK - 1) // BLOCK
    row, block = job // blocks, job % blocks
    part = slice(block * BLOCK, min(columns, (block + 1) * BLOCK))
    gradient = np.zeros(part.stop - part.start, np.float32)
    for sample in range(left.shape[0]):
        add(gradient, left[sample, row], right[sample, part])
    update(
        parameter[row, part], mean[row, part], square[row, part], gradient,
        rate, weight1, weight2, epsilon,
    )  # fmt: skip


@njit(error_model="numpy")
def add(total, factor, values):
    for k in range(total.size):
        total[k] += factor * values[k]
