"""Which systems are set side by side: formulas, trained networks, runs of the paper's network."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from experiments.depth_scenarios import scene_settings
from experiments.held_out import find_scenes
from experiments.histories import read_history, recipe_in_words
from lf_flame._common.config import build_record
from lf_flame.datasets.config import DatasetConfig
from lf_flame.errors import InputError
from lf_flame.learning.run_folders import load_run, open_run
from lf_flame.systems.base import RefocusingSystem
from lf_flame.systems.denoised import Denoised, non_local_means, total_variation
from lf_flame.systems.formulas import FourierSlice, ShiftAndSum
from lf_flame.systems.refocusnet import OFFICIAL, RefocusNet
from lf_flame.systems.registry import NETWORKS
from lf_flame.systems.resnet50 import ResNet50
from lf_flame.systems.training import load_system
from lf_flame.systems.view_selection import cross_of_views, lattice_of_views, square_of_views


@dataclass(frozen=True)
class Entry:
    """A system that can be loaded, here or in another process, and how it was trained.

    The function that loads it takes nothing, can be pickled, and raises InputError where it is
    missing. It is for test sets whose name starts with `only`; "": all.
    """

    name: str
    load: Callable[[], RefocusingSystem]
    about: dict
    only: str = ""


@dataclass(frozen=True)
class RecipeFacts:
    """What a run's record must say of its recipe; the steps are those of systems trained alike."""

    batch_size: int
    steps_per_epoch: int | None = None


@dataclass(frozen=True)
class TrainingFacts:
    """What a run's record must say of its training; the parts are those of a data set."""

    epochs: int
    recipe: RecipeFacts
    system: str | None = None
    parts: dict[str, int] = field(default_factory=dict)


def formula_entries() -> list[Entry]:
    """List the systems that need no training."""
    some = {
        "shift-and-sum, 3 x 3 views": square_of_views,
        "shift-and-sum, lattice of 9 views": lattice_of_views,
        "shift-and-sum, cross of 17 views": cross_of_views,
        "shift-and-sum, 7 x 7 views": partial(square_of_views, side=7),
    }
    denoised = [
        (f"{name}, denoised ({how})", partial(ShiftAndSum, name, places), denoise)
        for name, places in (
            ("shift-and-sum, all views", None),
            ("shift-and-sum, 3 x 3 views", square_of_views),
        )
        for how, denoise in (
            ("non-local means", non_local_means),
            ("total variation", total_variation),
        )
    ]
    return [
        Entry("shift-and-sum, all views", ShiftAndSum, {}),
        Entry("Fourier slice, all views", FourierSlice, {}),
        *(Entry(name, partial(ShiftAndSum, name, places), {}) for name, places in some.items()),
        *(Entry(name, partial(_denoised, name, *parts), {}) for name, *parts in denoised),
    ]


def _denoised(name: str, system: Callable[[], ShiftAndSum], denoise: Callable) -> Denoised:
    return Denoised(system(), denoise, name)


def trained_entries(runs: Path, official_refocusnet: Path | None = None) -> list[Entry]:
    """List the networks of a folder of runs; those that are not there will show as missing.

    It holds a run folder for each network, see `lf_flame.systems.registry`, and ``shapes`` and
    ``flames``, those of the paper's. `official_refocusnet` are the authors' trained weights.
    """
    found = []
    for name, network in NETWORKS.items():
        load = partial(load_system, runs / name)
        found.append(Entry(network.title, load, _about(runs / name)))
    if official_refocusnet:
        load = partial(RefocusNet.of_weights, official_refocusnet)
        found.append(Entry(f"{RefocusNet.name}, {OFFICIAL}", load, {}))
    for kind in ("shapes", "flames"):
        load = partial(ResNet50.of_run, runs / kind)
        name = f"{by_recipe(runs / kind)}, trained on {kind}"
        found.append(Entry(name, load, _about(runs / kind), only=kind))
    return found


def variant_entry(folder: Path, configs: Sequence[DatasetConfig], runs: Path, count: int) -> Entry:
    """Enter another run of the paper's network, such as one that is shown other views.

    It shows as missing if there is no such run, or if it has seen light fields of the test sets,
    which are made by `experiments.systems.compared_sets.paper_sets`.
    """
    name = f"{by_recipe(folder)}, {folder.resolve().name.replace('-', ' ')}"
    try:
        run = open_run(folder)
        for config in configs:
            held_out = find_scenes(config, runs / config.kind, count)
            seen = set(held_out.indices) - set(run.record["test_indices"])
            if seen and scene_settings(held_out.config) == scene_settings(run.config):
                raise InputError(
                    f"{folder} has seen light fields that it would be tested on, such as "
                    f"{min(seen)}."
                )
    except InputError as error:
        return Entry(name, partial(_refuse, str(error)), {})
    load = partial(ResNet50.of_run, folder)
    return Entry(name, load, _about(folder), only=run.config.kind)


def by_recipe(folder: Path) -> str:
    """Name a run of the paper's network by its recipe: only one of them is the paper's."""
    about = _about(folder)
    preset = about.get("preset")
    paper = f"the paper's recipe, {about.get('epochs', 0):,} epochs"  # not always to the end
    recipes = {"paper": paper, None: "no run"}
    return f"{ResNet50.name}, {recipes.get(preset) or recipe_in_words(preset)}"


def _refuse(reason: str) -> None:
    raise InputError(reason)


def _about(folder: Path) -> dict:
    """Read the record of a run, and what its training took; nothing where there is none."""
    try:
        record = load_run(folder)
    except InputError:
        return {}
    record.pop("test_indices", None)
    try:
        facts = build_record(TrainingFacts, record, folder / "run.json")
        history = read_history(folder / "history.csv", facts.epochs)
    except InputError:
        return record  # what training took is missing
    if facts.system is not None:  # trained as the other systems are
        return record | _progress(history, facts.recipe.steps_per_epoch or 0)
    # The paper's network sees every sample once in an epoch.
    seen = facts.parts.get("train", np.nan)
    return record | {
        "steps": np.ceil(seen / facts.recipe.batch_size) * facts.epochs,
        "seconds": history["seconds"].iloc[0] + facts.epochs * _pace(history),
    }


def _progress(history: pd.DataFrame, steps_per_epoch: int) -> dict:
    """Tell how a system got better: PSNR of held-out samples after so many steps and seconds.

    The start draws the training samples, which belongs to none.
    """
    epochs = history["epoch"].to_numpy()
    steps, seconds = epochs * steps_per_epoch, epochs * _pace(history)
    return {
        "steps": int(steps[-1]),
        "seconds": float(seconds[-1]),
        "curve": {
            "steps": steps.tolist(),
            "seconds": seconds.round(2).tolist(),
            "psnr_db": history["val_psnr_db"].round(3).tolist(),
        },
    }


def _pace(history: pd.DataFrame) -> float:
    """Seconds of the median epoch: what all of them take, whatever else the machine did."""
    epochs = np.diff(history["seconds"])
    return float(np.median(epochs)) if len(epochs) else 0.0
