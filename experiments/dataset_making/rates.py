"""Rates at which data sets are made, by one process, a pool and a cluster; and by three routes."""

import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import nullcontext
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

import numpy as np

from experiments.command_parts import step_bar
from lf_flame.datasets.clusters import cluster_executor
from lf_flame.datasets.config import DatasetConfig
from lf_flame.datasets.making import make_dataset, shard_size
from lf_flame.datasets.store import Dataset
from lf_flame.errors import InputError

CLUSTER = "Dask cluster"

SHARDS_EACH = 3
"""Shards for each process, at least."""

ROUTES = ("exact", "rays", "direct")
"""In closed form through a light field, which the others are held against; by traced rays through a
light field; straight from the scene."""


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
    config: DatasetConfig, samples: int, processes: int, rounds: int
) -> Iterator[dict]:
    """Make a data set each way, in turn, in each round; pool and cluster have so many processes.

    An InputError says that the samples are too few for every process to write some shards.
    """
    least = SHARDS_EACH * processes * shard_size(samples)
    if samples < least:
        raise InputError(
            f"{processes} processes need at least {least} samples, got {samples}: {SHARDS_EACH} "
            f"shards for each."
        )
    ways = [("one process", 1), ("process pool", processes), (CLUSTER, processes)]
    for way, count in step_bar(rounds * ways):
        yield _measure(config, samples, way, count)


def _measure(config: DatasetConfig, samples: int, way: str, processes: int) -> dict:
    """Make a data set: whole seconds, with what it takes to start processes and to search slopes.

    The rate is that from when as many shards were written as there are processes, to the end.
    """
    clock, started = _Clock(), time.perf_counter()
    with TemporaryDirectory() as folder:
        path = Path(folder) / "measured.zarr"
        cluster = cluster_executor(local=processes) if way == CLUSTER else nullcontext()
        with cluster as executor:
            make_dataset(config, samples, path, processes, clock, executor=executor)
        seconds = time.perf_counter() - started
        files = [file for file in path.rglob("*") if file.is_file()]
        return {
            "data": config.kind,
            "way": way,
            "processes": processes,
            "samples": samples,
            "seconds": seconds,
            "per_second": clock.per_second(processes * shard_size(samples)),
            "sha256": sha256(Dataset(path).targets.tobytes()).hexdigest(),
            "files": len(files),
            "size": sum(file.stat().st_size for file in files),
        }


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


def compare_routes(config: DatasetConfig, samples: int, processes: int) -> Iterator[dict]:
    """Make a data set by each of `ROUTES`: whole seconds, and PSNR against the exact route.

    Seconds include the search for the slopes and, by rays, for their number.
    """
    with TemporaryDirectory() as folder:
        exact = None
        for name in step_bar(ROUTES):
            path, started = Path(folder) / f"{name}.zarr", time.perf_counter()
            make_dataset(replace(config, route=name), samples, path, processes)
            seconds, made = time.perf_counter() - started, Dataset(path)
            exact = made if exact is None else exact
            yield {
                "data": config.kind,
                "route": name,
                "samples": samples,
                "processes": processes,
                "rays": made.attrs.get("rays"),
                "seconds": seconds,
                "input_psnr_db": _psnr(made.inputs[:], exact.inputs[:]),
                "target_psnr_db": _psnr(made.targets[:], exact.targets[:]),
            }


def _psnr(images: np.ndarray, exact: np.ndarray) -> float:
    error = np.square(images - exact, dtype=np.float64).mean()
    return float(-10 * np.log10(error)) if error > 0 else np.inf
