"""Options for where long work is done: processes on this machine, or a Dask cluster."""

from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

import click
import cloup

from lf_flame._common import progress
from lf_flame._common.provenance import cpu_count
from lf_flame.errors import InputError

WORKERS = cloup.option_group(
    "Where it is computed",
    cloup.option(
        "--workers", default=0, show_default=True, help="Number of processes; 0: one per core."
    ),
    cloup.option("--scheduler", help="Dask scheduler of the workers to use: tcp://HOST:PORT."),
    cloup.option(
        "--local-cluster",
        type=click.IntRange(1, 1024),
        metavar="N",
        help="Start a Dask cluster of N processes here.",
    ),
)


@dataclass(frozen=True)
class Crew:
    """Options of the group `WORKERS`, checked."""

    workers: int = 0
    scheduler: str | None = None
    local_cluster: int | None = None

    def __post_init__(self):
        if self.workers < 0:
            raise InputError(f"workers must be 0 (one per core) or more, got {self.workers}.")
        if self.scheduler and self.local_cluster:
            raise InputError("--scheduler and --local-cluster exclude each other.")

    @property
    def processes(self) -> int:
        """Number of processes without a cluster."""
        return self.workers or cpu_count()

    @contextmanager
    def executor(self) -> Iterator[Executor | None]:
        """Connect to the cluster; None without one."""
        if not (self.scheduler or self.local_cluster):
            yield None
            return
        from lf_flame.datasets.clusters import cluster_executor

        with ExitStack() as open_until_the_end:
            with progress.stage("Connecting to the cluster"):
                cluster = cluster_executor(self.scheduler, self.local_cluster)
                executor = open_until_the_end.enter_context(cluster)
            yield executor
