"""Limit of the memory that one input may take."""

import os

from lf_flame.errors import InputError

LIMIT = "LF_FLAME_MEMORY_GB"
"""Name of the environment variable that sets another limit, in gigabytes (1e9 bytes)."""

SHARE = 0.5
"""Fraction of the machine's memory that one input may take: a light field and its copy fit."""


def memory_limit() -> float:
    """Largest number of bytes that one input may take."""
    stated = os.environ.get(LIMIT)
    if stated is None:
        return SHARE * os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    try:
        limit = float(stated)
    except ValueError:
        limit = 0.0
    if not limit > 0:
        raise InputError(f"{LIMIT} must be a number of gigabytes above 0, got {stated!r}.")
    return limit * 1e9


def check_memory(needed: int, source: object) -> None:
    """Refuse an input that needs too many bytes, before they are allocated.

    `source` is the name of the input, for the message.
    """
    limit = memory_limit()
    if needed > limit:
        raise InputError(
            f"{source} would need {needed / 1e9:.3g} GB of memory, and {limit / 1e9:.3g} GB are "
            f"allowed; {LIMIT} sets another limit."
        )
