"""Files from outside: regular ones only; TOML and JSON of bounded size and depth."""

import json
import lzma
import math
import os
import re
import stat
import tomllib
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

from lf_flame.errors import InputError

LARGEST_TOML = 1 << 20
"""Bytes of a configuration at most; its parser takes about a second for them."""

LARGEST_RECORD = 1 << 26
"""Bytes of a record at most: the history of half a million epochs."""

DEEPEST = 64
"""Tables and lists within each other, at most; a saved network has about 20."""

ZIP_ERRORS = (
    BadZipFile, zlib.error, lzma.LZMAError, EOFError, OSError, NotImplementedError, RuntimeError,
    ValueError, OverflowError,
)  # fmt: skip
"""What zipfile raises at a damaged, encrypted or strangely packed archive."""

NOT_REGULAR = {
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}


def check_regular(path: str | Path) -> int:
    """Refuse what is no regular file, before anything opens it and perhaps waits for ever.

    Returns
    -------
    int
        Its size in bytes.

    Raises
    ------
    InputError
        If there is nothing of that name, or a folder, device, pipe or socket.
    """
    try:
        found = os.stat(path)  # noqa: PTH116 - for text and paths alike
    except FileNotFoundError:
        raise InputError(f"{path} cannot be read: there is no such file.") from None
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}.") from None
    except ValueError:
        raise InputError(f"{path} cannot be read: no file has such a name.") from None
    kind = NOT_REGULAR.get(stat.S_IFMT(found.st_mode))
    if kind is not None:
        raise InputError(f"{path} cannot be read: it must be a regular file, and is {kind}.")
    return found.st_size


@contextmanager
def readable(
    path: str | Path,
    errors: tuple[type[Exception], ...],
    fault: str = "of a kind that is not known",
) -> Iterator[None]:
    """Name the file where somebody else's reader gives it up.

    Nothing but the reader's own calls should stand inside: an error of these kinds that is our own
    mistake must not be taken for a damaged file.

    Parameters
    ----------
    path : str or Path
    errors : tuple of exception types
        What this reader raises at a damaged or strange file.
    fault : str, optional
        What is wrong if it is not damaged.

    Raises
    ------
    InputError
        If the file is no regular one, or the reader raises one of these.
    """
    check_regular(path)
    try:
        yield
    except InputError:
        raise
    except errors as error:
        reason = str(error).strip().partition("\n")[0].partition(". ")[0] or type(error).__name__
        raise InputError(
            f"{path} cannot be read: it is damaged, or {fault} ({reason[:200]})."
        ) from error


def read_text(path: str | Path, largest: int = LARGEST_RECORD) -> str:
    """Read a text file in UTF-8, of so many bytes at most.

    Raises
    ------
    InputError
        If it cannot be read, is larger, or is no text.
    """
    size = check_regular(path)
    if size > largest:
        raise InputError(
            f"{path} cannot be read: it has {size:,} bytes, and {largest:,} are the most."
        )
    try:
        with Path(path).open("rb") as file:
            content = file.read(largest)
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}.") from None
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError as error:
        raise InputError(f"{path} is no text in UTF-8: {error.reason} at {error.start}.") from None


def read_toml(path: str | Path) -> dict[str, Any]:
    """Parse a TOML file.

    Raises
    ------
    InputError
        If the file is missing, is not TOML, or is too large or too deep.
    """
    text = read_text(path, LARGEST_TOML)
    _check_depth(text, path)
    try:
        values = tomllib.loads(text)
    except RecursionError:  # behind text that hides brackets from `_check_depth`
        raise InputError(
            f"{path} is not a TOML file that can be read: it nests too deep."
        ) from None
    except ValueError as error:  # a date or a number that cannot be, too
        raise InputError(f"{path} is not a TOML file: {error}.") from None
    _check_values(values, path)
    return values


def read_record(path: str | Path) -> dict[str, Any]:
    """Parse a JSON record that one of the programs wrote.

    Raises
    ------
    InputError
        If the file is missing, is no such record, or is too large or too deep.
    """
    record = parse_json(read_text(path), path)
    if not isinstance(record, dict):
        raise InputError(f"{path} is no record: it must hold names and values.")
    return record


def parse_json(text: str, source: str | Path) -> Any:
    """Parse JSON of bounded depth, without infinity and NaN, and with each name once.

    Parameters
    ----------
    text : str
    source : str or Path
        Where it comes from, for the message.

    Raises
    ------
    InputError
        If it is no JSON, or too deep.
    """
    _check_depth(text, source)
    try:
        values = json.loads(
            text, object_pairs_hook=_unique, parse_float=_finite, parse_constant=_finite
        )
    except ValueError as error:
        raise InputError(f"{source} is not a JSON file: {error}.") from None
    _check_values(values, source)
    return values


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        raise ValueError("a name occurs twice in one table")
    return found


def _finite(text: str) -> float:
    number = float(text)
    if not math.isfinite(number):
        raise ValueError(f"{text} is no number that a record may hold")
    return number


MARKS = re.compile(
    r""" "(?:[^"\\\n]|\\.)*" | '[^'\n]*'  # text
       | \#[^\n]*                         # a remark, in TOML
       | [\[{\]}.\n,=]""",
    re.VERBOSE,
)


def _check_depth(text: str, source: str | Path) -> None:
    """Refuse what nests too deeply, by its brackets and, in TOML, by the dots of its names.

    Before parsing: parsers call themselves for each bracket, and for a name of n parts TOML's
    copies n * n of them.
    """
    brackets = dots = 0
    for found in MARKS.finditer(text):
        mark = found[0][0]
        if mark in "[{":
            brackets += 1
        elif mark in "]}":
            brackets = max(brackets - 1, 0)
        elif mark == ".":
            dots += 1
        elif mark in "\n,=":
            dots = 0
        if brackets + dots > DEEPEST:
            raise InputError(
                f"{source} cannot be read: its tables and lists nest deeper than {DEEPEST}."
            )


def _check_values(values: Any, source: str | Path) -> None:
    """Refuse text that no file name or message can hold, and whole numbers beyond 64 bits."""
    left = [values]
    while left:
        value = left.pop()
        if isinstance(value, dict):
            left += [*value.keys(), *value.values()]
        elif isinstance(value, list):
            left += value
        elif isinstance(value, str) and _is_odd(value):
            raise InputError(
                f"{source} cannot be used: a text in it holds a null byte or half a character, "
                f"{value[:40]!r}."
            )
        elif isinstance(value, int) and not -(2**63) <= value < 2**63:
            raise InputError(f"{source} cannot be used: it holds a whole number beyond 64 bits.")


def _is_odd(text: str) -> bool:
    return "\0" in text or any("\ud800" <= letter <= "\udfff" for letter in text)
