"""Refocusing systems to compare with their budgets, and light fields with slopes.

The light fields are those of the paper's two data sets that no network was trained on, the same
scenes with their objects at other depths, the sixteen slopes of RefNet, and photographs.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from experiments.inputs import (
    DATA_SETS,
    HeldOut,
    draw_scenario,
    find_scenes,
    make_scenarios,
    read_history,
    scene_settings,
)
from experiments.report import backbone_name
from lf_flame.datasets.config import DatasetConfig, read_config
from lf_flame.datasets.sampling import render_sample
from lf_flame.errors import InputError
from lf_flame.formats import read_light_field
from lf_flame.formats.images import white_of
from lf_flame.learning.run_folders import load_run
from lf_flame.lightfield import LightField
from lf_flame.refocus._arguments import as_slopes, refuse_excluded
from lf_flame.systems import formulas
from lf_flame.systems.base import RefocusingSystem
from lf_flame.systems.formulas import FourierSlice, ShiftAndSum
from lf_flame.systems.refnet import ALPHAS, SLOPES
from lf_flame.systems.refocusnet import OFFICIAL, RefocusNet
from lf_flame.systems.resnet50 import ResNet50
from lf_flame.systems.training import NETWORKS, load_system

BORDER = 12
"""Pixels that are cut off a photograph's images, or more where views end farther inside."""

WINDOW = 11
"""Side in pixels of the window of the structural similarity."""

SELECTIONS = {
    "RefocusNet's 4 views": formulas.diamond_of_views,
    "ApertureNet's 3 x 3 views": formulas.square_of_views,
    "volumetric cross of 17 views": formulas.cross_of_views,
    "RefNet's 7 x 7 views": formulas.outer_square_of_views,
}
"""Views of plain shift-and-sum: those of each network, so that its input has a baseline."""


@dataclass(frozen=True)
class Entry:
    """A system that can be loaded, here or in another process, and what its training took.

    The function that loads it takes nothing, can be pickled, and raises InputError where the system
    is missing. It is for test sets whose name starts with `only`; "": all.
    """

    name: str
    load: Callable[[], RefocusingSystem]
    about: dict
    only: str = ""


def select_entries(runs: Path, official: Path | None) -> list[Entry]:
    """List formulas, and the networks of a folder of runs, two of them the paper's.

    `official` is a file of RefocusNet's trained weights, by its authors.
    """
    networks = [
        Entry(network.system.name, partial(load_system, runs / name), training_of(runs / name))
        for name, network in NETWORKS.items()
    ]
    if official:
        load = partial(RefocusNet.of_weights, official)
        networks.append(Entry(OFFICIAL, load, {}))
    names = {f"shift-and-sum, {what}": selection for what, selection in SELECTIONS.items()}
    return [
        Entry("shift-and-sum, all views", ShiftAndSum, {}),
        Entry("Fourier slice, all views", FourierSlice, {}),
        *(Entry(name, partial(ShiftAndSum, name, views), {}) for name, views in names.items()),
        *networks,
        *(resnet_entry(runs / kind) for kind in ("shapes", "flames")),
    ]


def resnet_entry(folder: Path) -> Entry:
    """Enter a run of the paper's network, for the data set of its kind."""
    about, name = training_of(folder), f"{ResNet50.name}, no run"
    if about:
        name = f"{backbone_name(about['backbone_weights'])}, {about['epochs']:,} epochs"
    load = partial(ResNet50.of_run, folder)
    return Entry(f"{name}, {folder.name}", load, about, only=folder.name)


def training_of(folder: Path) -> dict:
    """Read steps and seconds of a run's training, and its PSNR meanwhile; {} without a run.

    The seconds are those of the median epoch times the number of epochs, so that other programs
    change them little; drawing the training samples is excluded.
    """
    try:
        record = load_run(folder)
        history = read_history(folder / "history.csv", record["epochs"])
        recipe, system = record["recipe"], record.get("system")
        each = (
            recipe["steps_per_epoch"]
            if system  # the paper's network sees every sample once in an epoch
            else int(np.ceil(record["parts"]["train"] / recipe["batch_size"]))
        )
    except (InputError, KeyError):
        return {}
    epochs = history["epoch"].to_numpy()
    seconds = epochs * float(np.median(np.diff(history["seconds"], prepend=0.0)))
    kept = "system", "preset", "seed", "recipe", "epochs", "best_epoch", "backbone_weights"
    facts = {key: record[key] for key in (*kept, "date", "git_revision") if key in record}
    facts |= {"steps": int(each * epochs[-1]), "seconds": float(seconds[-1])}
    if system:
        facts["curve"] = {
            "steps": (each * epochs).tolist(),
            "seconds": seconds.round(2).tolist(),
            "psnr_db": history["val_psnr_db"].round(3).tolist(),
        }
    return facts


@dataclass(frozen=True, eq=False)
class Scene:
    """A light field [v, u, t, s(, channel)] to be refocused at slopes."""

    views: np.ndarray
    slopes: np.ndarray
    block: tuple[int, int] = (1, 1)  # number of lenslets in a pixel of the images
    border: int = 0  # number of these pixels that are not scored

    def reference(self) -> np.ndarray:
        """Refocus with all views by shift-and-sum."""
        return ShiftAndSum().refocus(self.views, self.slopes, self.block)


@dataclass(frozen=True)
class TestSet:
    """Light fields that are refocused at the same planes; a callable gives the scenes.

    The origin of the scenes is for the record.
    """

    __test__ = False  # for pytest, which would collect it

    name: str
    planes: list[str]
    scenes: Callable[[], Iterator[Scene]]
    origin: str = ""


def select_sets(
    runs: Path, data: Sequence[Path], count: int, photographs: Sequence[tuple[Path, str]]
) -> list[TestSet]:
    """Make the test sets of data sets (default: the paper's), and of photographs at slopes."""
    sets = []
    for config in map(read_config, data or DATA_SETS):
        sets += paper_sets(config, find_scenes(config, runs / config.kind, count), count)
    for path, words in photographs:
        try:
            slopes = [float(part) for part in words.split(",")]
        except ValueError:
            raise InputError(f"Slopes are numbers with commas between, got {words!r}.") from None
        sets.append(photograph_set(path.name, read_light_field(path), slopes))
    return sets


def paper_sets(config: DatasetConfig, held_out: HeldOut, count: int) -> list[TestSet]:
    """Make the test sets of a data set from light fields that no network was trained on.

    An InputError says that these are of other scenes, or that all objects of the data set are at
    one depth.
    """
    if scene_settings(held_out.config) != scene_settings(config):
        raise InputError(
            f"{held_out.run} was trained on other scenes, or for another camera, than the "
            f"{config.kind} to compare on; compare with a folder of runs without it."
        )
    config, kind = held_out.config, config.kind
    split = f"test split of {held_out.run}" if held_out.run else f"no network, {held_out.origin}"
    origin = f"samples {', '.join(map(str, held_out.indices))} ({split})"
    own, slopes = partial(_own_scenes, config, held_out.indices), np.array(held_out.slopes)
    sets = [TestSet(kind, _millimetres(config.depths_mm), partial(own, slopes), origin=origin)]
    every = range(len(config.depths_mm))
    for scenario in make_scenarios(config)[1:]:  # the first is as trained
        if scenario.present != tuple(every):
            continue
        moved = set(scenario.depths_mm) != set(config.depths_mm)  # else objects change places
        depths = scenario.depths_mm if moved else config.depths_mm
        slopes = np.array([config.camera.depth_to_slope(z) for z in depths])
        placed = partial(_placed_scenes, config, scenario, slopes, count)
        name, seed = f"{kind}, {scenario.name}", f"drawn by seed {config.seed}"
        sets.append(TestSet(name, _millimetres(depths), placed, origin=seed))
    alphas, scenes = [f"alpha {a:g}" for a in ALPHAS], partial(own, SLOPES * config.block[0])
    return [*sets, TestSet(f"{kind}, RefNet's slopes", alphas, scenes, origin)]


def _millimetres(depths: Sequence[float]) -> list[str]:
    return [f"{z:g} mm" for z in depths]


def _own_scenes(config, indices, slopes) -> Iterator[Scene]:
    for index in indices:
        yield _scene(render_sample(config, index)[0], slopes, config.block)


def _placed_scenes(config, scenario, slopes, count) -> Iterator[Scene]:
    for light_field in draw_scenario(config, scenario, count):
        yield _scene(light_field, slopes, config.block)


def _scene(light_field: LightField, slopes: np.ndarray, block: tuple[int, int] = (1, 1), **border):
    indices = formulas.every_view(*light_field.shape[:2])
    refuse_excluded(light_field, indices, "A comparison")  # the reference is of all views
    return Scene(light_field.filled, slopes, block, **border)


def photograph_set(name: str, light_field: LightField, slopes: Sequence[float]) -> TestSet:
    """Make the test set of a photographed light field, scaled to values up to 1."""
    slopes, (rows, columns, height, width) = as_slopes(slopes), light_field.views.shape[:4]
    border = max(BORDER, int(np.ceil(np.abs(slopes).max() * (max(rows, columns) - 1) / 2)))
    if min(height, width) < 2 * border + WINDOW:
        raise InputError(
            f"To be compared on at these slopes {name} needs views of {2 * border + WINDOW} pixels "
            f"or more along each side, got {height} x {width}."
        )
    scaled = replace(light_field, views=light_field.views / np.float32(white_of(light_field)))
    scene, planes = _scene(scaled, slopes, border=border), [f"slope {x:g}" for x in slopes]
    return TestSet(name, planes, lambda: iter([scene]), origin="a photograph")
