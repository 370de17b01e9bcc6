"""Input files: regular ones only, of bounded size in memory; TOML and JSON; text to be shown."""

import os
import stat
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from lf_flame.errors import InputError

LARGEST_TEXT = 1 << 26
"""Largest size of a text file, in bytes: the history of half a million epochs."""

LIMIT = "LF_FLAME_MEMORY_GB"
"""Environment variable that sets another limit of memory than half, in gigabytes (1e9 bytes)."""


def check_regular(path: str | Path) -> int:
    """Size of a regular file in bytes; any other is refused, because a pipe may block for ever."""
    try:
        found = os.stat(path)  # noqa: PTH116 - for text and paths alike
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", "no file has such a name")
        raise InputError(f"{path} cannot be read: {reason}.") from None
    if not stat.S_ISREG(found.st_mode):
        kind = "a folder" if stat.S_ISDIR(found.st_mode) else "a device, a pipe or a socket"
        raise InputError(f"{path} cannot be read: it must be a regular file, but is {kind}.")
    return found.st_size


@contextmanager
def readable(path: str | Path, fault: str = "of a kind that is not known") -> Iterator[None]:
    """Turn a reader's exceptions into an `InputError` that names the file.

    Libraries raise errors of all kinds for damaged files, so that only their own calls belong
    inside the block: a mistake in this package must not be reported as a damaged file. `fault`
    completes the message: "it is damaged, or ...".
    """
    check_regular(path)
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        reason = str(error).strip().partition("\n")[0].partition(". ")[0] or type(error).__name__
        raise InputError(
            f"{path} cannot be read: it is damaged, or {fault} ({reason[:200]})."
        ) from error


def read_text(path: str | Path, largest: int = LARGEST_TEXT) -> str:
    """Read a text file in UTF-8, with or without a byte-order mark, of at most `largest` bytes."""
    size = check_regular(path)
    if size > largest:
        raise InputError(
            f"{path} cannot be read: it has {size:,} bytes, more than the {largest:,} allowed."
        )
    with Path(path).open("rb") as file:
        content = file.read(size)
    try:
        return content.decode("utf-8-sig")  # Windows' Notepad and Excel write the mark
    except UnicodeDecodeError as error:
        raise InputError(
            f"{path} is not text in UTF-8 ({error.reason} at {error.start}); save it as UTF-8."
        ) from None


def read_toml(path: str | Path) -> dict[str, Any]:
    """Parse a TOML file of bounded size and depth."""
    text = read_text(path)
    try:
        values = tomllib.loads(text)
        repr(values)  # dots in a key nest deeper than anything reads
    except (ValueError, RecursionError) as error:  # an impossible date, too, or deep nesting
        raise InputError(f"{path} is not a TOML file: {error}.") from None
    _check_values(values, path)
    return values


def read_record(path: str | Path) -> dict[str, Any]:
    """Parse a JSON record written by this program: an object of bounded size and depth."""
    record = parse_json(read_text(path), path)
    if not isinstance(record, dict):
        raise InputError(f"{path} is not a record: it must contain names and values.")
    return record


def parse_json(text: str, source: str | Path) -> Any:
    """Parse JSON of bounded depth from a source; infinity and NaN are refused."""
    from pydantic_core import from_json  # a camera alone needs none of it

    try:
        values = from_json(text, allow_inf_nan=False)
    except ValueError as error:
        raise InputError(f"{source} is not a JSON file: {error}.") from None
    _check_values(values, source)
    return values


def _check_values(values: Any, source: str | Path) -> None:
    """Refuse null bytes, which no file name can contain, and integers beyond 64 bits."""
    left = [values]
    while left:
        value = left.pop()
        if isinstance(value, dict):
            left += [*value.keys(), *value.values()]
        elif isinstance(value, list):
            left += value
        elif isinstance(value, str) and "\0" in value:
            raise InputError(f"{source} cannot be used: a text in it contains a null byte.")
        elif isinstance(value, int) and not -(2**63) <= value < 2**63:
            raise InputError(f"{source} cannot be used: it contains an integer beyond 64 bits.")


def memory_limit() -> float:
    """Largest number of bytes that one input may take."""
    stated = os.environ.get(LIMIT)
    if stated is None:
        # Half of the machine's memory, so that a light field and its copy fit.
        return 0.5 * os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    try:
        limit = float(stated)
    except ValueError:
        limit = 0.0
    if not limit > 0:
        raise InputError(f"{LIMIT} must be a number of gigabytes above 0, got {stated!r}.")
    return limit * 1e9


def check_memory(needed: int, source: object) -> None:
    """Refuse an input, named by its `source`, that needs too much memory, before it is read."""
    limit = memory_limit()
    if needed > limit:
        raise InputError(
            f"{source} would need {needed / 1e9:.3g} GB of memory, and {limit / 1e9:.3g} GB are "
            f"allowed; {LIMIT} sets another limit."
        )


def printable(text: object, longest: int = 200) -> str:
    """Text as one line without control characters, which loses its middle beyond `longest`.

    Text from files may contain line breaks, control characters and direction marks, which forge
    lines, change colours and reverse words.
    """
    letters = (x if x.isprintable() else " " if x.isspace() else "?" for x in str(text))
    line = " ".join("".join(letters).split())
    if len(line) > longest:
        line = f"{line[: longest // 2]} ... {line[-longest // 2 :]}"
    return line
