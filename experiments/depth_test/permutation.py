"""The depth permutation test: whether a network sees depth, or has memorised it.

In the training images of the paper every object has a depth of its own. A network that has only
learnt which object is sharp in which plane looks perfect there, and fails where the objects change
their depths, as here (`experiments.inputs`); so does a ridge regression, for comparison.
Shift-and-sum of all views is the reference; a network that has memorised the depths draws the
reference of the scene as trained:

    share memorised = sum((predicted - reference) * (trained - reference))
                      / sum((trained - reference)^2),

0 for a network that draws the scene as it is, 1 for one that draws every object at its old depth.
"""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from experiments.inputs import DepthScenario, draw_scenario, make_scenarios, scene_settings
from experiments.linear import RIDGE, Ridge
from experiments.report import backbone_name, markdown, step_bar, write_report
from lf_flame._common.config import to_json
from lf_flame.datasets.config import DatasetConfig
from lf_flame.datasets.encodings import InputEncoding
from lf_flame.datasets.store import Dataset, split_indices
from lf_flame.errors import InputError
from lf_flame.learning.run_folders import open_run
from lf_flame.learning.scores import score
from lf_flame.lightfield import LightField
from lf_flame.systems.formulas import ShiftAndSum
from lf_flame.systems.resnet50 import ResNet50

COLUMNS = ["scenario", "system", "psnr_db", "psnr_foreground_db", "ssim", "share_memorised"]


def predict(ridge: Ridge, config: DatasetConfig, light_field: LightField, _slopes, _block):
    """Predict the images (planes, h, w) of a data set's own slopes, by its ridge regression."""
    return ridge.predict(config.encode(light_field)[None])[0]


def load_systems(folders: Sequence[Path]) -> tuple[DatasetConfig, list[float], dict, dict]:
    """Load runs and data sets that differ only in their input, and in the order of their depths.

    Returns the configuration of the first, by which scenes are drawn, the slopes of the planes, the
    refocusing functions by name of system (shift-and-sum of some views, for comparison, the
    networks of the runs, and for each data set the ridge regression), and the networks' records. An
    InputError refuses what is neither, or other scenes or another camera.
    """
    systems, networks, linear, records = {}, {}, {}, {}
    first: Dataset | None = None
    for folder in folders:
        if (folder / "zarr.json").exists():
            dataset, record = Dataset(folder), {}
        else:
            found = open_run(folder)
            dataset, record = found.open_dataset(), found.record
        config, first = dataset.config, first or dataset
        if scene_settings(config) != scene_settings(first.config):
            raise InputError(
                f"{folder} is of other scenes than {folders[0]}, or of another camera; "
                f"test them one by one."
            )
        depths = "shuffled" if config.shuffled_depths else "fixed"
        learnt = f"input {config.input.kind}, {depths} depths"
        if record:
            network = backbone_name(record["backbone_weights"])
            name = f"{folder}: {learnt}; {network}, {record['epochs']:,} epochs"
            records[name] = {k: x for k, x in record.items() if k != "test_indices"}
            networks[name] = ResNet50.of_run(folder).refocus
        name = f"{RIDGE}: {learnt}"
        if name not in linear:
            split, seed = record.get("split", (0.8, 0.1, 0.1)), record.get("seed", 1)
            parts = split_indices(len(dataset), split, seed)
            linear[name] = partial(predict, Ridge(dataset, parts), config)
    assert first is not None
    config, views = first.config, first.config.camera.views
    for encoding in (InputEncoding("views"), InputEncoding("grid")):
        name = f"shift-and-sum of {len(encoding.view_indices(views, views))} views"
        systems[name] = ShiftAndSum(name, encoding.view_indices).refocus
    return config, first.attrs["slopes"], {**systems, **networks, **linear}, records


def share_memorised(predicted, reference, trained):
    """Find the share of the scene as trained that a system draws; NaN if the scenes are equal."""
    way = (trained - reference).astype(float)
    with np.errstate(invalid="ignore"):
        return np.sum((predicted - reference) * way) / np.sum(way**2)


def run_depth_test(folders: Sequence[Path], out: Path, samples: int) -> Path:
    """Test runs and data sets on `samples` scenes for each scenario, and write the report."""
    config, slopes, systems, records = load_systems(folders)
    everyone = [ShiftAndSum().refocus, *systems.values()]
    scenarios, rows, trained = make_scenarios(config), [], None
    for scenario in step_bar(scenarios):
        stacks = [
            [refocus(light_field, slopes, config.block) for refocus in everyone]
            for light_field in draw_scenario(config, scenario, samples)
        ]
        reference, *images = np.swapaxes(stacks, 0, 1)
        trained = reference if trained is None else trained  # the first scenario is as trained
        for system, drawn in zip(systems, images, strict=True):
            share = share_memorised(drawn, reference, trained)
            about = {"scenario": scenario.name, "system": system, "share_memorised": share}
            rows.append({**score(reference, drawn).mean(), **about})
    table = pd.DataFrame(rows)[COLUMNS]
    record = {
        "config": to_json(config), "slopes": list(slopes), "samples": samples, "runs": records,
        "scenarios": [vars(scenario) for scenario in scenarios],
    }  # fmt: skip
    return write_report(
        out, "depth_test", f"Depth permutation test: {config.kind}", record,
        report_body(table, scenarios, config, samples),
        tables={"depth_test": table.round(5)},
    )  # fmt: skip


def report_body(
    table: pd.DataFrame, scenarios: Sequence[DepthScenario], config: DatasetConfig, samples: int
) -> list[str]:
    """Write the table and the scenarios as Markdown."""
    means = table.set_index(["system", "scenario"])
    rows = [
        {"system": name} | {one.name: _cell(means.loc[(name, one.name)]) for one in scenarios}
        for name in table.system.unique()
    ]
    objects = [item.name for item in config.template.objects]
    return [
        f"PSNR in dB against shift-and-sum of all {config.camera.views**2} views, mean of "
        f"{len(config.depths_mm)} planes and {samples} scenes that nothing was trained on; in "
        "brackets the share memorised: 0 % draws the scene as it is, 100 % draws every object at "
        "its old depth. The share is coarse: few views blur differently from all, which alone "
        "gives shift-and-sum of few views a share.",
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
