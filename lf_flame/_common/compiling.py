"""Compiled functions, kept on disk by Numba, or compiled at each start where it cannot write."""

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
"""Names of the functions for which Numba found no folder to write to."""


class _ForgivingCache(FunctionCache):
    """A cache on disk; a fault in it costs a compilation, and never a wrong result."""

    def load_overload(self, sig, target_context):
        """Load compiled code; a damaged file, which may raise any error, is discarded."""
        try:
            return super().load_overload(sig, target_context)
        except Exception:
            with suppress(OSError):
                self.flush()
            return None

    def save_overload(self, sig, data):
        """Save compiled code; errors of the disk (full, removed) are ignored."""
        with suppress(OSError):
            super().save_overload(sig, data)


def compiled(function: Callable, **options: Any) -> Any:
    """Compile a function at its first call, and keep the result on disk where possible.

    Numba raises an error if it can write neither beside the function's file nor to the user's
    cache folder nor to NUMBA_CACHE_DIR, as in some containers; here such a function is compiled
    at each start.

    Parameters
    ----------
    function : callable
    **options
        Options of `numba.njit`.
    """
    kernel = njit(**options)(function)
    if isinstance(kernel, Dispatcher):  # False under NUMBA_DISABLE_JIT: a plain function
        try:
            kernel._cache = _ForgivingCache(function)  # type: ignore[attr-defined]
        except RuntimeError:
            not_kept.add(function.__qualname__)
    return kernel
