"""The depth permutation test: whether a network sees how far away things are, or has memorised it.

In the training images of the paper every object stands at the depth of its own. A network that has
only learnt which object is sharp in which plane looks perfect there, and goes wrong where the
objects stand otherwise. Here they do (`experiments.depth_scenarios`), in scenes that no
network was trained on.

Shift-and-sum is right by construction; its images are the truth. What a network would draw that
has memorised the depths is the truth of the scene as it was before. Between both lies what a
network draws; where, is the share of their difference that it follows:

    share memorised = sum((drawn - truth) * (learnt - truth)) / sum((learnt - truth)^2),

0 for a network that draws what is there, 1 for one that draws every object at its own depth. One
that cannot tell, and was trained with objects at all depths, draws something between.
"""

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from experiments.command_parts import step_bar
from experiments.depth_scenarios import DepthScenario, draw_scenario, make_scenarios, scene_settings
from experiments.depth_test.report import write
from experiments.histories import recipe_in_words
from lf_flame.datasets.config import DatasetConfig
from lf_flame.datasets.encodings import InputEncoding
from lf_flame.errors import InputError
from lf_flame.learning.run_folders import open_run
from lf_flame.learning.scores import score
from lf_flame.systems.base import RefocusingSystem
from lf_flame.systems.formulas import ShiftAndSum
from lf_flame.systems.resnet50 import ResNet50

COLUMNS = [
    "scenario", "system", "depth_mm", "psnr_db", "psnr_sd", "psnr_foreground_db", "ssim", "ssim_sd",
    "share_memorised",
]  # fmt: skip


@dataclass(frozen=True, eq=False)
class Subject:
    """A refocusing system under test: its title for tables, and the record of its training.

    It was trained with "fixed depths", "shuffled depths" or, a reference, not at all ("").
    """

    name: str
    title: str
    trained: str
    about: dict
    system: RefocusingSystem


@dataclass(frozen=True, eq=False)
class Outcome:
    """Results of the systems on one scenario.

    Parameters
    ----------
    truth, learnt : ndarray of float32, shape (n, planes, h, w)
        Refocused by shift-and-sum: the scenes as they are, and with every object at its own depth.
    drawn : dict of str to ndarray of float32, shape (n, planes, h, w)
        By system.
    """

    scenario: DepthScenario
    truth: np.ndarray
    learnt: np.ndarray
    drawn: dict[str, np.ndarray]


def load_subjects(runs: Sequence[Path]) -> tuple[DatasetConfig, list[float], list[Subject]]:
    """Load trained networks that differ in nothing but in what they were shown and trained with.

    Returns the configuration of the first, by which scenes are drawn, the slopes of the planes, and
    the networks behind shift-and-sum of some views, as a reference. An InputError says that a run
    is missing, or that two were made for other scenes or cameras.
    """
    opened = [open_run(run) for run in runs]
    first = opened[0]
    subjects = [_reference(first.config, InputEncoding(kind)) for kind in ("views", "grid")]
    for run, found in zip(runs, opened, strict=True):
        if scene_settings(found.config) != scene_settings(first.config):
            raise InputError(
                f"{run} was trained on other scenes than {runs[0]}, or for another camera; "
                f"test them one by one."
            )
        name = run.name if [other.name for other in runs].count(run.name) == 1 else str(run)
        if len({other.record["preset"] for other in opened}) > 1:
            name += f", {recipe_in_words(found.record['preset'])}"
        subjects.append(_network(name, run, found.record, found.config))
    return first.config, first.slopes, subjects


def _reference(config: DatasetConfig, encoding: InputEncoding) -> Subject:
    """Shift-and-sum of those views alone that an encoding shows, all as bright as they are."""
    count = len(encoding.view_indices(config.camera.views, config.camera.views))
    name = f"shift-and-sum of {count} views"
    return Subject(name, name, "", {}, ShiftAndSum(name, encoding.view_indices))


def _network(name: str, run: Path, record: dict, config: DatasetConfig) -> Subject:
    trained = "shuffled depths" if config.shuffled_depths else "fixed depths"
    weights = re.sub(r" \(sha256 \w+\)", "", record["backbone_weights"])
    recipe = f"{recipe_in_words(record['preset'])} ({record['epochs']} epochs; {weights})"
    title = f"{name}: shown {config.input.kind}, trained with {trained}, {recipe}"
    about = {key: value for key, value in record.items() if key != "test_indices"}
    return Subject(name, title, trained, about, ResNet50.of_run(run))


def run_scenarios(
    config: DatasetConfig, slopes: Sequence[float], subjects: Sequence[Subject], samples: int
) -> Iterator[Outcome]:
    """Render the scenes of each scenario and let all systems refocus them."""
    systems = {"truth": ShiftAndSum()} | {one.name: one.system for one in subjects}
    learnt = None
    for scenario in make_scenarios(config):
        stacks = {name: [] for name in systems}
        for light_field in draw_scenario(config, scenario, samples):
            for name, system in systems.items():
                stacks[name].append(system.refocus(light_field, slopes, config.block))
        drawn = {name: np.stack(some) for name, some in stacks.items()}
        truth = drawn.pop("truth")
        learnt = truth if learnt is None else learnt  # the first scenario is as trained
        yield Outcome(scenario, truth, learnt, drawn)


def tabulate(outcomes: Iterable[Outcome], depths_mm: Sequence[float]) -> pd.DataFrame:
    """Score every system on every scenario, plane by plane; columns as in `COLUMNS`.

    The rows of depth NaN hold the mean over the planes, and the share that a system has memorised
    over all of them.
    """
    tables = []
    for outcome in outcomes:
        for name, images in outcome.drawn.items():
            scores = score(outcome.truth, images)
            means = scores.mean().to_frame().T
            planes = [
                share_memorised(*(x[:, k] for x in (images, outcome.truth, outcome.learnt)))
                for k in range(len(depths_mm))
            ]
            whole = share_memorised(images, outcome.truth, outcome.learnt)
            scores = scores.assign(depth_mm=depths_mm, share_memorised=planes)
            means = means.assign(depth_mm=np.nan, share_memorised=whole)
            rows = pd.concat([scores, means])
            tables.append(rows.assign(scenario=outcome.scenario.name, system=name))
    return pd.concat(tables, ignore_index=True)[COLUMNS]


def share_memorised(drawn: np.ndarray, truth: np.ndarray, learnt: np.ndarray) -> float:
    """Find the share of what is learnt that a system draws, see above; NaN: nothing differs."""
    way = (learnt - truth).astype(float)
    squares = np.sum(way**2)
    if squares == 0:
        return np.nan
    return float(np.sum((drawn - truth) * way) / squares)


def run_depth_test(runs: Sequence[Path], out: Path, samples: int) -> Path:
    """Test trained networks on so many scenes for each scenario, and write the report."""
    if samples < 1:
        raise InputError(
            f"The depth permutation test needs at least 1 scene for each scenario, got {samples}."
        )
    config, slopes, subjects = load_subjects(runs)
    steps = run_scenarios(config, slopes, subjects, samples)
    outcomes = list(step_bar(steps, len(make_scenarios(config))))
    table = tabulate(outcomes, config.depths_mm)
    return write(config, slopes, subjects, outcomes, table, out)
