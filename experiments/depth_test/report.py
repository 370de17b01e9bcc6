"""Table, text and pictures of the depth permutation test (`experiments.depth_test.permutation`)."""

import math
import re
from collections.abc import Sequence
from pathlib import Path
from textwrap import fill

import pandas as pd

from experiments.report import write_report
from lf_flame._common.config import to_json
from lf_flame._common.figures import subplots


def write(
    config, slopes, subjects: Sequence, outcomes: Sequence, table: pd.DataFrame, out: Path
) -> Path:
    """Write ``depth_test.csv``, ``.md``, ``.json``, and a picture for each scenario."""
    pictures = {}
    for number, outcome in enumerate(outcomes):
        name = "_".join(re.findall(r"\w+", outcome.scenario.name))
        pictures[f"depth_test_{number}_{name}"] = scenario_figure(config, subjects, outcome)
    record = {
        "config": to_json(config),
        "slopes": list(slopes),
        "scenarios": [vars(outcome.scenario) for outcome in outcomes],
        "samples": len(outcomes[0].truth),
        "systems": {subject.name: subject.title for subject in subjects},
        "runs": {subject.name: subject.about for subject in subjects if subject.about},
    }
    return write_report(
        out, "depth_test", f"Depth permutation test: {config.kind}", record,
        body(config, subjects, outcomes, table), tables={"depth_test": table.round(5)},
        pictures=pictures, dpi=90,
    )  # fmt: skip


def body(config, subjects: Sequence, outcomes: Sequence, table: pd.DataFrame) -> list[str]:
    """Write the table, and what it means, as Markdown."""
    scenarios = [outcome.scenario for outcome in outcomes]
    titles = {subject.name: subject.title for subject in subjects}
    means = table[table.depth_mm.isna()].assign(system=lambda rows: rows.system.map(titles))
    return [
        f"PSNR in dB against shift-and-sum of all {config.camera.views**2} views, the "
        f"reference; mean of {len(config.depths_mm)} planes and {len(outcomes[0].truth)} "
        f"scenes that no network was trained on. Behind it the share that a system has memorised: "
        f"0 % what is there, 100 % every object at the depth of its own; beyond these its error "
        f"points the other way. How far that goes, few views show, which blur otherwise than all.",
        _pivot(means, scenarios),
        "SSIM:",
        _pivot(means, scenarios, "ssim"),
        "\n".join(
            f"- {scenario.name}: "
            + ", ".join(
                f"{config.template.objects[k].name} at {scenario.depths_mm[k]:g} mm"
                for k in scenario.present
            )
            for scenario in scenarios
        ),
    ]


def _pivot(means: pd.DataFrame, scenarios: Sequence, measure: str = "psnr_db") -> str:
    form = "{:.2f}" if measure == "psnr_db" else "{:.3f}"
    cells = [
        form.format(value)
        + (f" ({share:.0%})" if measure == "psnr_db" and not math.isnan(share) else "")
        for value, share in zip(means[measure], means.share_memorised, strict=True)
    ]
    shown = means.assign(cell=cells).pivot(index="system", columns="scenario", values="cell")
    shown = shown.loc[means.system.unique(), [scenario.name for scenario in scenarios]]
    sides = ("left", *["right"] * len(scenarios))
    return shown.to_markdown(disable_numparse=True, colalign=sides)


def _label(subject) -> str:
    """Name in words, and what it was trained with, unless the name says so."""
    name = subject.name.replace("-shuffled-depths", "").replace("-", " ")
    name = name.replace("shift and sum", "shift-and-sum")
    return f"{name}, {subject.trained}" if subject.trained else name


def scenario_figure(config, subjects: Sequence, outcome):
    """Draw the first scene of a scenario: the truth, what systems make of it, what was learnt."""
    rows = {"truth: shift-and-sum of all views": outcome.truth[0]}
    rows |= {_label(subject): outcome.drawn[subject.name][0] for subject in subjects}
    if outcome.learnt is not outcome.truth:
        rows["memorised: every object at its own depth"] = outcome.learnt[0]
    planes, height, width = outcome.truth[0].shape
    figure, axes = subplots(
        len(rows), planes, figsize=(2.9 * planes, 0.8 + 2.95 * height / width * len(rows)),
        squeeze=False, layout="constrained",
    )  # fmt: skip
    for axis, depth in zip(axes[0], config.depths_mm, strict=True):
        axis.set_title(f"refocused at {depth:g} mm", fontsize=10)
    for line, (label, images) in zip(axes, rows.items(), strict=True):
        for axis, image in zip(line, images, strict=True):
            axis.imshow(image, cmap="gray", vmin=0, vmax=1)
            axis.set(xticks=[], yticks=[])
        line[0].set_ylabel(fill(label, 18), fontsize=9, rotation=0, ha="right", va="center")
    where = ", ".join(
        f"{config.template.objects[k].name} at {outcome.scenario.depths_mm[k]:g}"
        for k in outcome.scenario.present
    )
    figure.suptitle(f"{outcome.scenario.name}: {where} mm", fontsize=11)
    return figure
