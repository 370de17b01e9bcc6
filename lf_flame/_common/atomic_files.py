"""Writing files so that none is ever half there."""

import json
import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def atomic_write(path: str | Path) -> Iterator[Path]:
    """Give a path beside the wanted one; rename it when the block ends well, else remove it.

    Parameters
    ----------
    path : str or Path
        Where the file is to be; its folder is made. What stands there stays until the rename.

    Yields
    ------
    Path
        With the same ending, for writers that look at it.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    aside = path.with_name(f".{path.stem}.part{path.suffix}")
    try:
        yield aside
        aside.replace(path)
    finally:
        aside.unlink(missing_ok=True)


def write_text(path: str | Path, text: str) -> None:
    """Write a text file in UTF-8."""
    with atomic_write(path) as aside:
        aside.write_text(text, encoding="utf-8")


def read_json(path: str | Path) -> dict:
    """Read a record that `write_json` wrote."""
    return json.loads(Path(path).read_text(encoding="utf-8"))


def write_json(path: str | Path, record: dict) -> None:
    """Write a record as JSON; which has no infinity and no NaN, so they become null."""
    valid = json.loads(json.dumps(record), parse_constant=lambda name: None)
    write_text(path, json.dumps(valid, indent=1) + "\n")


def finite(row: dict) -> dict:
    """Make JSON values of a row; a bound may be infinite."""
    return {
        key: None if isinstance(value, float) and not math.isfinite(value) else value
        for key, value in row.items()
    }
