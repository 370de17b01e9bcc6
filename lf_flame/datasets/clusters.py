"""Dask clusters for making data sets on other machines, or in other processes on this one."""

import logging
from collections.abc import Iterator
from concurrent.futures import CancelledError, Executor
from contextlib import contextmanager

from lf_flame.errors import InputError

START_S = 30
"""Longest time in seconds to wait for a scheduler, and for the first worker after it."""

RETRIES = 10
"""Number of times that a task is repeated after its worker died; with Dask's default, a task is
taken for the cause after three."""

LOCAL = {
    "threads_per_worker": 1,
    "dashboard_address": "127.0.0.1:0",
    "silence_logs": logging.CRITICAL,
}
"""Options of a cluster on this machine. Its dashboard has a free port, so that two do not collide.
Exceptions of tasks come back to the caller; logs beside them are tracebacks of lost heartbeats."""


@contextmanager
def cluster_executor(scheduler: str | None = None, local: int | None = None) -> Iterator[Executor]:
    """Connect to a cluster, or start one of processes on this machine.

    All workers must have this package, and see the data set's folder under the same name. The tasks
    of a worker that dies go to other workers.

    Parameters
    ----------
    scheduler : str, optional
        Address of a running scheduler, such as ``tcp://HOST:PORT``.
    local : int, optional
        Number of processes to start instead.

    Raises
    ------
    InputError
        If the scheduler does not answer, or has no workers.
    ChildProcessError
        If the scheduler ends, or a task kills worker after worker.
    ModuleNotFoundError
        Without ``distributed``.
    """
    import dask
    from distributed import Client, KilledWorker, LocalCluster

    settings = {"distributed.scheduler.allowed-failures": RETRIES}
    try:
        with dask.config.set(settings):
            if local is None:
                with _connect(scheduler) as client:
                    yield client.get_executor()
                return
            with LocalCluster(local, **LOCAL) as cluster, Client(cluster) as client:
                yield client.get_executor()
    except (CancelledError, KilledWorker):
        raise ChildProcessError(
            "The cluster's scheduler has ended, or its workers were killed again and again; what "
            "is finished is kept, and the same command goes on from there"
        ) from None


@contextmanager
def _connect(scheduler: str | None) -> Iterator:
    from distributed import Client

    try:
        client = Client(scheduler, timeout=START_S)
    except (OSError, ValueError) as error:
        raise InputError(f"The scheduler {scheduler} does not answer: {error}.") from None
    with client:
        try:
            client.wait_for_workers(1, timeout=START_S)
        except TimeoutError:
            raise InputError(
                f"The scheduler {scheduler} has no workers: start some with `dask worker "
                f"{scheduler}`."
            ) from None
        yield client
