"""The contest: every refocusing system on the same light fields, by the same measures.

Right is shift-and-sum of all views. Test sets are the paper's two, light fields that no network was
trained on; the same scenes with their objects at other depths; and photographs. All systems refocus
from views in memory to images in memory, on all cores; each is timed in a process of its own, whose
peak memory is what it takes.
"""

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from lf_flame import figures, provenance
from lf_flame.datasets import DatasetConfig, render_sample
from lf_flame.errors import InputError
from lf_flame.evaluation import load_run, score
from lf_flame.files import write_json, write_text
from lf_flame.lightfield import LightField
from lf_flame.refocus_costs import find_scenes
from lf_flame.sensor import Sensor, expose
from lf_flame.swaptest import draw_case, make_cases
from lf_flame.systems import contest_figures, contest_report
from lf_flame.systems.classical import (
    TRUTHS,
    FourierSlice,
    ShiftAndSum,
    average,
    cross_of_views,
    lattice_of_views,
    square_of_views,
)
from lf_flame.systems.learning import load_system
from lf_flame.systems.networks import NETWORKS
from lf_flame.systems.price import price
from lf_flame.systems.refnet import ALPHAS, SLOPES
from lf_flame.systems.refocusnet import RefocusNet, build_refocusnet, load_official_weights
from lf_flame.systems.resnet50 import ResNet50
from lf_flame.systems.system import RefocusingSystem

COLUMNS = [
    "test_set", "truth", "electrons", "system", "views", "slope", "plane", "psnr_db", "psnr_sd",
    "psnr_lit_db", "psnr_lit_sd", "ssim", "ssim_sd", "light_fields", "why_missing",
]  # fmt: skip

BORDER = 12
"""Pixels that are cut off a photograph's images before they are scored: views end there."""

SMALLEST = 2 * BORDER + 11
"""Side of a photograph that leaves a window of the structural similarity."""


@dataclass(frozen=True)
class Contestant:
    """A system that can be loaded, here or in another process.

    Attributes
    ----------
    name : str
    load : callable
        Takes nothing, gives the system; can be pickled. Raises InputError where it is missing.
    about : dict
        How it was trained, for the record.
    only : str
        Test sets whose name starts so; "": all.
    """

    name: str
    load: Callable[[], RefocusingSystem]
    about: dict
    only: str = ""


@dataclass(frozen=True, eq=False)
class Scene:
    """A light field to be refocused.

    Attributes
    ----------
    views : ndarray of float32, shape (v, u, t, s) or (v, u, t, s, channels)
    slopes : ndarray of float64, shape (n,)
    block : (int, int)
        Lenslets in a pixel of the images.
    border : int
        Pixels of the images that are not scored.
    clean : ndarray, optional
        The views without noise, where these have some.
    """

    views: np.ndarray
    slopes: np.ndarray
    block: tuple[int, int] = (1, 1)
    border: int = 0
    clean: np.ndarray | None = None

    def truth(self, right: str = "shift-and-sum") -> np.ndarray:
        """Refocus with all views, without noise, by one of the `TRUTHS`."""
        views = self.views if self.clean is None else self.clean
        return average(TRUTHS[right](views, self.slopes), self.block)


@dataclass(frozen=True)
class TestSet:
    """Light fields that are refocused at the same planes.

    Attributes
    ----------
    name : str
    planes : list of str
        What the planes are called.
    scenes : callable
        Takes nothing, yields scenes.
    electrons : float
        That a pixel at full scale holds; infinite: no noise.
    truth : str
        What is right: a key of `lf_flame.systems.classical.TRUTHS`.
    """

    __test__ = False  # for pytest, which would collect it

    name: str
    planes: list[str]
    scenes: Callable[[], Iterator[Scene]]
    electrons: float = np.inf
    truth: str = "shift-and-sum"

    def in_the_dark(self, electrons: float, seed: int) -> "TestSet":
        """Take the same scenes in less light: with shot noise, as in a short exposure.

        Parameters
        ----------
        electrons : float
            That a pixel at full scale holds.
        seed : int
            Of the noise.
        """
        return replace(
            self, scenes=partial(_noisy, self.scenes, electrons, seed), electrons=electrons
        )


def _noisy(scenes: Callable[[], Iterator[Scene]], electrons: float, seed: int) -> Iterator[Scene]:
    sensor = Sensor(exposure_e=electrons)
    for index, scene in enumerate(scenes()):
        rng = np.random.default_rng([seed, index])
        seen = expose(scene.views, sensor, {"shot_noise"}, rng)
        yield replace(scene, views=seen, clean=scene.views)


def paper_sets(config: DatasetConfig, run: Path, count: int) -> list[TestSet]:
    """Make the test sets of a data set: its own test split, and its objects at other depths.

    Parameters
    ----------
    config : DatasetConfig
        What light fields are drawn from where there is no run.
    run : Path
        Of the paper's network, whose test split it is, see `lf_flame.refocus_costs.find_scenes`.
    count : int
        Light fields of each set.
    """
    held_out = find_scenes(config, run, count)
    config, slopes = held_out.config, np.array(held_out.slopes)
    planes = [f"{z:g} mm" for z in config.depths_mm]
    own = partial(_own_scenes, config, slopes, held_out.indices)
    sets = [TestSet(config.kind, planes, own)]
    whole = [case for case in make_cases(config) if len(case.present) == len(config.depths_mm)]
    for case in whole[1:]:  # the first is as trained
        # Of those that keep the depths, the planes stay; else they move with the objects.
        depths = (
            case.depths_mm if set(case.depths_mm) != set(config.depths_mm) else config.depths_mm
        )
        at = np.array([config.camera.depth_to_slope(z) for z in depths])
        placed = partial(_placed_scenes, config, case, at, count)
        sets.append(TestSet(f"{config.kind}, {case.name}", [f"{z:g} mm" for z in depths], placed))
    return [*sets, *_at_sixteen_slopes(config, held_out.indices)]


def _at_sixteen_slopes(config: DatasetConfig, indices: Sequence[int]) -> Iterator[TestSet]:
    """Take the test split at RefNet's own slopes, and what is right by both ways."""
    slopes, planes = SLOPES * config.block[0], [f"alpha {alpha:g}" for alpha in ALPHAS]
    for truth in TRUTHS:
        scenes = partial(_own_scenes, config, slopes, indices)
        yield TestSet(f"{config.kind}{contest_report.SIXTEEN}", planes, scenes, truth=truth)


def _own_scenes(config, slopes, indices) -> Iterator[Scene]:
    for index in indices:
        yield Scene(render_sample(config, index)[0].views, slopes, config.block)


def _placed_scenes(config, case, slopes, count) -> Iterator[Scene]:
    for light_field in draw_case(config, case, count):
        yield Scene(light_field.views, slopes, config.block)


def photograph_set(name: str, light_field: LightField, slopes: Sequence[float]) -> TestSet:
    """Make a test set of a photographed light field.

    Raises
    ------
    InputError
        If its images are too small to be scored.
    """
    height, width = light_field.views.shape[2:4]
    if min(height, width) < SMALLEST:
        raise InputError(
            f"A photograph to compare on needs views of {SMALLEST} pixels or more along each side, "
            f"{name} has {height} x {width}."
        )
    slopes = np.array(slopes, float)
    scene = Scene(light_field.views, slopes, border=BORDER)
    return TestSet(name, [f"slope {slope:g}" for slope in slopes], lambda: iter([scene]))


def classical_contestants() -> list[Contestant]:
    """List the systems that need no training."""
    some = {
        "shift-and-sum, 3 x 3 views": square_of_views,
        "shift-and-sum, lattice of 9 views": lattice_of_views,
        "shift-and-sum, cross of 17 views": cross_of_views,
        "shift-and-sum, 7 x 7 views": partial(square_of_views, side=7),
    }
    return [
        Contestant("shift-and-sum, all views", ShiftAndSum, {}),
        Contestant("Fourier slice, all views", FourierSlice, {}),
        *(
            Contestant(name, partial(ShiftAndSum, name, places), {})
            for name, places in some.items()
        ),
    ]


def trained_contestants(runs: Path, official_refocusnet: Path | None = None) -> list[Contestant]:
    """List the networks of a folder of runs; those that are not there will show as missing.

    Parameters
    ----------
    runs : Path
        With a run folder for each network, see `lf_flame.systems.networks`, and ``shapes`` and
        ``flames``, those of the paper's.
    official_refocusnet : Path, optional
        The authors' trained weights, see `lf_flame.systems.refocusnet.load_official_weights`.
    """
    found = []
    for name, network in NETWORKS.items():
        load = partial(load_system, runs / name)
        found.append(Contestant(network.title, load, _about(runs / name)))
    if official_refocusnet:
        load = partial(load_official, official_refocusnet)
        found.append(Contestant("RefocusNet, the authors' weights", load, {}))
    for kind in ("shapes", "flames"):
        load = partial(ResNet50.of_run, runs / kind)
        name = f"{ResNet50.name}, trained on {kind}"
        found.append(Contestant(name, load, _about(runs / kind), only=kind))
    return found


def load_official(path: Path) -> RefocusNet:
    """Load RefocusNet with the authors' weights."""
    model = build_refocusnet()
    load_official_weights(model, path)
    return RefocusNet(model)


def _about(folder: Path) -> dict:
    """Read the record of a run, with the seconds that it took; nothing where there is none."""
    try:
        record = load_run(folder)
    except InputError:
        return {}
    record.pop("test_indices", None)
    return {**record, "seconds": record["start_s"] + record["train_s"]}


def score_system(
    system: RefocusingSystem,
    name: str,
    test_set: TestSet,
    truths: Iterable[np.ndarray] | None = None,
) -> pd.DataFrame:
    """Score a system on a test set, plane by plane; columns as in `COLUMNS`.

    What it refuses shows as missing, with its own words.

    Parameters
    ----------
    system : RefocusingSystem
    name : str
        What the table calls it.
    test_set : TestSet
    truths : iterable of ndarray, optional
        Of its scenes, where they are known already.
    """
    pairs = []
    for scene, truth in _with_truth(test_set, truths):
        try:
            images = system.refocus(scene.views, scene.slopes, scene.block)
        except InputError as error:
            return _missing(test_set, name, str(error))
        pairs.append([_inner(stack, scene.border) for stack in (truth, images)])
    table = score(*(np.stack(stacks) for stacks in zip(*pairs, strict=True)))
    table = table.rename(columns={"n_test": "light_fields"}).assign(
        test_set=test_set.name, truth=test_set.truth, electrons=test_set.electrons, system=name,
        views=len(set(system.chosen(*scene.views.shape[:2]))),
        slope=scene.slopes / scene.block[0], plane=test_set.planes, why_missing="",
    )  # fmt: skip
    return table[COLUMNS]


def _with_truth(test_set: TestSet, truths) -> Iterator[tuple[Scene, np.ndarray]]:
    if truths is not None:
        yield from zip(test_set.scenes(), truths, strict=True)
        return
    for scene in test_set.scenes():
        yield scene, scene.truth(test_set.truth)


def _missing(test_set: TestSet, name: str, reason: str) -> pd.DataFrame:
    row = {"test_set": test_set.name, "truth": test_set.truth, "electrons": test_set.electrons}
    row |= {"system": name, "why_missing": reason}
    return pd.DataFrame([row]).reindex(columns=COLUMNS)


def _inner(stack: np.ndarray, border: int) -> np.ndarray:
    return stack[:, border:-border, border:-border] if border else stack


def run_contest(
    contestants: Sequence[Contestant],
    test_sets: Sequence[TestSet],
    out: Path,
    progress: Callable[[Iterable, int, int], Iterable] | None = None,
) -> Path:
    """Let systems refocus test sets, and write the report.

    Parameters
    ----------
    contestants : sequence of Contestant
    test_sets : sequence of TestSet
        The first scene of the first one is the frame that systems are timed on.
    out : Path
        Folder for ``compare.csv``, ``systems.csv``, ``compare.md``, ``.png`` and ``.json``.
    progress : callable, optional
        ``progress(steps, done, total)`` wraps the iterable of steps.

    Returns
    -------
    Path
        ``compare.md``.
    """
    started = time.perf_counter()
    frame = next(test_sets[0].scenes())
    steps = len(test_sets) * len(contestants) + len(contestants)
    results = _compete(contestants, test_sets, frame)
    results = list(results if progress is None else progress(results, 0, steps))
    scores = pd.concat([x for x in results if isinstance(x, pd.DataFrame)], ignore_index=True)
    prices = pd.DataFrame([x for x in results if isinstance(x, dict)])
    record = {
        "systems": {one.name: one.about for one in contestants},
        "test_sets": list(dict.fromkeys(one.name for one in test_sets)),
        "frame": {
            "planes": len(frame.slopes),
            "image": " x ".join(str(n) for n in frame.truth().shape[1:]),
            "views": " x ".join(str(n) for n in frame.views.shape[:2]),
        },
        "wall_s": round(time.perf_counter() - started, 1),
        **provenance.environment(),
    }
    write_text(out / "compare.csv", scores.round(5).to_csv(index=False))
    write_text(out / "systems.csv", prices.round(3).to_csv(index=False))
    write_text(out / "compare.md", contest_report.text(scores, prices, record))
    clean, dark = contest_report.without_noise(scores), scores[np.isfinite(scores.electrons)]
    figures.save(contest_figures.figure(clean, prices), out / "compare.png")
    if len(dark):
        figures.save(contest_figures.noise_figure(dark), out / "compare_noise.png")
    write_json(out / "compare.json", record)
    return out / "compare.md"


def _compete(contestants, test_sets, frame: Scene) -> Iterator[pd.DataFrame | dict]:
    """Yield what each system takes, then its scores, test set by test set."""
    loaded = {}
    for one in contestants:
        loaded[one.name] = _loaded(one)
        yield _described(one, loaded[one.name], frame)
    for test_set in test_sets:
        truths = [scene.truth(test_set.truth) for scene in test_set.scenes()]
        for one in contestants:
            system = loaded[one.name]
            if isinstance(system, InputError):
                yield _missing(test_set, one.name, str(system))
            elif not test_set.name.startswith(one.only):
                yield _missing(test_set, one.name, f"it was trained on {one.only}.")
            else:
                yield score_system(system, one.name, test_set, truths)


def _loaded(contestant: Contestant) -> RefocusingSystem | InputError:
    try:
        return contestant.load()
    except InputError as error:
        return error


def _described(contestant: Contestant, system, frame: Scene) -> dict:
    row = {"system": contestant.name, "views": np.nan, "parameters": np.nan}
    row |= {"training_s": np.nan, "milliseconds": np.nan, "memory_mb": np.nan}
    if isinstance(system, InputError):
        return row
    row |= {"parameters": system.parameters, "training_s": contestant.about.get("seconds", np.nan)}
    try:
        row["views"] = len(set(system.chosen(*frame.views.shape[:2])))
        system.refocus(frame.views, frame.slopes, frame.block)
    except InputError:
        return row
    return row | asdict(price(contestant.load, frame.views, frame.slopes, frame.block))
