"""Table and record of the bounds against random scenes (`experiments.bounds.random_scenes`)."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numba
import pandas as pd

from experiments.bounds.random_scenes import ROUNDING, TOLERANCE, measure_scene
from experiments.command_parts import step_bar
from experiments.report import markdown, write_report
from lf_flame._common import provenance
from lf_flame._common.atomic_files import write_json
from lf_flame._common.config import build_record
from lf_flame._common.input_files import read_record
from lf_flame._common.workers import worker_pool

SAVED_EVERY = 10
"""Scenes after which the record is written, so that a stopped run goes on from there."""


def run_bounds(scenes: int, seed: int, out: Path, workers: int = 1) -> Path:
    """Measure random scenes, those that a record in `out` holds left aside, and write the report.

    Processes, the workers, change the time alone.
    """
    path = out / "bounds.json"
    found = _read_scenes(path, seed)[:scenes] if path.exists() else []
    record, done = {"seed": seed, "tolerance": TOLERANCE, "scenes": found}, len(found)
    with worker_pool(workers, numba.set_num_threads, 1) as pool:
        measured = pool.map(partial(measure_scene, seed), range(done, scenes))
        for scene in step_bar(measured, scenes, done):
            found.append(scene)
            if len(found) % SAVED_EVERY == 0:
                write_json(path, record | provenance.environment())
    title = "Bounds against the largest change of a pixel"
    tables = {"bounds": tabulate(found)}
    return write_report(out, "bounds", title, record, body(record), tables=tables)


@dataclass(frozen=True)
class MeasuredEffect:
    """An effect of a scene; no change where an image was refused."""

    effect: str
    bound: float
    change: float | None
    error: float


@dataclass(frozen=True)
class MeasuredScene:
    """A scene, and why it was refused if it was."""

    scene: int
    refused: str | None
    effects: list[MeasuredEffect]


@dataclass(frozen=True)
class BoundsRecord:
    """Entries of an earlier record."""

    seed: int
    scenes: list[MeasuredScene]


def _read_scenes(path: Path, seed: int) -> list[dict]:
    """Read the scenes of an earlier record; none if they were drawn by another seed."""
    values = read_record(path)
    same = build_record(BoundsRecord, values, path).seed == seed
    return values["scenes"] if same else []


def tabulate(found: Sequence[dict]) -> pd.DataFrame:
    """For each effect: how often it was held against its bound, and bound over change.

    Where an effect changes nothing, or rays are not sure of it, there is a number but no ratio.
    """
    lines = [line for scene in found for line in scene["effects"]]
    rows = []
    for effect, group in pd.DataFrame(lines).groupby("effect", sort=False) if lines else ():
        held = group[group.change.notna()].astype({"change": float})
        sure = (held.change > ROUNDING) & (held.error < held.change / 10)
        ratios = (held.bound / held.change)[sure]
        rows.append(
            {
                "effect": effect,
                "number": len(held),
                "smallest": ratios.min(),
                "median": ratios.median(),
                "largest": ratios.max(),
                "refused": len(group) - len(held),
                "violations": int((held.change > held.bound + held.error + ROUNDING).sum()),
            }
        )
    return pd.DataFrame(rows)


COLUMNS = {
    "effect": ("effect", ""),
    "number": ("number", ""),
    "smallest": ("smallest", ".3g"),
    "median": ("median", ".3g"),
    "largest": ("largest", ".3g"),
    "refused": ("refused", ""),
    "violations": ("violations", ""),
}


def body(record: dict) -> list[str]:
    """Write the table, and what it means, as Markdown."""
    found = record["scenes"]
    refused = sum(scene["refused"] is not None for scene in found)
    return [
        f"{len(found)} random scenes, of which {refused} were refused; bound over change, where "
        "the image changed by more than float32 rounds, and rays were off by less than a tenth of "
        "that. An effect was forced on or off against what its scene's plan had decided, all else "
        "left as decided. A violation is a change above the bound and the error of the rays that "
        "showed it.",
        markdown(tabulate(found), COLUMNS, missing="nan"),
    ]
