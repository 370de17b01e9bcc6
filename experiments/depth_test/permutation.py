"""The depth permutation test: whether a network sees depth, or has memorised it.

In the training images of the paper every object has a depth of its own. A network that has only
learnt which object is sharp in which plane looks perfect there, and fails where the objects change
their depths, as here (`experiments.inputs`). Shift-and-sum of all views is the reference;
a network that has memorised the depths draws the reference of the scene as trained:

    share memorised = sum((predicted - reference) * (trained - reference))
                      / sum((trained - reference)^2),

0 for a network that draws the scene as it is, 1 for one that draws every object at its old depth.
"""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from experiments.inputs import DepthScenario, draw_scenario, make_scenarios, scene_settings
from experiments.report import markdown, step_bar, write_report
from lf_flame._common.config import to_json
from lf_flame._common.figures import subplots
from lf_flame.datasets.config import DatasetConfig
from lf_flame.datasets.encodings import InputEncoding
from lf_flame.errors import InputError
from lf_flame.learning.run_folders import open_run
from lf_flame.learning.scores import score
from lf_flame.systems.formulas import ShiftAndSum
from lf_flame.systems.resnet50 import ResNet50

COLUMNS = [
    "scenario", "system", "depth_mm", "psnr_db", "psnr_sd", "psnr_foreground_db", "ssim", "ssim_sd",
    "share_memorised",
]  # fmt: skip


def load_systems(runs: Sequence[Path]) -> tuple[DatasetConfig, list[float], dict, dict]:
    """Load trained networks that differ only in their input, and in the order of their depths.

    Returns the configuration of the first, by which scenes are drawn, the slopes of the planes, the
    systems by name (shift-and-sum of some views, for comparison, and the networks), and the
    networks' records. An InputError refuses a missing run, or other scenes or another camera.
    """
    opened = [open_run(run) for run in runs]
    config, systems, records = opened[0].config, {}, {}
    for encoding in (InputEncoding("views"), InputEncoding("grid")):
        count = len(encoding.view_indices(config.camera.views, config.camera.views))
        name = f"shift-and-sum of {count} views"
        systems[name] = ShiftAndSum(name, encoding.view_indices)
    alike = len({run.name for run in runs}) < len(runs)
    for run, found in zip(runs, opened, strict=True):
        if scene_settings(found.config) != scene_settings(config):
            raise InputError(
                f"{run} was trained on other scenes than {runs[0]}, or for another camera; "
                f"test them one by one."
            )
        depths = "shuffled depths" if found.config.shuffled_depths else "fixed depths"
        weights = re.sub(r" \(sha256 \w+\)", "", found.record["backbone_weights"])
        name = (
            f"{run if alike else run.name}: input {found.config.input.kind}, {depths}; "
            f"{found.record['preset']} recipe, {weights}"
        )
        records[name] = {k: x for k, x in found.record.items() if k != "test_indices"}
        systems[name] = ResNet50.of_run(run)
    return config, opened[0].slopes, systems, records


def score_scenario(drawn: dict, reference: np.ndarray, trained: np.ndarray, depths_mm: Sequence):
    """Score the images (n, planes, h, w) of systems; a depth of NaN is the mean over the planes."""
    tables = []
    for system, images in drawn.items():
        scores = score(reference, images)
        rows = pd.concat([scores, scores.mean().to_frame().T])
        shares = share_memorised(images, reference, trained, planes=True)
        share = share_memorised(images, reference, trained)
        tables.append(rows.assign(
            system=system, depth_mm=[*depths_mm, np.nan], share_memorised=[*shares, share]
        ))  # fmt: skip
    return pd.concat(tables)


def share_memorised(predicted, reference, trained, planes: bool = False):
    """Find the share of the scene as trained that a system draws, also of each plane alone.

    NaN if the scenes are equal. Images have the shape (n, planes, h, w).
    """
    way, axes = (trained - reference).astype(float), (0, 2, 3) if planes else None
    with np.errstate(invalid="ignore"):
        return np.sum((predicted - reference) * way, axes) / np.sum(way**2, axes)


def run_depth_test(runs: Sequence[Path], out: Path, samples: int) -> Path:
    """Test trained networks on `samples` scenes for each scenario, and write the report."""
    config, slopes, systems, records = load_systems(runs)
    everyone = [ShiftAndSum(), *systems.values()]
    scenarios, tables, trained = make_scenarios(config), [], None
    for scenario in step_bar(scenarios):
        stacks = [
            [system.refocus(light_field, slopes, config.block) for system in everyone]
            for light_field in draw_scenario(config, scenario, samples)
        ]
        reference, *images = np.swapaxes(stacks, 0, 1)
        trained = reference if trained is None else trained  # the first scenario is as trained
        drawn = dict(zip(systems, images, strict=True))
        table = score_scenario(drawn, reference, trained, config.depths_mm)
        tables.append(table.assign(scenario=scenario.name))
    table = pd.concat(tables)[COLUMNS]
    record = {
        "config": to_json(config), "slopes": list(slopes), "samples": samples, "runs": records,
        "scenarios": [vars(scenario) for scenario in scenarios],
    }  # fmt: skip
    return write_report(
        out, "depth_test", f"Depth permutation test: {config.kind}", record,
        report_body(table, scenarios, config, samples),
        tables={"depth_test": table.round(5)}, pictures={"depth_test": share_figure(table)},
    )  # fmt: skip


def report_body(
    table: pd.DataFrame, scenarios: Sequence[DepthScenario], config: DatasetConfig, samples: int
) -> list[str]:
    """Write the table and the scenarios as Markdown."""
    means = table[table.depth_mm.isna()].set_index(["system", "scenario"])
    rows = [
        {"system": name} | {one.name: _cell(means.loc[(name, one.name)]) for one in scenarios}
        for name in table.system.unique()
    ]
    objects = [item.name for item in config.template.objects]
    return [
        f"PSNR in dB against shift-and-sum of all {config.camera.views**2} views, mean of "
        f"{len(config.depths_mm)} planes and {samples} scenes that no network was trained on; in "
        "brackets the share memorised: 0 % draws the scene as it is, 100 % draws every object at "
        "its old depth. The share is coarse: few views blur otherwise than all, which alone gives "
        "shift-and-sum of few views a share.",
        markdown(rows),
        "\n".join(
            f"- {scenario.name}: "
            + ", ".join(f"{objects[k]} at {scenario.depths_mm[k]:g} mm" for k in scenario.present)
            for scenario in scenarios
        ),
    ]


def _cell(row: pd.Series) -> str:
    share = "" if np.isnan(row.share_memorised) else f" ({row.share_memorised:.0%})"
    return f"{row.psnr_db:.2f}{share}"


def share_figure(table: pd.DataFrame):
    """Draw PSNR and share memorised of each system, a row of points for each scenario."""
    means = table[table.depth_mm.isna()]
    names = list(means.scenario.unique())
    size = 12, 3 + 1.2 * len(names)
    figure, axes = subplots(1, 2, figsize=size, sharey=True, layout="constrained")
    measures = {
        "psnr_db": "PSNR against shift-and-sum of all views (dB)",
        "share_memorised": "share memorised (0: the scene as it is, 1: as trained)",
    }
    for axis, (measure, label) in zip(axes, measures.items(), strict=True):
        systems = means.groupby("system", sort=False)
        for k, (system, rows) in enumerate(systems):
            marker = "D" if "shuffled" in system else "o" if ":" in system else "s"
            at = np.arange(len(names)) + 0.8 * (k + 0.5) / len(systems) - 0.4
            axis.plot(rows[measure], at, marker, label=system)
        axis.set_xlabel(label)
        axis.grid(axis="x", alpha=0.3)
        for edge in range(1, len(names)):
            axis.axhline(edge - 0.5, color="0.8", lw=0.8)
    axes[0].set_yticks(range(len(names)), names)
    axes[0].set_ylim(len(names) - 0.5, -0.5)
    handles = axes[0].get_legend_handles_labels()
    figure.legend(*handles, fontsize=8, loc="outside lower center")
    return figure
