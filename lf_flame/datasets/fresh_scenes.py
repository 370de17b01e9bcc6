"""Scenes like those of a data set that it does not hold: drawn, simulated, and kept in memory.

A sample follows from the data set's seed and its own index. Those of the data set count from 0; the
fresh ones go on where it ends, so that none of them is in any part of its split.
"""

from collections.abc import Callable, Iterable
from concurrent.futures import as_completed

import numpy as np

from lf_flame._common.memory import check_memory
from lf_flame._common.provenance import cpu_count
from lf_flame._common.threads import one_thread
from lf_flame._common.workers import worker_pool
from lf_flame.datasets.config import DatasetConfig
from lf_flame.datasets.making import THROUGH_LIGHT_FIELD
from lf_flame.datasets.sampling import simulate_sample
from lf_flame.datasets.store import Dataset

TOGETHER = 32
"""Samples of one task."""

Images = tuple[np.ndarray, np.ndarray]


def fresh_samples(
    dataset: Dataset,
    count: int,
    workers: int = 0,
    progress: Callable[[Iterable, int], Iterable] | None = None,
) -> Images:
    """Simulate the samples that would come after those of a data set.

    Parameters
    ----------
    dataset : Dataset
    count : int
    workers : int, optional
        Processes; 0 takes one for each core, 1 works in this one. The bits are the same.
    progress : callable, optional
        ``progress(finished, total)`` wraps the iterable of finished tasks; total: their number.

    Returns
    -------
    inputs : ndarray of float32, shape (count, height, width, channels)
    targets : ndarray of float32, shape (count, objects, h, w)
        Both as in the data set, whose slopes are taken.

    Raises
    ------
    InputError
        If they would take too much memory.
    """
    config, objects = dataset.config, len(dataset.attrs["slopes"])
    shapes = config.input.shape(config.image), (objects, *config.image)
    needed = count * sum(4 * int(np.prod(shape)) for shape in shapes)
    check_memory(needed, f"{count} scenes besides those of {dataset.path}")
    inputs, targets = (np.empty((count, *shape), np.float32) for shape in shapes)
    begins = range(0, count, TOGETHER)
    tasks = [range(first, min(first + TOGETHER, count)) for first in begins]
    finished = _carry_out(dataset, tasks, workers or cpu_count())
    for some, images in finished if progress is None else progress(finished, len(tasks)):
        inputs[some.start : some.stop], targets[some.start : some.stop] = images
    return inputs, targets


def _carry_out(dataset: Dataset, tasks: list[range], workers: int) -> Iterable[tuple]:
    """Give each task with its images, in whatever order they are finished."""
    first, slopes = len(dataset), list(dataset.attrs["slopes"])
    # Older data sets were always made so.
    long_way = dataset.attrs.get(THROUGH_LIGHT_FIELD, True)
    asked = [
        (dataset.config, slopes, range(first + some.start, first + some.stop), long_way)
        for some in tasks
    ]
    if min(workers, len(tasks)) == 1:
        yield from ((some, _simulate(*ask)) for some, ask in zip(tasks, asked, strict=True))
        return
    with worker_pool(workers) as pool:
        jobs = {pool.submit(_simulate, *ask): some for some, ask in zip(tasks, asked, strict=True)}
        yield from ((jobs[job], job.result()) for job in as_completed(jobs))


def _simulate(config: DatasetConfig, slopes: list[float], indices: range, long_way: bool) -> Images:
    with one_thread():
        made = [simulate_sample(config, slopes, index, long_way) for index in indices]
    return np.stack([x["input"] for x in made]), np.stack([x["target"] for x in made])
