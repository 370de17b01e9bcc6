"""Strict reading of TOML files into the package's configuration dataclasses.

Pydantic checks types and keys; the dataclasses check ranges themselves. Whatever goes wrong
becomes one sentence that names the file and the key.
"""

import dataclasses
import json
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from pydantic import TypeAdapter, ValidationError

from lf_flame.errors import InputError

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

T = TypeVar("T")


def read_toml(path: str | Path) -> dict[str, Any]:
    """Parse a TOML file.

    Raises
    ------
    InputError
        If the file is missing or is not TOML.
    """
    try:
        return tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}.") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path} is not a TOML file: {error}.") from None


def read_record(path: str | Path) -> dict[str, Any]:
    """Parse a JSON record that one of the programs wrote.

    Raises
    ------
    InputError
        If the file is missing or is no such record.
    """
    try:
        record = json.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}.") from None
    except ValueError as error:
        raise InputError(f"{path} is not a JSON file: {error}.") from None
    if not isinstance(record, dict):
        raise InputError(f"{path} is no record: it must hold names and values.")
    return record


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


def to_json(config: "DataclassInstance") -> dict[str, Any]:
    """Turn a configuration dataclass into plain JSON values: the form in which it is stored."""
    return json.loads(json.dumps(dataclasses.asdict(config)))


def _first_problem(error: ValidationError) -> str:
    # A misspelt key is reported before the key that is missing because of it.
    unknown = ("unexpected_keyword_argument", "extra_forbidden")
    problem = min(error.errors(), key=lambda problem: problem["type"] not in unknown)
    key = ".".join(str(part) for part in problem["loc"])
    if problem["type"] in unknown:
        return f"{key} is not a known key."
    if problem["type"] in ("missing", "missing_argument", "missing_keyword_only_argument"):
        return f"{key} is missing."
    if problem["type"] == "value_error":  # raised by the dataclass itself, a sentence already
        return f"{key}: {problem['ctx']['error']}" if key else str(problem["ctx"]["error"])
    text = problem["msg"][0].lower() + problem["msg"][1:]
    return f"{key}: {text}, got {problem['input']!r}."
