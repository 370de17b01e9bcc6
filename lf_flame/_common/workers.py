"""Processes that work for another one, and end with it."""

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
    """Start processes that leave Ctrl-C to this one, and end when it ends, whatever ends it.

    Parameters
    ----------
    workers : int
    setup : callable, optional
        Called in each of them, with the arguments, before its first work.

    Yields
    ------
    ProcessPoolExecutor
        Work that has not begun is given up where the block ends early.

    Raises
    ------
    ChildProcessError
        If one of them is killed, as a system without memory does.
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
    """Wait for the end of the process that started this one, which may not be able to say so."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)
