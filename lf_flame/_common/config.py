"""Strict checking of parsed values against dataclasses: configurations, and stored records.

Pydantic checks types and keys; the dataclasses check ranges themselves. Each error becomes one
sentence that names the file and the key.
"""

import dataclasses
import difflib
import json
import reprlib
import typing
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from lf_flame.errors import InputError

if TYPE_CHECKING:
    from _typeshed import DataclassInstance
    from pydantic import ValidationError

T = TypeVar("T")

UNKNOWN, MISSING = "unexpected_keyword_argument", "missing"
"""Pydantic's error types for a key of a dataclass that is unknown, or missing."""


def strict(cls: type[T]) -> type[T]:
    """Make `build` refuse unknown keys of a configuration dataclass."""
    cls.__pydantic_config__ = {"extra": "forbid"}  # type: ignore[attr-defined]
    return cls


def build(kind: type[T], values: Any, source: str | Path) -> T:
    """Make a dataclass from parsed TOML or JSON; `source` is its origin.

    Types are strict: a number in quotes is refused. The error names unknown keys (of `strict`
    classes) with similar known ones, and missing ones; else the first other fault.
    """
    from pydantic import TypeAdapter, ValidationError  # a camera alone needs none of it

    # As JSON, a list may become a tuple; a strict check of Python values refuses that.
    text = json.dumps(values, default=str)
    try:
        return TypeAdapter(kind).validate_json(text, strict=True)
    except ValidationError as error:
        raise InputError(f"{source}: {_first_problem(error, kind)}") from None


def to_json(config: "DataclassInstance") -> dict[str, Any]:
    """Turn a configuration dataclass into plain JSON values: the form in which it is stored."""
    return json.loads(json.dumps(dataclasses.asdict(config)))


def _first_problem(error: "ValidationError", kind: type) -> str:
    problems = error.errors()
    odd = [one for fault in (UNKNOWN, MISSING) for one in problems if one["type"] == fault]
    if odd:
        return "; ".join(_key_error(one, kind) for one in odd) + "."
    problem = problems[0]
    key = _shown(problem["loc"])
    if problem["type"] == "value_error":  # raised by the dataclass itself, a sentence already
        return f"{key}: {problem['ctx']['error']}" if key else str(problem["ctx"]["error"])
    text = problem["msg"][0].lower() + problem["msg"][1:]
    return f"{key}{': ' * bool(key)}{text}, got {reprlib.repr(problem['input'])}."


def _shown(place: tuple[int | str, ...]) -> str:
    """Name a place: keys joined by dots, entries of a list counted from 1 as "layers #1"."""
    parts = [f" #{x + 1}" if isinstance(x, int) else f".{reprlib.repr(x)[1:-1]}" for x in place]
    return "".join(parts).removeprefix(".")


def _key_error(problem: Any, kind: type) -> str:
    """Say that a key is missing, or unknown, with the similar known ones."""
    place, name = problem["loc"], _shown(problem["loc"])
    if problem["type"] == MISSING:
        return f"{name} is missing"
    known = _known_keys(kind, place[:-1])
    near = difflib.get_close_matches(str(place[-1])[:100], known, n=2)
    hint = f"perhaps {' or '.join(near)}" if near else f"known keys: {', '.join(known)}"
    return f"{name} is not a known key" + (f" ({hint})" if known else "")


def _known_keys(kind: Any, place: tuple[int | str, ...]) -> list[str]:
    """Names of the fields of a dataclass, or of the dataclass nested at `place`."""
    if typing.get_origin(kind) is not None:  # an optional, a list or a dict
        inner = [one for one in typing.get_args(kind) if one not in (type(None), str, ...)]
        is_container = typing.get_origin(kind) in (list, tuple, dict)
        return _known_keys(inner[0], place[is_container:]) if inner else []
    if not dataclasses.is_dataclass(kind):
        return []
    hints = typing.get_type_hints(kind)
    return _known_keys(hints.get(str(place[0])), place[1:]) if place else list(hints)
