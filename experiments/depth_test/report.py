"""Table, text and pictures of the swap test (`experiments.depth_test.permutation`)."""

import math
import re
from collections.abc import Sequence
from pathlib import Path
from textwrap import fill

import numpy as np
import pandas as pd

from lf_flame._common import figures, provenance
from lf_flame._common.atomic_files import write_json, write_text
from lf_flame._common.config import to_json
from lf_flame._common.figures import subplots


def write_report(
    config, slopes, subjects: Sequence, outcomes: Sequence, table: pd.DataFrame, out: Path
) -> Path:
    """Write ``swap_test.csv``, ``.md``, ``.png``, ``.json``, and a picture for each case.

    Parameters
    ----------
    config : lf_flame.datasets.store.DatasetConfig
    slopes : sequence of float
    subjects : sequence of experiments.depth_test.permutation.Subject
    outcomes : sequence of experiments.depth_test.permutation.Outcome
    table : DataFrame
        From `experiments.depth_test.permutation.tabulate`.
    out : Path

    Returns
    -------
    Path
        ``swap_test.md``.
    """
    for number, outcome in enumerate(outcomes):
        name = "_".join(re.findall(r"\w+", outcome.case.name))
        picture = case_figure(config, subjects, outcome)
        figures.save(picture, out / f"swap_test_{number}_{name}.png", dpi=90)
    figures.save(score_figure(table, subjects, config.kind), out / "swap_test.png")
    write_json(
        out / "swap_test.json",
        {
            "config": to_json(config),
            "slopes": list(slopes),
            "cases": [vars(outcome.case) for outcome in outcomes],
            "samples": len(outcomes[0].truth),
            "systems": {subject.name: subject.title for subject in subjects},
            "runs": {subject.name: subject.about for subject in subjects if subject.about},
            **provenance.environment(),
        },
    )
    write_text(out / "swap_test.csv", table.round(5).to_csv(index=False))
    write_text(out / "swap_test.md", text(config, subjects, outcomes, table))
    return out / "swap_test.md"


def text(config, subjects: Sequence, outcomes: Sequence, table: pd.DataFrame) -> str:
    """Put the table, and what it means, into Markdown."""
    cases = [outcome.case for outcome in outcomes]
    titles = {subject.name: subject.title for subject in subjects}
    means = table[table.depth_mm.isna()].assign(system=lambda rows: rows.system.map(titles))
    lines = [
        f"# Swap test: {config.kind}",
        f"PSNR in dB against shift-and-sum of all {config.camera.views**2} views, which is right "
        f"by construction; mean of {len(config.depths_mm)} planes and {len(outcomes[0].truth)} "
        f"scenes that no network was trained on. Behind it the share that a system draws by heart: "
        f"0 % what is there, 100 % every object at the depth of its own; beyond these its error "
        f"points the other way. How far that goes, few views show, which blur otherwise than all.",
        _pivot(means, cases),
        "SSIM:",
        _pivot(means, cases, "ssim"),
        "\n".join(
            f"- {case.name}: "
            + ", ".join(
                f"{config.template.objects[k].name} at {case.depths_mm[k]:g} mm"
                for k in case.present
            )
            for case in cases
        ),
    ]
    return "\n\n".join(lines) + "\n"


def _pivot(means: pd.DataFrame, cases: Sequence, measure: str = "psnr_db") -> str:
    form = "{:.2f}" if measure == "psnr_db" else "{:.3f}"
    cells = [
        form.format(value)
        + (f" ({share:.0%})" if measure == "psnr_db" and not math.isnan(share) else "")
        for value, share in zip(means[measure], means.by_heart, strict=True)
    ]
    shown = means.assign(cell=cells).pivot(index="system", columns="case", values="cell")
    shown = shown.loc[means.system.unique(), [case.name for case in cases]]
    sides = ("left", *["right"] * len(cases))
    return shown.to_markdown(disable_numparse=True, colalign=sides)


MARKERS = {"": "s", "fixed depths": "o", "shuffled depths": "D"}
"""By what a system was trained with; references are not trained."""


def score_figure(table: pd.DataFrame, subjects: Sequence, kind: str):
    """Draw PSNR and the share known by heart: one group a case, one mark a system.

    Returns
    -------
    matplotlib.figure.Figure
    """
    means = table[table.depth_mm.isna()]
    cases = means.case.unique()[::-1]
    figure, axes = subplots(
        1, 2, figsize=(12, 1.8 + 0.13 * len(cases) * (len(subjects) + 2)), sharey=True,
        layout="constrained",
    )  # fmt: skip
    places = np.linspace(0.35, -0.35, len(subjects))
    for axis, measure in zip(axes, ("psnr_db", "by_heart"), strict=True):
        for k, (subject, place) in enumerate(zip(subjects, places, strict=True)):
            rows = means[means.system == subject.name].set_index("case").loc[cases]
            color = f"C{k % 10}" if subject.trained else "0.45"
            axis.plot(
                rows[measure], np.arange(len(cases)) + place, MARKERS[subject.trained], color=color,
                markerfacecolor="white" if k % 2 and not subject.trained else color, markersize=6,
                label=f"{subject.name}{subject.trained and f' ({subject.trained})'}",
            )  # fmt: skip
        for edge in range(1, len(cases)):
            axis.axhline(edge - 0.5, color="0.8", lw=0.8)
        axis.set_yticks(range(len(cases)), cases)
        axis.grid(axis="x", alpha=0.3)
    axes[0].set_xlabel("PSNR against shift-and-sum of all views (dB)")
    axes[1].set_xlabel("share by heart: 0 draws what is there, 1 every object at its own depth")
    for x in (0, 1):
        axes[1].axvline(x, color="black", ls="--", lw=1)
    figure.suptitle(f"Swap test ({kind}): objects that stand otherwise than in training")
    figure.legend(*axes[0].get_legend_handles_labels(), ncols=3, loc="outside lower center")
    return figure


def case_figure(config, subjects: Sequence, outcome):
    """Draw the first scene of a case: the truth, what each system makes of it, what was learnt.

    Returns
    -------
    matplotlib.figure.Figure
    """
    rows = {"truth: shift-and-sum of all views": outcome.truth[0]}
    rows |= {subject.name: outcome.drawn[subject.name][0] for subject in subjects}
    if outcome.learnt is not outcome.truth:
        rows["by heart: every object at its own depth"] = outcome.learnt[0]
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
        f"{config.template.objects[k].name} at {outcome.case.depths_mm[k]:g}"
        for k in outcome.case.present
    )
    figure.suptitle(f"{outcome.case.name}: {where} mm", fontsize=11)
    return figure
