"""Compiled functions that Numba keeps on disk, or compiles at each start where it cannot."""

from collections.abc import Callable
from contextlib import suppress
from typing import Any

from numba import njit
from numba.core.caching import FunctionCache
from numba.core.dispatcher import Dispatcher

NOT_KEPT = (
    "Compiling for this machine, some seconds at each start: no folder can be written in which "
    "Numba would keep the result; set NUMBA_CACHE_DIR to one."
)

not_kept: set[str] = set()
"""Names of the functions for which Numba has found no folder."""


class _ForgivingCache(FunctionCache):
    """A cache on disk whose faults cost a compilation, and never a result."""

    def load_overload(self, sig, target_context):
        """Load compiled code; what is damaged, and may raise anything, is forgotten."""
        try:
            return super().load_overload(sig, target_context)
        except Exception:
            with suppress(OSError):
                self.flush()
            return None

    def save_overload(self, sig, data):
        """Save compiled code, unless the disk is full or no longer there."""
        with suppress(OSError):
            super().save_overload(sig, data)


def compiled(function: Callable, **options: Any) -> Any:
    """Compile a function when it is called first, and keep the result on disk where possible.

    Numba refuses to declare a function where it can write neither beside the function's file nor
    into the user's folder nor into NUMBA_CACHE_DIR, as in containers.

    Parameters
    ----------
    function : callable
    **options
        Options of `numba.njit`.
    """
    kernel = njit(**options)(function)
    if isinstance(kernel, Dispatcher):  # a plain function under NUMBA_DISABLE_JIT
        try:
            kernel._cache = _ForgivingCache(function)  # type: ignore[attr-defined]
        except RuntimeError:
            not_kept.add(function.__qualname__)
    return kernel
