"""The benchmark: every refocusing system on the same light fields, by the same measures.

The reference is shift-and-sum of all views (at RefNet's slopes the Fourier slice, too). All systems
refocus from views in memory to images in memory, on all cores; each is timed in a process of its
own, whose peak memory is what it takes.
"""

import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pandas as pd

from experiments.command_parts import step_bar
from experiments.report import write_report
from experiments.systems import report
from experiments.systems.compared_sets import Scene, TestSet
from experiments.systems.cost import measure_cost
from experiments.systems.entries import Entry
from experiments.systems.figures import figure, noise_figure
from experiments.systems.learning import learning_figure, learning_table
from lf_flame.errors import InputError
from lf_flame.learning.scores import score
from lf_flame.systems.base import RefocusingSystem

COLUMNS = [
    "test_set", "truth", "electrons", "system", "views", "slope", "plane", "psnr_db", "psnr_sd",
    "psnr_foreground_db", "psnr_foreground_sd", "ssim", "ssim_sd", "light_fields", "why_missing",
]  # fmt: skip


def score_systems(systems: dict, test_set: TestSet) -> pd.DataFrame:
    """Score systems on a test set, plane by plane; columns as in `COLUMNS`.

    A system that refuses a set shows as missing there, with its own words; so does an InputError in
    its place.
    """
    refused = {name: str(one) for name, one in systems.items() if isinstance(one, InputError)}
    truths, drawn = [], {name: [] for name in systems}
    for scene in test_set.scenes():
        truths.append(_inner(scene.truth(test_set.truth), scene.border))
        for name in set(systems) - set(refused):
            try:
                images = systems[name].refocus(scene.views, scene.slopes, scene.block)
                drawn[name].append(_inner(images, scene.border))
            except InputError as error:
                refused[name] = str(error)
    tables = []
    for name, system in systems.items():
        if name in refused:
            tables.append(_missing(test_set, name, refused[name]))
            continue
        table = score(np.stack(truths), np.stack(drawn[name]))
        table = table.rename(columns={"n_test": "light_fields"}).assign(
            test_set=test_set.name, truth=test_set.truth, electrons=test_set.electrons,
            system=name, views=len(set(system.view_indices(*scene.views.shape[:2]))),
            slope=scene.slopes / scene.block[0], plane=test_set.planes, why_missing="",
        )  # fmt: skip
        tables.append(table[COLUMNS])
    return pd.concat(tables, ignore_index=True)


def _missing(test_set: TestSet, name: str, reason: str) -> pd.DataFrame:
    row = {"test_set": test_set.name, "truth": test_set.truth, "electrons": test_set.electrons}
    row |= {"system": name, "why_missing": reason}
    return pd.DataFrame([row]).reindex(columns=COLUMNS)


def _inner(stack: np.ndarray, border: int) -> np.ndarray:
    return stack[:, border:-border, border:-border] if border else stack


def run_benchmark(entries: Sequence[Entry], test_sets: Sequence[TestSet], out: Path) -> Path:
    """Let systems refocus test sets, and write the report.

    The first scene of the first test set is the frame that systems are timed on.
    """
    _refuse_same_names(entries, test_sets)
    started = time.perf_counter()
    frame = next(test_sets[0].scenes())
    results = _compete(entries, test_sets, frame)
    results = list(step_bar(results, len(entries) + len(test_sets)))
    scores = pd.concat([x for x in results if isinstance(x, pd.DataFrame)], ignore_index=True)
    costs = pd.DataFrame([x for x in results if isinstance(x, dict)])
    record = {
        "systems": {one.name: one.about for one in entries},
        "test_sets": {one.name: one.origin for one in test_sets},
        "frame": {
            "planes": len(frame.slopes),
            "image": " x ".join(str(n) for n in frame.truth().shape[1:]),
            "views": " x ".join(str(n) for n in frame.views.shape[:2]),
        },
        "wall_s": round(time.perf_counter() - started, 1),
    }
    clean, dark = report.without_noise(scores), scores[np.isfinite(scores.electrons)]
    tables = {"compare": scores.round(5), "systems": costs.round(3)}
    pictures = {"compare": figure(clean, costs)}
    if len(dark):
        pictures["compare_noise"] = noise_figure(dark)
    learnt = learning_table(record["systems"])
    if len(learnt):
        tables["learning"] = learnt.round(3)
        pictures["compare_learning"] = learning_figure(record["systems"])
    return write_report(
        out, "compare", "Refocusing systems side by side", record,
        report.body(scores, costs, record), tables=tables, pictures=pictures,
    )  # fmt: skip


def _refuse_same_names(entries, test_sets: Sequence[TestSet]) -> None:
    for kind, names in (
        ("test sets", [(one.name, one.truth, one.electrons) for one in test_sets]),
        ("systems", [(one.name,) for one in entries]),
    ):
        for name in names:
            if names.count(name) > 1:
                raise InputError(f"Two {kind} are called {name[0]!r}; compare one at a time.")


def _compete(entries, test_sets, frame: Scene) -> Iterator[pd.DataFrame | dict]:
    """Yield what each system takes, then the scores of all on each test set."""
    loaded = {}
    for one in entries:
        loaded[one.name] = _loaded(one)
        yield _described(one, loaded[one.name], frame)
    for test_set in test_sets:
        systems = dict(loaded)
        for one in entries:
            if not test_set.name.startswith(one.only):
                systems[one.name] = InputError(f"it was trained on {one.only}.")
        yield score_systems(systems, test_set)


def _loaded(entry: Entry) -> RefocusingSystem | InputError:
    try:
        return entry.load()
    except InputError as error:
        return error


def _described(entry: Entry, system, frame: Scene) -> dict:
    row = {"system": entry.name, "views": np.nan, "parameters": np.nan, "steps": np.nan}
    row |= {"training_s": np.nan, "milliseconds": np.nan, "memory_mb": np.nan}
    if isinstance(system, InputError):
        return row
    row["parameters"] = system.parameters
    row |= {
        column: entry.about.get(name, np.nan)
        for column, name in (("steps", "steps"), ("training_s", "seconds"))
    }
    try:
        row["views"] = len(set(system.view_indices(*frame.views.shape[:2])))
        system.refocus(frame.views, frame.slopes, frame.block)
    except InputError:
        return row
    return row | asdict(measure_cost(entry.load, frame.views, frame.slopes, frame.block))
