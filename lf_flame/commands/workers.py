"""Options for where long work is done: processes on this machine, or a Dask cluster."""

from collections.abc import Iterator
from concurrent.futures import CancelledError, Executor
from contextlib import contextmanager
from dataclasses import dataclass

import cloup

from lf_flame._common import progress
from lf_flame._common.provenance import cpu_count
from lf_flame.commands.options import option
from lf_flame.errors import InputError

START_S = 30
"""Longest time in seconds to wait for a scheduler, and then for its first worker."""

WORKERS = cloup.option_group(
    "Where it is computed",
    option("--workers", "Number of processes; 0: one per core.", int, default=0),
    option("--scheduler", "Dask scheduler to use: tcp://HOST:PORT.", rare=True),
)


@dataclass(frozen=True)
class Crew:
    """Options of the group `WORKERS`, checked."""

    workers: int = 0
    scheduler: str | None = None

    def __post_init__(self):
        if self.workers < 0:
            raise InputError(f"workers must be 0 (one per core) or more, got {self.workers}.")

    @property
    def processes(self) -> int:
        """Number of processes without a cluster."""
        return self.workers or cpu_count()

    @contextmanager
    def executor(self) -> Iterator[Executor | None]:
        """Connect to the cluster; None without one.

        Dask gives the tasks of a worker that dies to other workers.
        """
        if not self.scheduler:
            yield None
            return
        from distributed import Client, KilledWorker

        with progress.stage("Connecting to the cluster"):
            try:
                client = Client(self.scheduler, timeout=START_S)
            except (OSError, ValueError) as error:
                raise InputError(
                    f"The scheduler {self.scheduler} does not answer: {error}."
                ) from None
        with client:
            try:
                client.wait_for_workers(1, timeout=START_S)
            except TimeoutError:
                raise InputError(
                    f"The scheduler {self.scheduler} has no workers: start some with `dask worker "
                    f"{self.scheduler}`."
                ) from None
            try:
                yield client.get_executor()
            except (CancelledError, KilledWorker):
                raise ChildProcessError(
                    "The cluster's scheduler has ended, or a task killed worker after worker; what "
                    "is finished is kept, and the same command resumes from there"
                ) from None
