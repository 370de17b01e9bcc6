"""The report on emission by depth: its parts, which are measured together or one by one."""

import json
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from experiments.emission import flames
from experiments.report import markdown, write_report
from lf_flame._common import provenance

ROUND = """The axis is found, too. Errors are root-mean-square over the volume between 3 and 97 % of the
flame's height, relative to the truth. PyAbel gets the penalty of least true error."""
"""Text of the part on axisymmetric flames."""

Table = Callable[[np.random.Generator], Iterator[dict]]


def tables(part: str, draws: int) -> dict[str, Table]:
    """Name the tables of a part and what measures them."""
    return {
        "round": {
            "Axisymmetric flame": flames.round_flame,
            "A printed profile": flames.beside_print,
        },
        "soot": {"Soot temperature": flames.soot},
    }[part]


def run(out: Path, parts: list[str], seed: int, draws: int) -> Path:
    """Measure parts; those that OUT/emission.json already has, and that are not asked for, stay."""
    path = out / "emission.json"
    done = json.loads(path.read_text(encoding="utf-8"))["parts"] if path.is_file() else {}
    for part in parts:
        began, rng = time.perf_counter(), np.random.default_rng(seed)
        rows = {name: list(measure(rng)) for name, measure in tables(part, draws).items()}
        made = {key: provenance.environment()[key] for key in ("command", "date")}
        done[part] = made | {"seconds": round(time.perf_counter() - began), "tables": rows}
        path = write(out, done)
    return path


def write(out, done):
    out.mkdir(parents=True, exist_ok=True)
    (out / "emission.json").write_text(json.dumps({"parts": done}, indent=1))
    return out / "emission.json"
