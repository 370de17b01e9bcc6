"""What refocusing systems are compared on: light fields, and the slopes to refocus them at.

The paper's two data sets, light fields that no network was trained on; the same scenes with their
objects at other depths; the sixteen slopes of RefNet; the same in less light; and photographs.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from experiments.depth_scenarios import draw_scenario, make_scenarios, scene_settings
from experiments.held_out import find_scenes
from lf_flame.datasets.config import DatasetConfig
from lf_flame.datasets.sampling import render_sample
from lf_flame.errors import InputError
from lf_flame.formats.images import white_level
from lf_flame.lightfield import LightField
from lf_flame.optics.sensor import Sensor, expose
from lf_flame.refocus._arguments import as_slopes
from lf_flame.systems.formulas import REFERENCES, average
from lf_flame.systems.refnet import ALPHAS, SLOPES

SIXTEEN = ", RefNet's slopes"
"""Ends the names of test sets at the sixteen slopes of RefNet."""

BOTH = "shift-and-sum", "Fourier slice"
"""References at the slopes of RefNet: what all views give, by either method."""

ROUND = "round aperture"

BORDER = 12
"""Pixels that are cut off a photograph's images, or more where views end farther inside."""

WINDOW = 11
"""Pixels that the structural similarity looks at together."""


@dataclass(frozen=True, eq=False)
class Scene:
    """A light field [v, u, t, s(, channel)] to be refocused at slopes.

    A block are the lenslets in a pixel of the images; a border of their pixels is not scored;
    `clean` are the views without noise, where these have some.
    """

    views: np.ndarray
    slopes: np.ndarray
    block: tuple[int, int] = (1, 1)
    border: int = 0
    clean: np.ndarray | None = None

    def truth(self, reference: str = "shift-and-sum") -> np.ndarray:
        """Refocus with all views, without noise, by one of the `REFERENCES`."""
        views = self.views if self.clean is None else self.clean
        return average(REFERENCES[reference](views, self.slopes), self.block)


@dataclass(frozen=True)
class TestSet:
    """Light fields that are refocused at the same planes, whose names are listed.

    Scenes come from a callable that takes nothing. A pixel at full scale holds so many electrons;
    infinite: no noise. The truth is a key of `lf_flame.systems.formulas.REFERENCES`; the origin
    says where the scenes come from, for the record.
    """

    __test__ = False  # for pytest, which would collect it

    name: str
    planes: list[str]
    scenes: Callable[[], Iterator[Scene]]
    electrons: float = np.inf
    truth: str = "shift-and-sum"
    origin: str = ""

    def in_low_light(self, electrons: float, seed: int) -> "TestSet":
        """Take the same scenes in less light: with shot noise of electrons at full scale."""
        scenes = partial(_noisy, self.scenes, Sensor(exposure_e=electrons), seed)
        return replace(self, scenes=scenes, electrons=electrons)


def _noisy(scenes: Callable[[], Iterator[Scene]], sensor: Sensor, seed: int) -> Iterator[Scene]:
    for index, scene in enumerate(scenes()):
        rng = np.random.default_rng([seed, index])
        seen = expose(scene.views, sensor, {"shot_noise"}, rng)
        yield replace(scene, views=seen, clean=scene.views)


def paper_sets(config: DatasetConfig, run: Path, count: int) -> list[TestSet]:
    """Make the test sets of a data set: its own test split, and its objects at other depths.

    Light fields are drawn from the configuration where there is no run of the paper's network,
    whose test split it is. An InputError says that the run was trained on other scenes, or that all
    objects of the data set stand at one depth.
    """
    held_out = find_scenes(config, run, count)
    if scene_settings(held_out.config) != scene_settings(config):
        raise InputError(
            f"{run} was trained on other scenes, or for another camera, than the {config.kind} to "
            f"compare on; compare with a folder of runs without it."
        )
    config, slopes = held_out.config, np.array(held_out.slopes)
    planes = [f"{z:g} mm" for z in config.depths_mm]
    own = partial(_own_scenes, config, slopes, held_out.indices)
    split = (
        f"test split of {run}" if held_out.run else f"last samples; no network, {held_out.origin}"
    )
    indices = ", ".join(str(index) for index in held_out.indices)
    origin = f"samples {indices} ({split})"
    sets = [TestSet(config.kind, planes, own, origin=origin)]
    whole = [
        scenario
        for scenario in make_scenarios(config)
        if len(scenario.present) == len(config.depths_mm)
    ]
    for scenario in whole[1:]:  # the first is as trained
        # Of those that keep the depths, the planes stay; else they move with the objects.
        depths = (
            scenario.depths_mm
            if set(scenario.depths_mm) != set(config.depths_mm)
            else config.depths_mm
        )
        at = np.array([config.camera.depth_to_slope(z) for z in depths])
        placed = partial(_placed_scenes, config, scenario, at, count)
        name, planes = f"{config.kind}, {scenario.name}", [f"{z:g} mm" for z in depths]
        sets.append(TestSet(name, planes, placed, origin=f"drawn by seed {config.seed}"))
    sets.append(replace(sets[0], name=f"{config.kind}, {ROUND}", truth=ROUND))
    # RefNet's own slopes, with a reference by either method.
    planes = [f"alpha {alpha:g}" for alpha in ALPHAS]
    scenes = partial(_own_scenes, config, SLOPES * config.block[0], held_out.indices)
    sixteen = TestSet(f"{config.kind}{SIXTEEN}", planes, scenes, origin=origin)
    return [*sets, *(replace(sixteen, truth=truth) for truth in BOTH)]


def _own_scenes(config, slopes, indices) -> Iterator[Scene]:
    for index in indices:
        yield Scene(render_sample(config, index)[0].views, slopes, config.block)


def _placed_scenes(config, scenario, slopes, count) -> Iterator[Scene]:
    for light_field in draw_scenario(config, scenario, count):
        yield Scene(light_field.views, slopes, config.block)


def photograph_sets(name: str, light_field: LightField, slopes: Sequence[float]) -> list[TestSet]:
    """Make the test sets of a photographed light field, as bright as systems take them: up to 1.

    The reference of one is all views, a square aperture; that of the other the views in a round
    one. An InputError says that its images are too small to be scored at these slopes.
    """
    slopes, (rows, columns, height, width) = as_slopes(slopes), light_field.views.shape[:4]
    reach = np.abs(slopes).max() * (max(rows, columns) - 1) / 2
    border = max(BORDER, int(np.ceil(reach)))
    if min(height, width) < 2 * border + WINDOW:
        raise InputError(
            f"To be compared on at these slopes {name} needs views of {2 * border + WINDOW} pixels "
            f"or more along each side, got {height} x {width}."
        )
    views = light_field.views / np.float32(white_level(light_field.views))
    scene = Scene(views, slopes, border=border)
    planes = [f"slope {slope:g}" for slope in slopes]
    whole = TestSet(name, planes, lambda: iter([scene]), origin="a photograph")
    return [whole, replace(whole, name=f"{name}, {ROUND}", truth=ROUND)]
