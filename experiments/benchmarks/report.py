"""What the benchmarks share: the command line, and the files of a table."""

import argparse
from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from experiments.beside_reference import show
from experiments.report import Format, markdown, write_report
from experiments.timing import Times


def command_line(doc: str, small: bool = True) -> argparse.ArgumentParser:
    """Make the options that all benchmarks have, from the docstring of a program."""
    parser = argparse.ArgumentParser(description=doc.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results/benchmarks"))
    if small:
        parser.add_argument("--small", action="store_true", help="small inputs, to try the program")
    return parser


def table_of(rows: Sequence[dict], columns: dict[str, tuple[str, Format]]) -> str:
    """Write rows as Markdown; columns that the rows of an older record lack are left out."""
    known = {name: columns[name] for name in columns if any(name in row for row in rows)}
    return markdown(rows, known, missing="-")


def ratio(times: Times, call: int, other: int, factor: float = 1.0) -> dict:
    """Columns of a row: how the times of two calls relate, and the quartiles over the rounds."""
    median, low, high = (factor * value for value in times.ratio(call, other))
    return {"ratio": median, "quartiles": f"{low:.3g} to {high:.3g}"}


def finish(
    out: Path, name: str, title: str, record: dict, columns: dict, notes: Sequence[str]
) -> None:
    """Write the report of a record, whose ``rows`` are the table, and print it."""
    body = [table_of(record["rows"], columns), *notes]
    tables = {name: pd.DataFrame(record["rows"])}
    show(write_report(out, name, title, record, body, tables=tables), "benchmarks")
