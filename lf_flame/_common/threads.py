"""Compiled loops whose pieces go to whichever thread is free.

Numba's parallel loops are dealt out to all threads beforehand, and end when the last of them has
done its part; OpenMP's threads burn a core while they wait. On a machine that does something else
too, one of them is often without a core for some milliseconds, and all wait for it. Here the caller
works itself, from the first piece on; helpers take pieces as soon as they wake up, and who has not
woken up by the end is not waited for. Nobody spins, and nothing in the environment is set.

A loop becomes a kernel that takes the number of its next piece from a queue:

    def _double(queue, values):
        for k in pieces(queue, values.size):
            values[k] *= 2

    double = shared(_double)
    double(values)

What a piece works out must not depend on who does it: then the bits do not depend on the number of
threads, which is Numba's, ``numba.set_num_threads`` and ``NUMBA_NUM_THREADS``.
"""

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from typing import Any

import numba
import numpy as np
from numba import njit, types
from numba.core import cgutils
from numba.core.compiler import Compiler
from numba.extending import intrinsic

SHARES = 64
"""Into which many pieces are divided, about: what is left for one thread at the end is a 64th."""


@intrinsic
def _take_next(_context, queue):
    """Count queue[0] up in one indivisible step, and return what it was.

    Who sees a number sees all that was written before it was counted up to.
    """

    def generate(context, builder, signature, arguments):
        array = cgutils.create_struct_proxy(signature.args[0])(context, builder, arguments[0])
        one = context.get_constant(types.int64, 1)
        return builder.atomic_rmw("add", array.data, one, "acq_rel")

    return types.int64(queue), generate


def _count_up(queue: np.ndarray) -> int:
    """Do the same in Python, for one thread."""
    queue[0] += 1
    return queue[0] - 1


take_next = _count_up if numba.config.DISABLE_JIT else _take_next


def _pieces(queue: np.ndarray, count: int) -> Iterator[int]:
    """Give the numbers below a count that no other thread has been given.

    Of many some neighbours at a time, lest two threads write to one page of memory.
    """
    together = max(count // SHARES, 1)
    first = take_next(queue) * together
    while first < count:
        for piece in range(first, min(first + together, count)):  # noqa: UP028 - Numba has none
            yield piece
        first = take_next(queue) * together


pieces = njit(_pieces)


class _NoOverlap(Compiler):
    """Numba's compiler, told that no two arguments share memory, as it is told in its own loops.

    Else each inner loop begins with a test whether they do.
    """

    def define_pipelines(self):
        self.state.flags.noalias = True
        return super().define_pipelines()


class SharedKernel:
    """A compiled loop that threads share; called as its function, but for the queue."""

    def __init__(self, function: Callable[..., None], **options):
        ours = {"nogil": True, "cache": True, "pipeline_class": _NoOverlap}
        self.compiled = njit(**ours | options)(function)
        self.__doc__, self.__name__ = function.__doc__, function.__name__

    def alone(self, *arguments: Any) -> None:
        """Let the caller do all of it: for so little work that helpers would come too late."""
        self.compiled(np.zeros(1, np.int64), *arguments)

    def __call__(self, *arguments: Any) -> None:
        if numba.config.DISABLE_JIT:  # Python counts in more than one step
            self.alone(*arguments)
            return
        queue = np.zeros(1, np.int64)
        helpers = [
            _helpers(os.getpid()).submit(self.compiled, queue, *arguments)
            for _ in range(numba.get_num_threads() - 1)
        ]
        try:
            self.compiled(queue, *arguments)
        finally:
            for helper in helpers:
                if not helper.cancel():  # it has begun
                    helper.result()


def shared(function: Callable[..., None], **options: Any) -> SharedKernel:
    """Compile a loop over `pieces` for all threads.

    Parameters
    ----------
    function : callable
        Of a queue, which it hands on to `pieces`, and of its arguments; it returns nothing.
    **options
        Of ``numba.njit``.

    Returns
    -------
    SharedKernel
    """
    return SharedKernel(function, **options)


@lru_cache(maxsize=1)
def _helpers(_process: int) -> ThreadPoolExecutor:
    """Start threads beside the caller's: others in a process that was forked, which lost them."""
    most = max(numba.config.NUMBA_NUM_THREADS - 1, 1)
    return ThreadPoolExecutor(most, thread_name_prefix="lf_flame")
