"""Parts that benchmarks share: the command line, programs in another Python, files of a table."""

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from pathlib import Path

import numpy as np
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


def run_cases(doc: str, make_cases: Callable, measure: Callable) -> tuple[argparse.Namespace, dict]:
    """Measure cases beside programs in a Python of their own, where ``--baselines`` names one.

    Returns what was asked for on the command line, and the record.
    """
    parser, rows = command_line(doc), []
    parser.add_argument(
        "--baselines", type=Path, help="Python in which baselines.txt is installed; default: none"
    )
    asked = parser.parse_args()
    if asked.baselines and not shutil.which(asked.baselines):
        parser.error(f"--baselines must be a Python interpreter, got {asked.baselines}")
    with OtherPython(asked.baselines) if asked.baselines else nullcontext() as other:
        for case in make_cases(asked.small):
            sys.stderr.write(f"measuring: {case.what}\n")
            rows += measure(case, asked.small, other)
    return asked, {"rows": rows, "baselines": other.versions if other else {}}


class OtherPython:
    """The program `baselines.py` in another interpreter; `versions` says what that has."""

    def __init__(self, python: Path):
        self.python = python

    def __enter__(self):
        self._folder = tempfile.TemporaryDirectory()
        program = Path(__file__).with_name("baselines.py")
        self._process = subprocess.Popen(
            [self.python, program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self.versions = self._answer()
        return self

    def __exit__(self, *_):
        self._process.stdin.close()
        self._process.stdout.close()
        self._process.wait()
        self._folder.cleanup()

    def refocus(self, package: str, views: np.ndarray, slopes) -> np.ndarray:
        """Hand over a light field and get it refocused."""
        return self._hand_over({"tool": package, "slopes": slopes}, "views", views)

    def decode(self, raw: np.ndarray, centres: list[list[float]], views: int) -> np.ndarray:
        """Hand over a raw image with its lenslets, (y, x, row, column), and get views."""
        return self._hand_over({"tool": "decoding", "centres": centres, "views": views}, "raw", raw)

    def seconds(self, package: str) -> float:
        """Time that it takes to do so once more."""
        return self._ask({"tool": package})["seconds"]

    def _hand_over(self, request: dict, name: str, array: np.ndarray) -> np.ndarray:
        given, out = (str(Path(self._folder.name, f"{x}.npy")) for x in (name, "out"))
        np.save(given, array)
        self._ask({name: given} | request | {"out": out})
        return np.load(out)

    def _ask(self, request: dict) -> dict:
        self._process.stdin.write(json.dumps(request) + "\n")
        self._process.stdin.flush()
        return self._answer()

    def _answer(self) -> dict:
        line = self._process.stdout.readline()
        if not line:
            sys.exit("The baselines' Python stopped; what it wrote stands above.")
        return json.loads(line)


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
