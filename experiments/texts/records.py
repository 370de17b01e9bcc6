"""Numbers of the committed records, found by what stands beside them."""

import csv
import json
import tomllib
from collections.abc import Callable, Sequence
from functools import lru_cache
from pathlib import Path
from statistics import fmean, median
from typing import Any

from experiments.paths import EXPERIMENTS
from lf_flame.errors import InputError

OF_SEVERAL: dict[str, Callable[[Sequence[float]], float]] = {
    "mean": fmean,
    "median": median,
    "largest": max,
    "smallest": min,
    "sum": sum,
}


def look_up(source: dict[str, Any], folder: Path = EXPERIMENTS) -> float:
    """Find the number that a source describes.

    Parameters
    ----------
    source : dict
        ``record``: a file, by its path below `folder`. Of a CSV file, ``row``: what its columns
        hold in one row and no other, or ``rows``, whose mean is meant, and ``column``. Of a JSON or
        TOML file, ``at``: the way to the number, keys and places; a table stands for the one entry
        of a list that holds what it says. Or ``mean``, ``median``, ``largest``, ``smallest`` or
        ``sum``: of a list of sources. Or ``number``, which stands for itself.
        Then, if they are there and in this order, ``less`` and ``over``, sources too, are
        subtracted and divided by, and ``times``, a number, is multiplied with.
    folder : Path, optional

    Raises
    ------
    InputError
        If there is no such number, or more than one.
    """
    number = _found(source, folder)
    if "less" in source:
        number -= look_up(source["less"], folder)
    if "over" in source:
        number /= look_up(source["over"], folder)
    return number * source.get("times", 1)


def _found(source: dict[str, Any], folder: Path) -> float:
    for name, reduce in OF_SEVERAL.items():
        if name in source:
            return reduce([look_up(one, folder) for one in source[name]])
    if "number" in source:
        return source["number"]
    record = source["record"]
    content = _read(folder / record)
    if "rows" in source:
        rows = [row for row in content if _holds(row, source["rows"])]
        if not rows:
            raise InputError(f"{record} has no entries with {source['rows']}.")
        return fmean(_as_number(row.get(source["column"]), source) for row in rows)
    if "row" in source:
        found = _only([row for row in content if _holds(row, source["row"])], source["row"], record)
        found = found.get(source["column"])
    else:
        found = content
        for step in source["at"]:
            found = _step(found, step, record)
    return _as_number(found, source)


def _as_number(found: Any, source: dict[str, Any]) -> float:
    try:
        return float(found)
    except (TypeError, ValueError):
        raise InputError(
            f"{source['record']} holds no number there: {found!r}, for {source}."
        ) from None


def _step(content: Any, step: Any, record: str) -> Any:
    if isinstance(step, dict):
        return _only([one for one in content if _holds(one, step)], step, record)
    try:
        return content[step]
    except (KeyError, IndexError, TypeError):
        raise InputError(f"{record} holds no {step!r} there.") from None


def _holds(entry: dict[str, Any], wanted: dict[str, Any]) -> bool:
    return all(_same(entry.get(name), value) for name, value in wanted.items())


def _same(held: Any, wanted: Any) -> bool:
    """Compare what a table holds, in a CSV file always text, with what is wanted."""
    if isinstance(held, str) and isinstance(wanted, int | float):
        try:
            return float(held) == wanted
        except ValueError:
            return False
    return held == wanted


def _only(found: list, wanted: dict[str, Any], record: str) -> Any:
    if len(found) != 1:
        raise InputError(f"{record} has {len(found)} entries with {wanted}, and one is meant.")
    return found[0]


@lru_cache
def _read(path: Path) -> Any:
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".csv":
        return list(csv.DictReader(text.splitlines()))
    return tomllib.loads(text) if path.suffix == ".toml" else json.loads(text)
