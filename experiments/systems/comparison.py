"""The comparison: every refocusing system on the same light fields, by the same measures.

All systems refocus from views in memory to images in memory, on all cores. Each is timed in a
process of its own. Every row states the number of views that the system receives, and the steps and
seconds of its training.
"""

import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from experiments.report import markdown, panels, step_bar, write_report
from experiments.systems.compared import Entry, Scene, TestSet
from experiments.timing import measure_cost
from lf_flame.errors import InputError
from lf_flame.learning.scores import score
from lf_flame.systems.base import RefocusingSystem
from lf_flame.systems.resnet50 import ResNet50

COLUMNS = [
    "test_set", "system", "views", "slope", "plane", "psnr_db", "psnr_sd",
    "psnr_foreground_db", "psnr_foreground_sd", "ssim", "ssim_sd", "light_fields", "why_missing",
]  # fmt: skip

PANELS = {"flames": "flames", "flames, order reversed": "flames at other depths"}
"""Test sets that are drawn, with their titles, besides the photographs."""

PSNR_RANGE = (20.0, 70.0)
"""Range of PSNR in the figure; a triangle at the edge marks values outside it."""


def score_systems(systems: dict, test_set: TestSet) -> pd.DataFrame:
    """Score systems on a test set, plane by plane; columns as in `COLUMNS`.

    The row of a system that refuses the set has the reason; an InputError may take its place.
    """
    refused = {name: str(one) for name, one in systems.items() if isinstance(one, InputError)}
    references, refocused = [], {name: [] for name in systems}
    for scene in test_set.scenes():
        inner = slice(scene.border, -scene.border or None)
        references.append(scene.reference()[:, inner, inner])
        for name in set(systems) - set(refused):
            try:
                images = systems[name].refocus(scene.views, scene.slopes, scene.block)
                refocused[name].append(images[:, inner, inner])
            except InputError as error:
                refused[name] = str(error)
    tables = []
    for name, system in systems.items():
        if name in refused:
            table = pd.DataFrame([{"why_missing": refused[name]}])
        else:
            table = score(np.stack(references), np.stack(refocused[name]))
            table = table.rename(columns={"n_test": "light_fields"}).assign(
                views=len(set(system.view_indices(*scene.views.shape[:2]))),
                slope=scene.slopes / scene.block[0], plane=test_set.planes, why_missing="",
            )  # fmt: skip
        table = table.assign(system=name, test_set=test_set.name)
        tables.append(table.reindex(columns=COLUMNS))
    return pd.concat(tables, ignore_index=True)


def run_comparison(entries: Sequence[Entry], test_sets: Sequence[TestSet], out: Path) -> Path:
    """Let systems refocus test sets, and write the report.

    The first scene of the first test set is the frame that systems are timed on.
    """
    names = [one.name for one in test_sets]
    if twice := {name for name in names if names.count(name) > 1}:
        raise InputError(f"Two test sets are called {twice.pop()!r}; compare one at a time.")
    started, frame = time.perf_counter(), next(test_sets[0].scenes())
    results = step_bar(_measure_and_score(entries, test_sets, frame), len(entries) + len(test_sets))
    results = list(results)
    scores = pd.concat([x for x in results if isinstance(x, pd.DataFrame)], ignore_index=True)
    systems = pd.DataFrame([x for x in results if isinstance(x, dict)])
    systems = with_equal_effort(systems, {one.name: one.about for one in entries})
    record = {
        "systems": {one.name: one.about for one in entries},
        "test_sets": {one.name: one.origin for one in test_sets},
        "frame": {
            "planes": len(frame.slopes),
            "image": " x ".join(str(n) for n in frame.reference().shape[1:]),
            "views": " x ".join(str(n) for n in frame.views.shape[:2]),
        },
        "wall_s": round(time.perf_counter() - started, 1),
    }
    return write_report(
        out, "compare", "Refocusing systems side by side", record, body(scores, systems, record),
        tables={"compare": scores.round(5), "systems": systems.round(3)},
        pictures={"compare": figure(scores, systems)},
    )  # fmt: skip


def _measure_and_score(entries, test_sets, frame: Scene) -> Iterator[pd.DataFrame | dict]:
    """Yield budget and cost of each system, then the scores of all on each test set."""
    loaded = {}
    for one in entries:
        try:
            loaded[one.name] = one.load()
        except InputError as error:
            loaded[one.name] = error
        yield _describe(one, loaded[one.name], frame)
    for test_set in test_sets:
        systems = dict(loaded)
        for one in entries:
            if not test_set.name.startswith(one.only):
                systems[one.name] = InputError(f"it was trained on {one.only}.")
        yield score_systems(systems, test_set)


def _describe(entry: Entry, system: RefocusingSystem | InputError, frame: Scene) -> dict:
    row = {"system": entry.name, "views": np.nan, "parameters": np.nan}
    row |= {"steps": entry.about.get("steps", np.nan)}
    row |= {"training_s": entry.about.get("seconds", np.nan)}
    row |= {"milliseconds": np.nan, "memory_mb": np.nan}
    if isinstance(system, InputError):
        return row
    row["parameters"] = system.parameters
    try:
        row["views"] = len(set(system.view_indices(*frame.views.shape[:2])))
        system.refocus(frame.views, frame.slopes, frame.block)
    except InputError:
        return row
    return row | measure_cost(entry.load, frame.views, frame.slopes, frame.block)


def with_equal_effort(systems: pd.DataFrame, about: dict[str, dict]) -> pd.DataFrame:
    """Add PSNR on held-out samples after the seconds, and the steps, that all systems had.

    ``at_seconds`` and ``at_steps`` are those of the system that stopped first. The best weights are
    kept, so a later, worse epoch does not lower the PSNR.
    """
    curves = {name: one["curve"] for name, one in about.items() if "curve" in one}
    table = systems.copy()
    for axis in ("seconds", "steps"):
        limit = min((curve[axis][-1] for curve in curves.values()), default=np.nan)
        reached = {
            name: max(
                (
                    psnr
                    for at, psnr in zip(curve[axis], curve["psnr_db"], strict=True)
                    if at <= limit + 1e-6
                ),
                default=np.nan,  # the first epoch of another network took less
            )
            for name, curve in curves.items()
        }
        table[f"after_{axis}_db"] = table.system.map(reached)
        table[f"at_{axis}"] = np.where(table.system.isin(curves), limit, np.nan)
    return table


def body(scores: pd.DataFrame, systems: pd.DataFrame, record: dict) -> list[str]:
    """Write scores and budgets as Markdown, fewest views first."""
    frame, systems = record["frame"], systems.sort_values("views", kind="stable")
    known = systems[systems.parameters.notna()]
    seconds, steps = systems.at_seconds.max(), systems.at_steps.max()
    budgets = {
        "system": ("system", ""),
        "views": ("views", ".0f"),
        "parameters": ("parameters", ",.0f"),
        "steps": ("steps", ",.0f"),
        "training_s": ("training (s)", ",.0f"),
        "after_seconds_db": (f"dB after {seconds:,.0f} s", ".2f"),
        "after_steps_db": (f"dB after {steps:,.0f} steps", ".2f"),
        "milliseconds": ("ms a frame", ".1f"),
        "memory_mb": ("memory (MB)", ".0f"),
    }
    if np.isnan(seconds):  # no network was trained
        del budgets["after_seconds_db"], budgets["after_steps_db"]
    return [
        "PSNR in dB (peak 1) and SSIM against shift-and-sum of all views, means over planes and "
        "light fields; every plane is in compare.csv.",
        "## Equal seconds and equal inputs",
        *_fairness(systems),
        markdown(known, budgets),
        "Steps are those of the optimiser. Seconds are those of the median epoch times the number "
        "of epochs, without drawing the training samples. The two columns in dB are the PSNR on "
        "whole held-out training samples, best epoch so far, after the seconds and after the steps "
        "that all networks had; RefNet's is at its own sixteen slopes, that of the others at six "
        "random ones, and for most the learning rate falls to zero at their last step. "
        f"Milliseconds and peak memory are for {frame['planes']} planes of {frame['image']} from "
        f"{frame['views']} views in memory, each system in a process of its own.",
        "## PSNR (dB)",
        _table(scores, systems, "psnr_db", "{:.2f}"),
        "## SSIM",
        _table(scores, systems, "ssim", "{:.3f}"),
        "## What is missing, each reason once",
        _missing(scores),
    ]


def _fairness(systems: pd.DataFrame) -> list[str]:
    """State which systems had equal seconds, and which receive equal inputs."""
    trained, paragraphs = systems[systems.at_seconds.notna()], []
    if len(trained):
        took, steps, views = (
            f"{trained[name].min():,.0f} to {trained[name].max():,.0f}"
            for name in ("training_s", "steps", "views")
        )
        paragraphs.append(
            f"**Equal seconds, not equal steps:** the networks that share one trainer were trained "
            f"for {took} s; in that time they took {steps} steps. Each receives the views of its "
            f"design, {views} of them, and the second U-Net those of ApertureNet."
        )
    return [
        *paragraphs,
        f"**Not equal inputs:** only systems with equal numbers of views receive the same views; "
        f"{ResNet50.name} receives an image made of them. The rows of all tables are in the "
        f"order of the number of views.",
    ]


def _table(scores: pd.DataFrame, systems: pd.DataFrame, measure: str, form: str) -> str:
    """Write a table of means, a row for each system with its budget, a column for each test set."""
    known = scores[scores.groupby("system")[measure].transform("count") > 0]
    means = known.groupby(["system", "test_set"], sort=False)[measure].mean().unstack("test_set")
    in_order = [name for name in systems.system if name in means.index]
    means = means.loc[in_order, scores.test_set.unique()]

    def written(value: float) -> str:
        return "exact" if np.isinf(value) else "-" if np.isnan(value) else form.format(value)

    budget = systems.set_index("system")[["views", "steps", "training_s"]]
    table = budget.join(means, how="right")
    columns = {"system": ("system", ""), "views": ("views", ".0f"), "steps": ("steps", ",.0f")}
    columns |= {"training_s": ("training (s)", ",.0f")}
    columns |= {name: (name, written) for name in means}
    return markdown(table.reset_index(), columns)


def _missing(scores: pd.DataFrame) -> str:
    """List reasons for missing scores, once for each system and the first test set."""
    rows = scores[scores.psnr_db.isna()].drop_duplicates(["system", "why_missing"])
    groups = rows.groupby(["test_set", "why_missing"], sort=False).system
    lines = [f"- {name}: {why} ({'; '.join(some)})" for (name, why), some in groups]
    return "\n".join(lines) or "Nothing."


def figure(scores: pd.DataFrame, systems: pd.DataFrame):
    """Draw PSNR: a row for each system with its budget, the fastest first, a panel a test set."""
    photographs = scores.test_set[scores.plane.astype(str).str.startswith("slope")].unique()
    sets = {name: title for name, title in PANELS.items() if name in set(scores.test_set)}
    sets |= {name: name for name in photographs}
    sets = sets or {scores.test_set[0]: scores.test_set[0]}
    rows = systems[systems.milliseconds.notna()].sort_values("milliseconds")
    size = (5.5 + 2.2 * len(sets), 1.2 + 0.42 * len(rows))
    drawn, axes = panels(list(sets.values()), size, "PSNR (dB)", sharey=True)
    for axis, name in zip(axes, sets, strict=True):
        means = scores[scores.test_set == name].groupby("system")["psnr_db"].mean()
        for place, system in enumerate(rows.system):
            value = means.get(system, np.nan)
            marker = "<" if value < PSNR_RANGE[0] else ">" if value > PSNR_RANGE[1] else "o"
            colour = "tab:orange" if "(ours)" in system else "tab:blue"
            axis.plot(np.clip(value, *PSNR_RANGE), place, marker, color=colour, clip_on=False)
        axis.set_xlim(PSNR_RANGE)
    axes[0].set_yticks(range(len(rows)), [_label(row) for row in rows.itertuples()], fontsize=8)
    axes[0].invert_yaxis()
    return drawn


def _label(row) -> str:
    """Name of a system, its milliseconds, views and training."""
    training = "" if pd.isna(row.steps) else f"; {row.steps:,.0f} steps in {row.training_s:,.0f} s"
    return f"{row.system}\n{row.milliseconds:.3g} ms; {row.views:.0f} views{training}"
