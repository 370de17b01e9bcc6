"""Compiled loops with pieces that idle threads take in turn.

Numba's parallel loops divide the work beforehand and end when the last thread has done its part;
OpenMP's threads use a core while they wait. On a machine with other work, a thread often has no
core for some milliseconds, and all others wait for it. Here the caller itself works from the first
piece on. Helpers take pieces as soon as they start; helpers that have not started by the end are
not waited for. Beside one busy process on two cores this refocuses in half the time of Numba's own
loops, on an idle machine in a tenth more (``experiments/results/benchmarks/busy.md``). No thread
spins, and no environment variable is set; only the number of threads is read from Numba's threading
layer.

A loop becomes a kernel that takes the numbers of its pieces from a queue:

    def _double(queue, values):
        for k in pieces(queue, values.size):
            values[k] *= 2

    double = shared(_double)
    double(values)

The result of a piece must not depend on the thread: then the bits do not depend on the number of
threads, which is Numba's: ``numba.set_num_threads`` and ``NUMBA_NUM_THREADS``.
"""

import hashlib
import logging
import os
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from functools import lru_cache
from pathlib import Path
from typing import Any

import numba
import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.core import event
from numba.core.dispatcher import Dispatcher
from numba.extending import intrinsic

from lf_flame._common.compiling import NOT_KEPT, compiled, not_kept

SHARES = 64
"""Number of runs into which pieces are divided, so that the last thread alone does a 64th."""

CLOSED = 1 << 40
"""Counter value of a closed queue: above any number of pieces, with room to count further."""

COMPILING = (
    "Compiling what this command needs for this machine; it takes some seconds, at its first call."
)

LOGGER = logging.getLogger(__name__)


class _Announcement(event.Listener):
    """Logs, once in a process, that loops are being compiled.

    The first start of a command takes 4 to 7 seconds longer than the second
    (``experiments/results/benchmarks/starting.md``). Loading from Numba's cache does not raise this
    event.
    """

    def __init__(self):
        self.said = False

    def on_start(self, event):
        if not self.said:
            self.said = True
            LOGGER.info(NOT_KEPT if not_kept else COMPILING)

    def on_end(self, event):
        """Log nothing."""


event.register("numba:compile", _Announcement())


@intrinsic
def _take_next(_context, address, index):
    """Increment the int64 at an address atomically, and return its previous value.

    A thread that reads the counter also sees every write made before the increment
    (acquire/release). It takes an address, not an array, because other threads change the value,
    and the compiler assumes that no other thread changes arrays.
    """

    def generate(context, builder, _signature, arguments):
        first = builder.inttoptr(arguments[0], ir.PointerType(ir.IntType(64)))
        place = builder.gep(first, [arguments[1]])
        return builder.atomic_rmw("add", place, context.get_constant(types.int64, 1), "acq_rel")

    return types.int64(types.int64, types.int64), generate


def _count_up(counters: np.ndarray, index: int) -> int:
    """Increment in Python, for one thread."""
    counters[index] += 1
    return counters[index] - 1


take_next = _count_up if numba.config.DISABLE_JIT else _take_next


def as_counters(counters: np.ndarray) -> Any:
    """Address of int64 counters for `take_next`; the array must be kept alive meanwhile."""
    return counters if numba.config.DISABLE_JIT else counters.ctypes.data


def _pieces(queue: Any, count: int) -> Iterator[int]:
    """Yield the numbers below `count` that no other thread has received.

    Large loops hand out runs of neighbours, to avoid false sharing.
    """
    together = max(count // SHARES, 1)
    first = take_next(queue, 0) * together
    while first < count:
        for piece in range(first, min(first + together, count)):  # noqa: UP028 - not in Numba
            yield piece
        first = take_next(queue, 0) * together


pieces = njit(_pieces)


def _version(function: Callable) -> str:
    """Hash of the files that contribute code to a compiled loop.

    It identifies what Numba has kept on disk. Numba itself checks only the loop's own file, so
    that after a change of a function in another file it would go on with the old numbers; a test
    shows it (``test_loops_kept_on_disk_...``). A compiled function of another file must not call
    one of a third.
    """
    parts = [part for part in function.__globals__.values() if isinstance(part, Dispatcher)]
    files = {part.py_func.__code__.co_filename for part in parts}
    return hashlib.sha256(b"".join(map(_read, sorted(files)))).hexdigest()[:8]


@lru_cache
def _read(file: str) -> bytes:
    return Path(file).read_bytes()


class SharedKernel:
    """A compiled loop that threads share; called with its function's arguments but the queue."""

    def __init__(self, function: Callable[..., None], **options):
        function.__qualname__ = f"{function.__qualname__}-{_version(function)}"
        self.compiled = compiled(function, nogil=True, **options)
        self.__doc__, self.__name__ = function.__doc__, function.__name__

    def alone(self, *arguments: Any) -> None:
        """Do all work in the caller's thread, for loops too short for helpers to join."""
        self._work(np.zeros(1, np.int64), *arguments)

    def _work(self, counter: np.ndarray, *arguments: Any) -> None:
        """Take pieces until none remain; holding `counter` here keeps it alive."""
        self.compiled(as_counters(counter), *arguments)

    def __call__(self, *arguments: Any) -> None:
        if numba.config.DISABLE_JIT:  # increments in Python are not atomic
            self.alone(*arguments)
            return
        counter = np.zeros(1, np.int64)
        helpers: list[Future] = []
        try:
            self._ask_for_help(helpers, counter, arguments)
            self._work(counter, *arguments)
        except BaseException:
            counter[0] = CLOSED
            raise
        finally:
            _wait_for(helpers)

    def _ask_for_help(self, helpers: list[Future], counter: np.ndarray, arguments: tuple) -> None:
        with suppress(RuntimeError):  # no thread can be started: continue without helpers
            for _ in range(numba.get_num_threads() - 1):
                helpers.append(_helpers(os.getpid()).submit(self._work, counter, *arguments))


def _wait_for(helpers: list[Future]) -> None:
    """Wait for all helpers that have begun, even if the wait is interrupted."""
    begun = [helper for helper in helpers if not helper.cancel()]
    try:
        for helper in begun:
            helper.result()
    finally:
        for helper in begun:
            while not helper.done():
                helper.exception()


def shared(function: Callable[..., None], **options: Any) -> SharedKernel:
    """Compile a loop over `pieces` for all threads.

    Parameters
    ----------
    function : callable
        Function of a queue, which it passes on to `pieces`, and of arguments; returns nothing.
    **options
        Options of ``numba.njit``.

    Returns
    -------
    SharedKernel
    """
    return SharedKernel(function, **options)


@contextmanager
def one_thread() -> Iterator[None]:
    """Run loops in the caller's thread only, where other processes use the other cores."""
    threads = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        yield
    finally:
        numba.set_num_threads(threads)


@lru_cache(maxsize=1)
def _helpers(_process: int) -> ThreadPoolExecutor:
    """Threads beside the caller's; a forked process, which has lost them, starts new ones."""
    most = max(numba.config.NUMBA_NUM_THREADS - 1, 1)
    return ThreadPoolExecutor(most, thread_name_prefix="lf_flame")
