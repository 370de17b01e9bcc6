"""Worker processes that end with the process that started them."""

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, nullcontext
from multiprocessing.connection import wait
from multiprocessing.context import SpawnContext, SpawnProcess
from threading import RLock, Thread
from typing import TypeVar

from tqdm import tqdm

from lf_flame._common.threads import one_thread

T = TypeVar("T")


class _Worker(SpawnProcess):
    """Process that Ctrl-C never reaches, not even while it starts."""

    def start(self) -> None:
        """Start the process, which inherits the signals that are blocked here for a moment."""
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            super().start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


class _Context(SpawnContext):
    Process = _Worker


@contextmanager
def worker_pool(workers: int) -> Iterator[ProcessPoolExecutor]:
    """Start worker processes that Ctrl-C does not reach; they end with this one, however it ends.

    Work that has not begun is cancelled if the block ends early. At Ctrl-C the processes are
    killed: the files that they write are whole or absent. A worker that is killed, as when memory
    is exhausted, raises `ChildProcessError`.
    """
    others = multiprocessing.active_children()
    with ProcessPoolExecutor(workers, _Context(), _start) as pool:
        try:
            yield pool
        except BrokenProcessPool:
            raise ChildProcessError(
                "A worker process was killed, perhaps for lack of memory; finished work is kept, "
                "and the same command resumes from there"
            ) from None
        except (KeyboardInterrupt, GeneratorExit):
            for process in multiprocessing.active_children():
                if process not in others:
                    process.kill()
            raise
        finally:
            pool.shutdown(cancel_futures=True)


def _start() -> None:
    # The lock that tqdm shares among processes would be reported as leaked when this one is killed.
    tqdm.set_lock(RLock())
    Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """Wait for the end of the parent process, which may be unable to signal it."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)


def carry_out(
    tasks: Sequence[Callable[[], Iterable[T]]], workers: int, executor: Executor | None
) -> Iterator[T]:
    """Carry out tasks that can be pickled, and yield the results of each when it is done.

    A single worker is this process, on all threads; an `executor` replaces worker processes.
    """
    if executor is None and workers == 1:
        for task in tasks:
            yield from task()
        return
    with nullcontext(executor) if executor is not None else worker_pool(workers) as pool:
        jobs = [pool.submit(_alone, task) for task in tasks]
        try:
            for job in as_completed(jobs):
                yield from job.result()
        finally:
            for job in jobs:
                job.cancel()


def _alone(task: Callable[[], T]) -> T:
    """Carry out a task on one thread, because others run in parallel."""
    with one_thread():
        return task()
