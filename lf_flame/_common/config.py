"""Strict checking of parsed values against dataclasses: configurations, and stored records.

Pydantic checks types and keys; the dataclasses check ranges themselves. Whatever goes wrong
becomes one sentence that names the file and the key.
"""

import dataclasses
import json
import reprlib
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from pydantic import TypeAdapter, ValidationError

from lf_flame._common.input_files import read_record
from lf_flame.errors import InputError

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

T = TypeVar("T")


def build(kind: type[T], values: Any, source: str | Path) -> T:
    """Make a configuration dataclass from parsed values; unknown keys are an error.

    Parameters
    ----------
    kind : type
        A configuration dataclass, `strict` so that unknown keys are an error.
    values : dict
        As parsed from TOML or JSON.
    source : str or Path
        Where the values come from, for the message.

    Raises
    ------
    InputError
        One sentence on the first thing that is wrong.
    """
    try:
        return TypeAdapter(kind).validate_python(values)
    except ValidationError as error:
        raise InputError(f"{source}: {_first_problem(error)}") from None


def load_record(kind: type[T], path: str | Path) -> T:
    """Read a JSON record that one of the programs wrote as the dataclass that it must fit.

    Types are taken as they stand: a number in quotes is no number.

    Raises
    ------
    InputError
        If the file cannot be read, or a value is missing or of another type.
    """
    return build_record(kind, read_record(path), path)


def build_record(kind: type[T], values: Any, source: str | Path) -> T:
    """Make a dataclass from parsed JSON values, their types as they stand; else as `build`."""
    try:
        # As JSON, whose lists may be tuples; of Python's own a strict check refuses that.
        return TypeAdapter(kind).validate_json(json.dumps(values), strict=True)
    except ValidationError as error:
        raise InputError(f"{source}: {_first_problem(error)}") from None


def to_json(config: "DataclassInstance") -> dict[str, Any]:
    """Turn a configuration dataclass into plain JSON values: the form in which it is stored."""
    return json.loads(json.dumps(dataclasses.asdict(config)))


def _first_problem(error: ValidationError) -> str:
    # A misspelt key is reported before the key that is missing because of it.
    unknown = ("unexpected_keyword_argument", "extra_forbidden")
    problem = min(error.errors(), key=lambda problem: problem["type"] not in unknown)
    key = ".".join(reprlib.repr(str(part))[1:-1] for part in problem["loc"])
    if problem["type"] in unknown:
        return f"{key} is not a known key."
    if problem["type"] in ("missing", "missing_argument", "missing_keyword_only_argument"):
        return f"{key} is missing."
    if problem["type"] == "value_error":  # raised by the dataclass itself, a sentence already
        return f"{key}: {problem['ctx']['error']}" if key else str(problem["ctx"]["error"])
    text = problem["msg"][0].lower() + problem["msg"][1:]
    return f"{key}: {text}, got {reprlib.repr(problem['input'])}."
