"""Compiled loops whose pieces go to whichever thread is free.

Numba's parallel loops are dealt out to all threads beforehand, and end when the last of them has
done its part; OpenMP's threads burn a core while they wait. On a machine that does something else
too, one of them is often without a core for some milliseconds, and all wait for it. Here the caller
works itself, from the first piece on; helpers take pieces as soon as they wake up, and who has not
woken up by the end is not waited for. Nobody spins, and nothing in the environment is set; of
Numba's threading layer only the number of threads is asked.

A loop becomes a kernel that takes the number of its next piece from a queue:

    def _double(queue, values):
        for k in pieces(queue, values.size):
            values[k] *= 2

    double = shared(_double)
    double(values)

What a piece works out must not depend on who does it: then the bits do not depend on the number of
threads, which is Numba's, ``numba.set_num_threads`` and ``NUMBA_NUM_THREADS``.
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
from numba.core.compiler import Compiler
from numba.core.dispatcher import Dispatcher
from numba.extending import intrinsic

from lf_flame._common.compiling import NOT_KEPT, compiled, not_kept

SHARES = 64
"""Into which many pieces are divided, about: what is left for one thread at the end is a 64th."""

CLOSED = 1 << 40
"""More than any loop has pieces; so a queue is closed, and its number has room to rise."""

COMPILING = (
    "Compiling what this command needs for this machine; it takes some seconds, at its first call."
)

LOGGER = logging.getLogger(__name__)


class _Announcement(event.Listener):
    """Says, once in a process, why nothing seems to happen while loops are compiled.

    What Numba has kept on disk is loaded without this event.
    """

    def __init__(self):
        self.said = False

    def on_start(self, event):
        if not self.said:
            self.said = True
            LOGGER.info(NOT_KEPT if not_kept else COMPILING)

    def on_end(self, event):
        """Nothing to say."""


event.register("numba:compile", _Announcement())


@intrinsic
def _take_next(_context, address, index):
    """Count up one of the int64 at an address in one indivisible step, and return what it was.

    Who sees a number sees all that was written before it was counted up to. An address and no
    array: other threads change it, and of arrays the compiler is told that nobody does.
    """

    def generate(context, builder, _signature, arguments):
        first = builder.inttoptr(arguments[0], ir.PointerType(ir.IntType(64)))
        place = builder.gep(first, [arguments[1]])
        return builder.atomic_rmw("add", place, context.get_constant(types.int64, 1), "acq_rel")

    return types.int64(types.int64, types.int64), generate


def _count_up(counters: np.ndarray, index: int) -> int:
    """Do the same in Python, for one thread."""
    counters[index] += 1
    return counters[index] - 1


take_next = _count_up if numba.config.DISABLE_JIT else _take_next


def as_counters(counters: np.ndarray) -> Any:
    """Give what `take_next` takes for some int64; the array must be kept meanwhile."""
    return counters if numba.config.DISABLE_JIT else counters.ctypes.data


def _pieces(queue: Any, count: int) -> Iterator[int]:
    """Give the numbers below a count that no other thread has been given.

    Of many some neighbours at a time, lest two threads write to one page of memory.
    """
    together = max(count // SHARES, 1)
    first = take_next(queue, 0) * together
    while first < count:
        for piece in range(first, min(first + together, count)):  # noqa: UP028 - Numba has none
            yield piece
        first = take_next(queue, 0) * together


pieces = njit(_pieces)


def _version(function: Callable) -> str:
    """Give a hash of the files whose code becomes part of a compiled loop.

    What Numba has kept on disk is known by it: Numba itself looks at the loop's own file alone.
    A compiled function of another file must not call one of a third.
    """
    parts = [part for part in function.__globals__.values() if isinstance(part, Dispatcher)]
    files = {part.py_func.__code__.co_filename for part in parts}
    return hashlib.sha256(b"".join(map(_read, sorted(files)))).hexdigest()[:8]


@lru_cache
def _read(file: str) -> bytes:
    return Path(file).read_bytes()


class _NoOverlap(Compiler):
    """Numba's compiler, told that no two arguments share memory, as it is told in its own loops.

    Else each inner loop begins with a test whether they do.
    """

    def define_pipelines(self):
        self.state.flags.noalias = True
        return super().define_pipelines()


class SharedKernel:
    """A compiled loop that threads share; called as its function, but for the queue."""

    def __init__(self, function: Callable[..., None], exchange: bool, **options):
        function.__qualname__ = f"{function.__qualname__}-{_version(function)}"
        ours: dict[str, Any] = {"nogil": True}
        if not exchange:
            ours["pipeline_class"] = _NoOverlap
        self.compiled = compiled(function, **ours | options)
        self.__doc__, self.__name__ = function.__doc__, function.__name__

    def alone(self, *arguments: Any) -> None:
        """Let the caller do all of it: for so little work that helpers would come too late."""
        self._work(np.zeros(1, np.int64), *arguments)

    def _work(self, counter: np.ndarray, *arguments: Any) -> None:
        """Take pieces until there are none; the counter lives as long as whoever counts by it."""
        self.compiled(as_counters(counter), *arguments)

    def __call__(self, *arguments: Any) -> None:
        if numba.config.DISABLE_JIT:  # Python counts in more than one step
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
        with suppress(RuntimeError):  # no more threads, or none as the program ends: do without
            for _ in range(numba.get_num_threads() - 1):
                helpers.append(_helpers(os.getpid()).submit(self._work, counter, *arguments))


def _wait_for(helpers: list[Future]) -> None:
    """Wait for those that have begun, all of them, whatever happens meanwhile."""
    begun = [helper for helper in helpers if not helper.cancel()]
    try:
        for helper in begun:
            helper.result()
    finally:
        for helper in begun:
            while not helper.done():
                helper.exception()


def shared(function: Callable[..., None], exchange: bool = False, **options: Any) -> SharedKernel:
    """Compile a loop over `pieces` for all threads.

    Parameters
    ----------
    function : callable
        Of a queue, which it hands on to `pieces`, and of its arguments; it returns nothing.
    exchange : bool, optional
        Whether a thread reads what another one has written during the call. If not, the compiler
        is told that no two arguments share memory, and that nobody else writes there.
    **options
        Of ``numba.njit``.

    Returns
    -------
    SharedKernel
    """
    return SharedKernel(function, exchange, **options)


@contextmanager
def one_thread() -> Iterator[None]:
    """Let loops keep to the caller's thread, for other processes work beside it."""
    threads = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        yield
    finally:
        numba.set_num_threads(threads)


@lru_cache(maxsize=1)
def _helpers(_process: int) -> ThreadPoolExecutor:
    """Start threads beside the caller's: others in a process that was forked, which lost them."""
    most = max(numba.config.NUMBA_NUM_THREADS - 1, 1)
    return ThreadPoolExecutor(most, thread_name_prefix="lf_flame")
