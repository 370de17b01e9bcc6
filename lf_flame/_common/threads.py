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
    "Compiling what this command needs for this machine; this takes some seconds, the first time."
)
NOT_KEPT = (
    "Compiling for this machine, some seconds at each start: there is no writable folder in which "
    "Numba would keep the result; set NUMBA_CACHE_DIR to one."
)
# Among Numba's threading layers, only tbb survives both calls from several threads at once, where
# workqueue ends the process, and a fork, where omp does. Numba does not look where pip puts the
# library, but uses one that is loaded.
with suppress(importlib.metadata.PackageNotFoundError, OSError):
    for _file in importlib.metadata.files("tbb") or ():
        if _file.name == "libtbb.so.12":
            ctypes.CDLL(str(_file.locate()))

without_refcounts = njit(_nrt=False)
"""Compile a function that a loop calls without counts of references to its arrays.

Threads wait for each other where they count: a slope map took four times as long with counts. The
option is private in Numba. The function may not create arrays.
"""

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

    Numba's own raises an error without a writable folder, as in some containers, and checks only
    the function's own file: it would reuse old code of functions in other files.
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


def _kept(kernel: Any, function: Callable) -> Any:
    if not numba.config.DISABLE_JIT:
        kernel._cache = _Cache(function)
    return kernel


# One `prange` serves all loops, by the addresses of their code and arguments: with a `prange` of
# its own each would compile for twice as long, and Numba passes no tuple of tuples to its threads.
@intrinsic
def _addresses(typing, piece, arguments):
    """Addresses of the code of ``piece(k, pointer)``, and of the arguments it points to."""
    called = types.intp, types.CPointer(arguments)
    piece.get_call_type(typing, called, {})  # compiles it

    def generate(context, builder, signature, values):
        code = piece.dispatcher.overloads[called]
        context.add_linking_libs([code.library])
        place = cgutils.alloca_once(builder, context.get_data_type(arguments))
        context.pack_value(builder, arguments, values[1], place)
        function = context.declare_function(builder.module, code.fndesc)
        both = [builder.ptrtoint(address, cgutils.intp_t) for address in (function, place)]
        return context.make_tuple(builder, signature.return_type, both)

    return types.UniTuple(types.intp, 2)(piece, arguments), generate


@intrinsic
def _value(_typing, pointer):
    def generate(context, builder, signature, values):
        value = context.unpack_value(builder, pointer.dtype, values[0])
        return impl_ret_borrowed(context, builder, signature.return_type, value)

    return pointer.dtype(pointer), generate


@intrinsic
def _fails(_typing, code, arguments, k):
    """Call the code of a piece, and return whether it raised an error."""
    called = types.intp, types.voidptr

    def generate(context, builder, _signature, values):
        function = context.call_conv.get_function_type(types.none, called).as_pointer()
        function = builder.inttoptr(values[0], function)
        pointer = builder.inttoptr(values[1], cgutils.voidptr_t)
        given = values[2], pointer
        status, _ = context.call_conv.call_function(builder, function, types.none, called, given)
        return status.is_error

    return types.boolean(code, arguments, k), generate


# Numba's function of this name takes a lock at each call, which a fork would leave locked.
_set_chunk = types.ExternalFunction("set_parallel_chunksize", types.uintp(types.uintp))


def _share(alone, code, arguments, count):
    """Call the code for all pieces, and return the number of those that raised an error."""
    failures = 0
    if alone:
        for k in range(count):
            failures += _fails(code, arguments, k)
        return failures
    before = _set_chunk(max(count // 32, 1))  # runs of pieces that idle threads take
    for k in prange(count):
        failures += _fails(code, arguments, np.int64(k))
    _set_chunk(before)
    return failures


share = _kept(njit(parallel=True)(_share), _share)


class Kernel:
    """A compiled loop over a body; called with all of the body's arguments except the first."""

    def __init__(self, count: Callable[..., int], body: Callable[..., None]):
        self.count, self.body = count, body
        names, counted = ([*inspect.signature(function).parameters] for function in (body, count))
        self.counted = [names.index(name) - 1 for name in counted]
        from_numba_alone = njit(no_cpython_wrapper=True, no_cfunc_wrapper=True)
        one = from_numba_alone(body)

        def piece(k, pointer):
            one(k, *_value(pointer))

        def loop(alone, count, *arguments):
            if share(alone, *_addresses(piece, arguments), count):
                raise RuntimeError("A compiled loop failed: no memory left, or a division by 0.")

        for function in (piece, loop):  # names of machine code, which must differ
            function.__module__ = body.__module__
            function.__qualname__ = f"{body.__qualname__}.{function.__name__}"
        piece = from_numba_alone(piece)
        self.compiled = _kept(njit(nogil=True)(loop), body)

    def __call__(self, *arguments: Any) -> None:
        count = self.count(*(arguments[place] for place in self.counted))
        if numba.config.DISABLE_JIT:
            for k in range(count):
                self.body(k, *arguments)
        else:
            forked = os.getpid() != _PROCESS  # without the threads
            with nullcontext() if forked else _needed_lock():
                self.compiled(forked, count, *arguments)


def parallel(count: Callable[..., int]) -> Callable[[Callable], Kernel]:
    """Compile ``f(k, ...)`` as a loop over k below the count, a function of arguments of f."""
    return lambda body: Kernel(count, body)
