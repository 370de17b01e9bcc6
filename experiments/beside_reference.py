"""A user's report with the project's reference result underneath, so that both can be compared."""

import re
from pathlib import Path

import click

from experiments.paths import REFERENCE
from lf_flame._common.atomic_files import write_text

HEADING = "## The reference result"


def is_reference(folder: Path) -> bool:
    """Tell whether a results folder is one of the committed ones."""
    return folder.resolve().is_relative_to(REFERENCE.resolve())


def show(report: Path, folder: str) -> None:
    """Print a report that was just written, with the committed one of a folder underneath."""
    click.echo(set_beside(report, f"{folder}/{report.name}"))


def set_beside(report: Path, name: str) -> str:
    """Put the committed report, by its path below ``experiments/results``, under a user's own.

    Gives the text of both; a reference from before is replaced. Where there is none, or where
    `report` is that file, the report stays as it is.
    """
    text = report.read_text(encoding="utf-8").partition(f"\n{HEADING}")[0]
    reference = REFERENCE / name
    if not reference.is_file() or reference.resolve() == report.resolve():
        return text
    committed = reference.read_text(encoding="utf-8").partition(f"\n{HEADING}")[0]
    committed = re.sub(r"^!\[.*\n?", "", committed, flags=re.M)  # pictures lie elsewhere
    committed = re.sub(r"^(#+) ", r"##\1 ", committed, flags=re.M)
    text = f"{text}\n{HEADING}\n\nAs committed in `experiments/results/{name}`.\n\n{committed}"
    write_text(report, text)
    return text
