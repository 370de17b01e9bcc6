"""Adam's update (Kingma & Ba 2015, section 2, last paragraph) as compiled loops, in place.

One pass over memory: each element of parameter, mean and square is read once and written once.
Written as element-wise operations the same update reads and writes all of them several times.
Every element is updated by one thread, so the bits do not depend on the number of threads.
"""

import numpy as np
from numba import njit

from lf_flame._common.threads import pieces, shared

BLOCK = 1 << 14
"""Elements that a thread updates at a time; four arrays of them fit its cache."""

SMALL = 1 << 17
"""Elements up to which one thread is done before the others are awake."""


def _update(parameter, mean, square, gradient, rate, weight1, weight2, epsilon):
    """Update one block; rate holds the bias corrections, the weights are 1 - beta."""
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
    """Update a matrix whose gradient is left.T @ right, without writing that gradient down.

    The gradient of a dense layer's kernel is the product of its inputs (samples, rows) and what
    comes back to its outputs (samples, columns); for a batch of two it is as large as the kernel
    and holds next to nothing.
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


# Python's error for a division by zero would keep the loops from being vectorised.
update = njit(error_model="numpy")(_update)
add = njit(error_model="numpy")(_add)
update_large = shared(_update_large, error_model="numpy")
update_product = shared(_update_product, error_model="numpy")


def update_all(parameter, *others):
    """Update a flat parameter from its gradient, see `_update_large`, on as many threads as pay."""
    work = update_large.alone if parameter.size <= SMALL else update_large
    work(parameter, *others)
