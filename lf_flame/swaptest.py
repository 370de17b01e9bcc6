"""The swap test: whether a network sees how far away things are, or knows it by heart.

In the training images of the paper every object stands at the depth of its own. A network that has
only learnt which object is sharp in which plane looks perfect there, and goes wrong where the
objects stand otherwise. Here they do, in scenes that no network was trained on. They are scaled so
that the central view stays as it was: parallax and defocus alone tell the scenes apart.

Shift-and-sum is right by construction; its images are the truth. What a network would draw that
knows the depths by heart is the truth of the scene as it was before. Between both lies what a
network draws; where, is the share of their difference that it follows:

    by heart = sum((drawn - truth) * (learnt - truth)) / sum((learnt - truth)^2),

0 for a network that draws what is there, 1 for one that draws every object at its own depth. One
that cannot tell, and was trained with objects at all depths, draws something between.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd

from lf_flame.config import to_json
from lf_flame.datasets import DatasetConfig, render_drawn
from lf_flame.encodings import InputEncoding, area_average
from lf_flame.errors import InputError
from lf_flame.evaluation import open_run, score
from lf_flame.keras_loading import load_model
from lf_flame.lightfield import LightField
from lf_flame.plan import plan_effects
from lf_flame.refocus import shift_and_sum, sparse_aperture
from lf_flame.scene import Scene

FIRST_SAMPLE = 1_000_000
"""Index of the first scene: data sets draw theirs from lower ones."""

SAMPLES = 16

COLUMNS = [
    "case", "system", "depth_mm", "psnr_db", "psnr_sd", "psnr_lit_db", "ssim", "ssim_sd",
    "by_heart",
]  # fmt: skip


@dataclass(frozen=True)
class Case:
    """A way of placing the objects of a data set.

    Parameters
    ----------
    name : str
    depths_mm : tuple of float
        Of each object.
    present : tuple of int
        Objects that are there.
    """

    name: str
    depths_mm: tuple[float, ...]
    present: tuple[int, ...]

    def place(self, scene: Scene, config: DatasetConfig) -> Scene:
        """Place the objects of a scene so."""
        placed = scene.at_depths(self.depths_mm, config.camera)
        return Scene([placed.layers[k] for k in self.present])


def make_cases(config: DatasetConfig) -> list[Case]:
    """List the ways of placing the objects of a data set; the first is its own.

    Raises
    ------
    InputError
        If there is but one object, so that nothing can change places.
    """
    own, names = config.depths_mm, [item.name for item in config.template.objects]
    if len(set(own)) < 2:
        raise InputError(
            f"The swap test needs objects at two depths at least, those of {config.kind} stand at "
            f"{', '.join(f'{z:g}' for z in own)} mm."
        )
    everyone = tuple(range(len(own)))
    half = float(np.diff(np.unique(own)).min()) / 2
    cases = [
        Case("as trained", tuple(own), everyone),
        Case("first and last exchanged", (own[-1], *own[1:-1], own[0]), everyone),
        Case("order reversed", tuple(own[::-1]), everyone),
        Case(f"all {half:g} mm nearer", tuple(z - half for z in own), everyone),
        Case(f"{names[0]} alone", tuple(own), (0,)),
    ]
    # Of two or three objects, exchanging the ends is reversing the order.
    return list({(case.depths_mm, case.present): case for case in cases[::-1]}.values())[::-1]


@dataclass(frozen=True, eq=False)
class System:
    """What refocuses a light field at the slopes of a data set.

    Parameters
    ----------
    name : str
    title : str
        What it is, for tables.
    trained : {"", "fixed depths", "shuffled depths"}
        With which objects; a reference is not trained.
    about : dict
        Record of its training.
    encode : callable
        Takes a light field, gives what the system is shown.
    refocus : callable
        Takes what it is shown of n light fields, gives images (n, planes, h, w).
    """

    name: str
    title: str
    trained: str
    about: dict
    encode: Callable[[LightField], np.ndarray]
    refocus: Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True, eq=False)
class Outcome:
    """What the systems made of one case.

    Parameters
    ----------
    case : Case
    truth, learnt : ndarray of float32, shape (n, planes, h, w)
        Refocused by shift-and-sum: the scenes as they are, and with every object at its own depth.
    drawn : dict of str to ndarray of float32, shape (n, planes, h, w)
        By system.
    """

    case: Case
    truth: np.ndarray
    learnt: np.ndarray
    drawn: dict[str, np.ndarray]


def load_systems(runs: Sequence[Path]) -> tuple[DatasetConfig, list[float], list[System]]:
    """Load trained networks that differ in nothing but in what they were shown and trained with.

    Returns
    -------
    DatasetConfig
        Of the first; the scenes are drawn by it.
    list of float
        Slopes of the planes.
    list of System
        Shift-and-sum of some views, as a reference, and the networks.

    Raises
    ------
    InputError
        If a run is missing, or two were made for other scenes or cameras.
    """
    opened = [open_run(run) for run in runs]
    _, first = opened[0]
    systems = [
        _sparse(first, encoding) for encoding in (InputEncoding("views"), InputEncoding("grid"))
    ]
    for run, (record, dataset) in zip(runs, opened, strict=True):
        if scene_settings(dataset.config) != scene_settings(first.config):
            raise InputError(
                f"{run} was trained on other scenes than {runs[0]}, or for another camera; "
                f"test them one by one."
            )
        name = run.name if [other.name for other in runs].count(run.name) == 1 else str(run)
        systems.append(_network(name, run, record, dataset.config))
    return first.config, first.attrs["slopes"], systems


def scene_settings(config: DatasetConfig) -> dict:
    """Keep what makes two data sets hold the same scenes, but for the depths of the objects."""
    free = ("input", "shuffled_depths", "samples")
    return {key: value for key, value in to_json(config).items() if key not in free}


def _sparse(dataset, encoding: InputEncoding) -> System:
    """Shift-and-sum of those views alone that an encoding shows, all as bright as they are."""
    views, slopes = dataset.config.camera.views, dataset.attrs["slopes"]
    down, across = encoding.chosen(views, views)
    weights = sparse_aperture((views, views), list(product(down.ravel(), across.ravel())))
    count = int(weights.sum())

    def refocus(light_field: LightField) -> np.ndarray:
        stack = shift_and_sum(light_field, slopes, weights=weights)
        return area_average(stack, dataset.config.image)

    name = f"shift-and-sum of {count} views"
    return System(name, name, "", {}, refocus, np.asarray)


def _network(name: str, run: Path, record: dict, config: DatasetConfig) -> System:
    model = load_model(run / "model.keras")

    def refocus(shown: np.ndarray) -> np.ndarray:
        return model.predict(shown, batch_size=8, verbose=0)[..., 0]

    trained = "shuffled depths" if config.shuffled_depths else "fixed depths"
    title = f"{name}: shown {config.input.kind}, trained with {trained}, {record['preset']} recipe"
    about = {key: value for key, value in record.items() if key != "test_indices"}
    return System(name, title, trained, about, config.encode, refocus)


def run_cases(
    config: DatasetConfig, slopes: Sequence[float], systems: Sequence[System], samples: int
) -> Iterator[Outcome]:
    """Render the scenes of each case and let all systems refocus them.

    Yields
    ------
    Outcome
    """
    cases = make_cases(config)
    learnt = None
    for case in cases:
        truth, shown = _render_case(config, slopes, case, systems, samples)
        learnt = truth if learnt is None else learnt  # the first case is as trained
        drawn = {
            system.name: system.refocus(np.stack(seen))
            for system, seen in zip(systems, shown, strict=True)
        }
        yield Outcome(case, truth, learnt, drawn)


def draw_case(config: DatasetConfig, case: Case, samples: int) -> Iterator[LightField]:
    """Draw light fields whose objects are placed so, of the same scenes for every case.

    Yields
    ------
    LightField
    """
    mean, _ = config.template.draw(None)
    plan = plan_effects(case.place(mean, config), config.camera, effects=config.effects)
    for index in range(FIRST_SAMPLE, FIRST_SAMPLE + samples):
        scene, _ = config.template.draw(np.random.default_rng([config.seed, index]))
        yield render_drawn(case.place(scene, config), config, plan, index)


def _render_case(config, slopes, case: Case, systems, samples: int):
    truth, shown = [], [[] for _ in systems]
    for light_field in draw_case(config, case, samples):
        truth.append(area_average(shift_and_sum(light_field, slopes), config.image))
        for seen, system in zip(shown, systems, strict=True):
            seen.append(system.encode(light_field))
    return np.stack(truth), shown


def tabulate(outcomes: Iterable[Outcome], depths_mm: Sequence[float]) -> pd.DataFrame:
    """Score every system on every case, plane by plane; columns as in `COLUMNS`.

    The rows of depth NaN hold the mean over the planes, and the share that a system knows by heart
    over all of them.
    """
    tables = []
    for outcome in outcomes:
        for name, images in outcome.drawn.items():
            scores = score(outcome.truth, images)
            means = scores.mean().to_frame().T
            planes = [
                by_heart(*(x[:, k] for x in (images, outcome.truth, outcome.learnt)))
                for k in range(len(depths_mm))
            ]
            whole = by_heart(images, outcome.truth, outcome.learnt)
            scores = scores.assign(depth_mm=depths_mm, by_heart=planes)
            means = means.assign(depth_mm=np.nan, by_heart=whole)
            rows = pd.concat([scores, means])
            tables.append(rows.assign(case=outcome.case.name, system=name))
    return pd.concat(tables, ignore_index=True)[COLUMNS]


def by_heart(drawn: np.ndarray, truth: np.ndarray, learnt: np.ndarray) -> float:
    """Find the share of what is learnt that a system draws, see above; NaN: nothing differs."""
    way = (learnt - truth).astype(float)
    squares = np.sum(way**2)
    if squares == 0:
        return np.nan
    return float(np.sum((drawn - truth) * way) / squares)


def run_swap_test(
    runs: Sequence[Path],
    out: Path,
    samples: int = SAMPLES,
    progress: Callable[[Iterable, int, int], Iterable] | None = None,
) -> Path:
    """Test trained networks, and write the report.

    Parameters
    ----------
    runs : sequence of Path
        Folders of finished runs.
    out : Path
        Folder for the report, see `lf_flame.swaptest_report.write_report`.
    samples : int, optional
        Scenes for each case.
    progress : callable, optional
        ``progress(outcomes, done, total)`` wraps the iterable of outcomes.

    Returns
    -------
    Path
        The report's Markdown file.

    Raises
    ------
    InputError
        See `load_systems` and `make_cases`; or if there are no samples.
    """
    from lf_flame import swaptest_report

    if samples < 1:
        raise InputError(f"The swap test needs at least 1 scene for each case, got {samples}.")
    config, slopes, systems = load_systems(runs)
    cases = len(make_cases(config))
    outcomes = run_cases(config, slopes, systems, samples)
    outcomes = list(outcomes if progress is None else progress(outcomes, 0, cases))
    table = tabulate(outcomes, config.depths_mm)
    return swaptest_report.write_report(config, slopes, systems, outcomes, table, out)
