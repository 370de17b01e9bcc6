"""Rates at which data sets are made: in this process, by its pool, by a cluster on this machine."""

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

from lf_flame.datasets.clusters import cluster_executor
from lf_flame.datasets.config import DatasetConfig
from lf_flame.datasets.making import make_dataset, shard_size
from lf_flame.datasets.store import Dataset
from lf_flame.errors import InputError

CLUSTER = "Dask cluster"

SHARDS_EACH = 3
"""Shards for each process, at least."""


@dataclass(frozen=True)
class Rate:
    """A data set that was made.

    Attributes
    ----------
    data : str
        Kind of data set.
    way : str
    processes : int
    samples : int
    seconds : float
        Whole, with what it takes to start processes and to search the slopes.
    per_second : float
        Samples, from when as many shards were written as there are processes, to the end.
    sha256 : str
        Of the images.
    files, size : int
        Of the data set, and their bytes.
    """

    data: str
    way: str
    processes: int
    samples: int
    seconds: float
    per_second: float
    sha256: str
    files: int
    size: int


class _Clock:
    """Notes when samples are finished; a progress bar for `make_dataset`."""

    def __init__(self):
        self.times: list[float] = []

    def __call__(self, finished: Iterable, _done: int, _total: int) -> Iterator:
        for sample in finished:
            self.times.append(time.perf_counter())
            yield sample

    def per_second(self, first: int) -> float:
        """Rate after so many samples."""
        spent = self.times[-1] - self.times[first - 1]
        return (len(self.times) - first) / spent


def measure_rates(
    config: DatasetConfig,
    samples: int,
    processes: int,
    rounds: int,
    progress: Callable[[Iterable, int, int], Iterable],
) -> list[Rate]:
    """Make a data set each way, in turn, a few times.

    Parameters
    ----------
    config : DatasetConfig
    samples : int
        So many that every process writes several shards.
    processes : int
        Of pool and cluster.
    rounds : int
    progress : callable
        Passes on an iterable of steps, given how many are done and how many there are.

    Returns
    -------
    list of Rate
        One for each way and round.

    Raises
    ------
    InputError
        If the samples are too few for every process to write some shards.
    """
    least = SHARDS_EACH * processes * shard_size(samples)
    if samples < least:
        raise InputError(
            f"{processes} processes need at least {least} samples, got {samples}: {SHARDS_EACH} "
            f"shards for each."
        )
    ways = [("one process", 1), ("process pool", processes), (CLUSTER, processes)]
    steps = (_measure(config, samples, way, count) for _ in range(rounds) for way, count in ways)
    return list(progress(steps, 0, rounds * len(ways)))


@contextmanager
def _cluster(processes: int) -> Iterator:
    with cluster_executor(local=processes) as executor:
        yield executor


def _measure(config: DatasetConfig, samples: int, way: str, processes: int) -> Rate:
    clock, started = _Clock(), time.perf_counter()
    with TemporaryDirectory() as folder:
        path = Path(folder) / "measured.zarr"
        with _cluster(processes) if way == CLUSTER else nullcontext() as executor:
            make_dataset(config, samples, path, processes, clock, executor=executor)
        seconds = time.perf_counter() - started
        files = [file for file in path.rglob("*") if file.is_file()]
        return Rate(
            data=config.kind,
            way=way,
            processes=processes,
            samples=samples,
            seconds=seconds,
            per_second=clock.per_second(processes * shard_size(samples)),
            sha256=Dataset(path).attrs["sha256"],
            files=len(files),
            size=sum(file.stat().st_size for file in files),
        )


def summarise(rates: Sequence[dict]) -> list[dict]:
    """Median of the rounds for each data set and way, and rates beside the process pool's."""
    rows = []
    for data, way in dict.fromkeys((rate["data"], rate["way"]) for rate in rates):
        some = [rate for rate in rates if (rate["data"], rate["way"]) == (data, way)]
        row = dict(some[0])
        for name in ("seconds", "per_second"):
            row[name] = median(rate[name] for rate in some)
        row["lowest"] = min(rate["per_second"] for rate in some)
        row["highest"] = max(rate["per_second"] for rate in some)
        row["rate"] = f"{row['per_second']:.0f} ({row['lowest']:.0f} to {row['highest']:.0f})"
        rows.append(row)
    pools = {row["data"]: row["per_second"] for row in rows if row["way"] == "process pool"}
    return [{**row, "of_pool": row["per_second"] / pools[row["data"]]} for row in rows]
