"""Workers of a cluster that are killed while they make a data set, and what becomes of it."""

import hashlib
import os
import signal
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Thread

import numpy as np

from lf_flame.datasets.clusters import cluster_executor
from lf_flame.datasets.config import DatasetConfig
from lf_flame.datasets.making import make_dataset
from lf_flame.datasets.store import METADATA, Dataset


@dataclass(frozen=True)
class Kill:
    """A worker that was killed.

    Attributes
    ----------
    after_s : float
        Since the data set was begun.
    worker : int
    at_sample : int
        Samples that were finished by then.
    hit : bool
        Whether the worker was there still, and the data set not finished.
    same : bool
        Whether all files of samples hold the bytes of a data set that no one disturbed.
    seconds : float
        To make the data set.
    """

    after_s: float
    worker: int
    at_sample: int
    hit: bool
    same: bool
    seconds: float


def measure_kills(
    config: DatasetConfig,
    samples: int,
    processes: int,
    kills: int,
    seed: int,
    progress: Callable[[Iterable, int, int], Iterable],
) -> list[Kill]:
    """Make a data set again and again, and kill a worker at a random instant of each time.

    Parameters
    ----------
    config : DatasetConfig
    samples, processes : int
    kills : int
    seed : int
        Of instants and workers.
    progress : callable
        Passes on an iterable of steps, given how many are done and how many there are.

    Returns
    -------
    list of Kill
    """
    rng = np.random.default_rng(seed)
    with TemporaryDirectory() as folder:
        _, expected, usual_s = _make(config, samples, processes, Path(folder) / "undisturbed.zarr")
    draws = [(float(rng.uniform(0, usual_s)), int(rng.integers(processes))) for _ in range(kills)]
    steps = (_kill_one(config, samples, processes, *draw, expected) for draw in draws)
    return list(progress(steps, 0, kills))


def _kill_one(
    config: DatasetConfig, samples: int, processes: int, after_s: float, worker: int, expected
) -> Kill:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "disturbed.zarr"
        found, hashes, seconds = _make(config, samples, processes, path, (after_s, worker))
    at_sample, hit = found
    return Kill(after_s, worker, at_sample, hit, hashes == expected, seconds)


def _make(
    config: DatasetConfig,
    samples: int,
    processes: int,
    path: Path,
    kill: tuple[float, int] | None = None,
) -> tuple[tuple[int, bool], dict[str, str], float]:
    """Make a data set on a cluster, kill a worker meanwhile, and hash what came of it."""
    done, found = 0, (0, False)

    def count(finished: Iterable, _done: int, _total: int):
        nonlocal done
        for sample in finished:
            done += 1
            yield sample

    with cluster_executor(local=processes) as executor:
        workers = list(executor._client.cluster.workers.values())

        def strike(after_s: float, worker: int) -> None:
            nonlocal found
            time.sleep(after_s)
            victim = workers[worker].pid
            if victim is not None:
                with suppress(ProcessLookupError):
                    os.kill(victim, signal.SIGKILL)
            found = done, victim is not None and done < samples

        thread = Thread(target=strike, args=kill) if kill else None
        started = time.perf_counter()
        if thread:
            thread.start()
        make_dataset(config, samples, path, progress=count, executor=executor)
        seconds = time.perf_counter() - started
        if thread:
            thread.join()
    Dataset(path).verify()
    return found, hash_files(path), seconds


def hash_files(path: Path) -> dict[str, str]:
    """SHA-256 of every file of samples, by its place in the data set."""
    return {
        str(file.relative_to(path)): hashlib.sha256(file.read_bytes()).hexdigest()
        for file in path.rglob("*")
        if file.is_file() and file.name != METADATA
    }
