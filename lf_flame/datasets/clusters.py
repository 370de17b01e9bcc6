"""Other machines, or other processes of this one, that make data sets: Dask's clusters."""

from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager

from lf_flame.errors import InputError

START_S = 30
"""Seconds to wait for a scheduler to answer, and for the first worker behind it."""

RETRIES = 10
"""Times that a task is done again whose worker died under it: Dask's own default takes a task for
the culprit after three."""

ANY_PORT = "127.0.0.1:0"
"""Where a local cluster shows its state: a port of its own, so that two clusters get along."""


@contextmanager
def cluster_executor(scheduler: str | None = None, local: int | None = None) -> Iterator[Executor]:
    """Connect to a cluster, or start one of processes on this machine.

    All its workers must have this package, and see the data set's folder under the same name. A
    worker that dies loses its tasks to others.

    Parameters
    ----------
    scheduler : str, optional
        Address of a running scheduler, as ``tcp://HOST:PORT``.
    local : int, optional
        Number of processes to start instead.

    Raises
    ------
    InputError
        If the scheduler does not answer, or has no workers.
    ModuleNotFoundError
        Without ``distributed``.
    """
    import dask
    from distributed import Client, LocalCluster

    settings = {"distributed.scheduler.allowed-failures": RETRIES}
    with dask.config.set(settings):
        if local is None:
            with _connect(scheduler) as client:
                yield client.get_executor()
            return
        with (
            LocalCluster(local, threads_per_worker=1, dashboard_address=ANY_PORT) as cluster,
            Client(cluster) as client,
        ):
            yield client.get_executor()


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
