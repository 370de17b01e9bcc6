"""Worker processes that end with the process that started them."""

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing.connection import wait
from threading import Thread


@contextmanager
def worker_pool(
    workers: int, setup: Callable[..., None] | None = None, *arguments
) -> Iterator[ProcessPoolExecutor]:
    """Start worker processes; they ignore Ctrl-C and end when this process ends for any reason.

    Parameters
    ----------
    workers : int
        Number of processes.
    setup : callable, optional
        Function that each process calls with the arguments before its first work.

    Yields
    ------
    ProcessPoolExecutor
        Pool of the processes; work that has not begun is cancelled if the block ends early.

    Raises
    ------
    ChildProcessError
        If a process is killed, for example because memory is exhausted.
    """
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, context, _start, (setup, arguments)) as pool:
        try:
            yield pool
        except BrokenProcessPool:
            raise ChildProcessError(
                "A worker process was killed, perhaps for its memory; what is finished is kept, "
                "and the same command goes on from there"
            ) from None
        finally:
            pool.shutdown(cancel_futures=True)


def _start(setup: Callable[..., None] | None, arguments: tuple) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    Thread(target=_end_with_parent, daemon=True).start()
    if setup is not None:
        setup(*arguments)


def _end_with_parent() -> None:
    """Wait for the end of the parent process, which may be unable to signal it."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)
