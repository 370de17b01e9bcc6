"""Compiled loop of the slope search: arrays in, output array filled, nothing returned.

It is a matrix product. BLAS would sum in another order on another number of threads; this loop sums
in one order, in float64, so that the bits stay the same.
"""

import numpy as np

from lf_flame._common.threads import parallel

BLOCK = 512
"""Number of columns that are processed together."""


@parallel(lambda out: -(-out.shape[1] // BLOCK))
def add_product(block, left, right, out):
    """Add the matrix product left[i, k] @ right[k, x] to out[i, x]."""
    rows, columns = out.shape
    start = block * BLOCK
    size = min(BLOCK, columns - start)
    total = np.zeros((rows, size))
    for k in range(left.shape[1]):
        line = right[k, start : start + size]
        for i in range(rows):
            weight = left[i, k]
            for x in range(np.uint64(size)):
                total[i, x] += weight * line[x]
    for i in range(rows):
        for x in range(np.uint64(size)):
            out[i, np.uint64(start) + x] += total[i, x]
