"""Content of a folder of results for its report: records, tables and pictures.

Only regular files that lie directly in the folder are opened, by the names that the folder itself
has; where records list their files, only those. Nothing else that a record says becomes a path.
"""

import csv
import io
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lf_flame._common.checksums import file_sha256
from lf_flame._common.input_files import parse_json, read_text
from lf_flame._common.printable import printable
from lf_flame.errors import InputError

MOST_FILES = 200
"""Largest number of files of a folder that a report reads."""

LARGEST_TABLE = 1 << 23
"""Largest size of a table in bytes."""

INSIDE = ("files", "record_sha256", "earlier")
"""Entries of a record on the files themselves, which are checked and not shown."""


@dataclass(frozen=True)
class Table:
    """A table of a folder, or of a list in a record.

    Attributes
    ----------
    name : str
    columns : list of str
    rows : list of list of str
    """

    name: str
    columns: list[str]
    rows: list[list[str]]


@dataclass
class Folder:
    """Content of a folder.

    Attributes
    ----------
    path : Path
    records : dict of dict
        Records by file name.
    hashes : dict of str
        SHA-256 of each record by its name.
    tables : list of Table
    pictures : list of Path
    names : list of str
        Names of the files that may be opened, the records aside.
    left_out : list of str
        Sentences on files that are not shown.
    """

    path: Path
    records: dict[str, dict[str, Any]] = field(default_factory=dict)
    hashes: dict[str, str] = field(default_factory=dict)
    tables: list[Table] = field(default_factory=list)
    pictures: list[Path] = field(default_factory=list)
    names: list[str] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)


def read_folder(path: Path) -> Folder:
    """Read the records and tables of a folder, and find its pictures.

    Raises
    ------
    InputError
        If the folder holds no record, or more than `MOST_FILES` files.
    """
    found = Folder(path)
    files = sorted(one for one in path.iterdir() if one.is_file() and not one.is_symlink())
    if len(files) > MOST_FILES:
        raise InputError(f"{path} holds {len(files):,} files; a report takes {MOST_FILES} at most.")
    for file in (one for one in files if one.suffix == ".json"):
        _read(found, file, _add_record)
    if not found.records:
        raise InputError(
            f"{path} holds no record of lf-flame: no JSON file that a command writes beside its "
            f"results. Name a folder of results, a training run or a data set."
        )
    listed = {name for record in found.records.values() for name in _listed(record)}
    for file in files:
        if listed and file.name not in listed:
            continue
        found.names.append(file.name)
        if file.suffix == ".csv":
            _read(found, file, _add_table)
        elif file.suffix == ".png":
            found.pictures.append(file)
    return found


def _listed(record: dict[str, Any]) -> list[str]:
    files = record.get("files")
    return [one for one in files if isinstance(one, str)] if isinstance(files, (dict, list)) else []


def _read(found: Folder, file: Path, add: Any) -> None:
    """Add a file; if it cannot be read, the report says so and goes on."""
    try:
        add(found, file)
    except (InputError, OSError, csv.Error) as error:
        found.left_out.append(printable(f"{file.name} is not shown: {error}", 400))


def _add_record(found: Folder, file: Path) -> None:
    record = parse_json(read_text(file), file)
    if isinstance(record, dict):
        found.hashes[file.name] = file_sha256(file)
        found.records[file.name] = record


def _add_table(found: Folder, file: Path) -> None:
    lines = list(csv.reader(io.StringIO(read_text(file, LARGEST_TABLE))))
    if len(lines) > 1 and all(len(line) == len(lines[0]) for line in lines):
        found.tables.append(Table(file.name, lines[0], lines[1:]))
    else:
        found.left_out.append(f"{file.name} is not shown: it is no table of equal rows.")


def facts_of(record: dict[str, Any], above: str = "") -> list[tuple[str, str]]:
    """Single values of a record with their names, also of tables in it: ``camera.views``."""
    facts = []
    for key, value in record.items():
        name = f"{above}{key}"
        if key in INSIDE and not above:
            continue
        if isinstance(value, dict):
            facts += facts_of(value, f"{name}.")
        elif not isinstance(value, list):
            facts.append((printable(name), written(value)))
        elif value and len(value) <= 12 and not any(map(_is_nested, value)):
            facts.append((printable(name), ", ".join(map(written, value))))
    return facts


def tables_of(record: dict[str, Any], above: str = "") -> list[Table]:
    """Make tables of the lists of equal entries in a record."""
    tables = []
    for key, value in record.items():
        name = f"{above}{key}"
        if key in INSIDE and not above:
            continue
        if isinstance(value, dict):
            tables += tables_of(value, f"{name}.")
        elif isinstance(value, list) and value and all(isinstance(x, dict) and x for x in value):
            every = dict.fromkeys(column for row in value for column in row)
            columns = [x for x in every if not any(_is_nested(row.get(x)) for row in value)]
            rows = [[written(row.get(column, "")) for column in columns] for row in value]
            tables += [Table(printable(name), columns, rows)] if columns else []
    return tables


def _is_nested(value: Any) -> bool:
    return isinstance(value, (dict, list))


def written(value: Any) -> str:
    """Value for a reader: six digits of a number, and one line of a text."""
    if isinstance(value, bool) or value is None:
        return {True: "yes", False: "no", None: "none"}[value]
    return f"{value:.6g}" if isinstance(value, float) else printable(value, 300)
