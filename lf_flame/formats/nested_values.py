"""Values in nested tables of a file, found by paths of names."""

from pathlib import Path
from typing import Any

from lf_flame.errors import InputError

MOST = 1000
"""Largest number of tables of a list that are looked at."""


def tables(found: Any) -> list[dict[str, Any]]:
    """Tables in a list; none in anything else."""
    return [one for one in found[:MOST] if isinstance(one, dict)] if isinstance(found, list) else []


class NestedValues:
    """Values in nested tables, each at the first of several paths that leads to one."""

    def __init__(self, values: dict[str, Any], source: str | Path):
        self.values, self.source = values, source

    def find(self, *paths: str) -> Any:
        """Find the value at the first path (names and slashes) that leads to one, or None."""
        for path in paths:
            value: Any = self.values
            for name in path.split("/"):
                value = value.get(name) if isinstance(value, dict) else None
            if value is not None:
                return value
        return None

    def text(self, *paths: str) -> str:
        """Find a text, or an empty one if there is none."""
        value = self.find(*paths)
        return value.strip() if isinstance(value, str) else ""

    def number(self, *paths: str) -> float | None:
        """Find a number, or None if there is none."""
        value = self.find(*paths)
        if value is None:
            return None
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise self.error(paths[0], "must be a number", value)
        return float(value)

    def within(self, low: float, high: float, *paths: str) -> float:
        """Find a number within limits, which must be stated."""
        value = self.number(*paths)
        if value is None or not low <= value <= high:
            raise self.error(paths[0], f"must be a number from {low:g} to {high:g}", value)
        return value

    def error(self, path: str, says: str, value: Any) -> InputError:
        """Error that names the file and the path of a value."""
        got = "nothing" if value is None else repr(value)[:60]
        return InputError(f"{self.source}: {path} {says}, got {got}.")
