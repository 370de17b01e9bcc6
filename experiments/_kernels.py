"""A compiled loop to measure by: arrays in, output array filled, nothing returned."""

import numpy as np

from lf_flame._common.threads import parallel

LANES = 64
"""Sums side by side: enough that memory, not the latency of an addition, sets the speed."""


@parallel(lambda rows: len(rows))
def sum_rows(k, rows, sums):
    """Sum each of the rows [row, element] in float32: what reading them once costs."""
    lanes = np.zeros(LANES, np.float32)
    row = rows[k]
    whole = row.size // LANES * LANES
    for i in range(0, whole, LANES):
        for j in range(LANES):
            lanes[j] += row[i + j]
    sums[k] = lanes.sum() + row[whole:].sum()
