"""A compiled loop to measure by: arrays in, output array filled, nothing returned."""

import numpy as np
from numba import njit, prange

LANES = 64
"""Sums side by side: enough that memory, not the latency of an addition, sets the speed."""


@njit(parallel=True, cache=True)
def sum_rows(rows, sums):
    """Sum each of the rows [row, element] in float32: what reading them once costs."""
    for k in prange(rows.shape[0]):
        lanes = np.zeros(LANES, np.float32)
        row = rows[k]
        whole = row.size // LANES * LANES
        for i in range(0, whole, LANES):
            for j in range(LANES):
                lanes[j] += row[i + j]
        sums[k] = lanes.sum() + row[whole:].sum()
