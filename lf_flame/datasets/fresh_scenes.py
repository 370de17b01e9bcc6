"""Fresh scenes like those of a data set, but not in it: drawn and simulated, block by block.

A sample is determined by the data set's seed and its own index. The data set's indices start at 0;
fresh ones continue where it ends, so that none of them is in any part of its split.
"""

from collections import deque
from collections.abc import Iterator
from itertools import islice

import numpy as np

from lf_flame._common.provenance import cpu_count
from lf_flame._common.threads import one_thread
from lf_flame._common.workers import worker_pool
from lf_flame.datasets.config import DatasetConfig
from lf_flame.datasets.sampling import simulate_sample
from lf_flame.datasets.store import Dataset

TOGETHER = 128
"""Number of samples in a block."""

AHEAD = 2
"""Largest number of blocks that a worker may be ahead, to bound memory if they are not needed."""

Images = tuple[np.ndarray, np.ndarray]


def fresh_samples(dataset: Dataset, count: int, workers: int = 0) -> Iterator[Images]:
    """Simulate the samples that would follow those of a data set.

    Parameters
    ----------
    dataset : Dataset
        Data set whose configuration is used.
    count : int
        Number of samples.
    workers : int, optional
        Number of processes; 0 takes one for each core, 1 works in this one. The bits are the same.

    Yields
    ------
    inputs : ndarray of float32, shape (n, height, width, channels)
    targets : ndarray of float32, shape (n, objects, h, w)
        Both as in the data set, with its slopes, for the next `TOGETHER` samples, or those that
        remain, in the order of their indices.
    """
    first, slopes = len(dataset), list(dataset.attrs["slopes"])
    indices = range(first, first + count)
    blocks = [indices[k : k + TOGETHER] for k in range(0, count, TOGETHER)]
    asked = ((dataset.config, slopes, block, dataset.attrs.get("rays")) for block in blocks)
    workers = min(workers or cpu_count(), len(blocks))
    if workers <= 1:
        yield from (_simulate(*ask) for ask in asked)
        return
    with worker_pool(workers) as pool:
        jobs = deque(pool.submit(_simulate, *ask) for ask in islice(asked, AHEAD * workers))
        while jobs:
            made = jobs.popleft().result()
            jobs.extend(pool.submit(_simulate, *ask) for ask in islice(asked, 1))
            yield made


def _simulate(
    config: DatasetConfig, slopes: list[float], indices: range, rays: int | None
) -> Images:
    with one_thread():
        made = [simulate_sample(config, slopes, index, rays) for index in indices]
    return np.stack([x["input"] for x in made]), np.stack([x["target"] for x in made])
