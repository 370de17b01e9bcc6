"""Compiled loops: shared among Numba's threads, and kept on disk.

A loop is a function of the number of a piece of work, which is called for all pieces:

    @parallel(lambda values: values.size)
    def double(k, values):
        values[k] *= 2

    double(values)

One thread does a piece, so that the bits do not depend on the number of threads, which is Numba's:
``numba.set_num_threads`` and ``NUMBA_NUM_THREADS``.
"""

import ctypes
import hashlib
import importlib.metadata
import inspect
import logging
import os
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from functools import lru_cache
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numba import njit, prange, types
from numba.core import cgutils
from numba.core.caching import FunctionCache
from numba.core.dispatcher import Dispatcher
from numba.core.imputils import impl_ret_borrowed
from numba.extending import intrinsic

COMPILING = (
    "Compiling what this command needs for this machine; it takes some seconds, at its first call."
)
NOT_KEPT = (
    "Compiling for this machine, some seconds at each start: no folder can be written in which "
    "Numba would keep the result; set NUMBA_CACHE_DIR to one."
)
# Of Numba's threading layers tbb alone survives calls from several threads at once, where workqueue
# ends the process, and a fork, where omp does. Numba does not look where pip puts the library, but
# takes one that is loaded.
with suppress(importlib.metadata.PackageNotFoundError, OSError):
    for _file in importlib.metadata.files("tbb") or ():
        if _file.name == "libtbb.so.12":
            ctypes.CDLL(str(_file.locate()))

_PROCESS, _LOCK = os.getpid(), threading.Lock()


@lru_cache
def _needed_lock() -> Any:
    numba.get_num_threads()  # starts the threads, which a user may have chosen
    return _LOCK if numba.threading_layer() == "workqueue" else nullcontext()


@contextmanager
def one_thread() -> Iterator[None]:
    """Run loops in the caller's thread only, where other processes use the other cores."""
    threads = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        yield
    finally:
        numba.set_num_threads(threads)


@lru_cache  # once in a process
def _announce(message: str) -> None:
    logging.getLogger(__name__).info(message)


class _Cache(FunctionCache):
    """Compiled code on disk; a fault in it costs a compilation, and never a wrong result.

    Numba's own raises an error if no folder can be written, as in some containers, and looks at
    the function's own file alone: it would go on with old code of functions of other files.
    """

    def __init__(self, function):
        parts = [part for part in function.__globals__.values() if isinstance(part, Dispatcher)]
        files = {__file__, *(part.py_func.__code__.co_filename for part in parts)}
        contents = b"".join(Path(file).read_bytes() for file in sorted(files))
        self._enabled = False
        with suppress(RuntimeError):
            super().__init__(function)
            own = self._cache_file._source_stamp
            self._cache_file._source_stamp = own, hashlib.sha256(contents).digest()

    def load_overload(self, sig, target_context):
        """Load compiled code; a damaged file, which may raise any error, is discarded."""
        found = None
        try:
            found = super().load_overload(sig, target_context)
        except Exception:
            with suppress(OSError):
                self.flush()
        if found is None:
            _announce(COMPILING if self._enabled else NOT_KEPT)
        return found

    def save_overload(self, sig, data):
        """Save compiled code; errors of the disk (full, removed) are ignored."""
        with suppress(OSError):
            super().save_overload(sig, data)


# Numba passes no tuple of tuples to its threads, but passes a pointer to one.
@intrinsic
def _pointer(_context, value):
    def generate(context, builder, _signature, arguments):
        place = cgutils.alloca_once(builder, context.get_data_type(value))
        context.pack_value(builder, value, arguments[0], place)
        return place

    return types.CPointer(value)(value), generate


# Numba's function of this name takes a lock at each call, which a fork would leave locked.
_set_chunk = types.ExternalFunction("set_parallel_chunksize", types.uintp(types.uintp))


@intrinsic
def _value(_context, pointer):
    def generate(context, builder, signature, arguments):
        value = context.unpack_value(builder, pointer.dtype, arguments[0])
        return impl_ret_borrowed(context, builder, signature.return_type, value)

    return pointer.dtype(pointer), generate


class Kernel:
    """A compiled loop over a body; called with the body's arguments but the first."""

    def __init__(self, count: Callable[..., int], body: Callable[..., None]):
        self.count, self.body = count, body
        names, counted = ([*inspect.signature(function).parameters] for function in (body, count))
        self.counted = [names.index(name) - 1 for name in counted]
        piece = njit(body)

        def loop(alone, count, *arguments):
            pointer, done = _pointer(arguments), 0
            if alone:
                for k in range(count):
                    piece(k, *arguments)
                return
            before = _set_chunk(max(count // 32, 1))  # runs of pieces that idle threads take
            for k in prange(count):
                piece(np.int64(k), *_value(pointer))
                done += 1
            _set_chunk(before)
            if done != count:  # the error itself may be lost with its thread
                raise RuntimeError("A compiled loop failed: no memory left, or a division by 0.")

        loop.__module__, loop.__qualname__ = body.__module__, f"{body.__qualname__}.loop"
        self.compiled = njit(parallel=True, nogil=True)(loop)
        if not numba.config.DISABLE_JIT:
            self.compiled._cache = _Cache(body)  # type: ignore[attr-defined]

    def __call__(self, *arguments: Any) -> None:
        count = self.count(*(arguments[place] for place in self.counted))
        if numba.config.DISABLE_JIT:
            for k in range(count):
                self.body(k, *arguments)
        elif os.getpid() != _PROCESS:  # forked, without the threads
            self.compiled(True, count, *arguments)
        else:
            with _needed_lock():
                self.compiled(False, count, *arguments)


def parallel(count: Callable[..., int]) -> Callable[[Callable], Kernel]:
    """Compile ``f(k, ...)`` as a loop over k below the count, a function of arguments of f."""
    return lambda body: Kernel(count, body)
