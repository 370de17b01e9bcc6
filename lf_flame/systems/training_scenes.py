"""Training samples: light fields to learn refocusing from, each seen at several slopes.

Most of them show the paper's scenes with every object at a depth drawn anew, so that
nothing can be memorised; the rest are dead leaves, which look like photographs. What a system
should draw is what all views give, by shift-and-sum or by the Fourier slice. Where the effect plan
allows, that comes straight from the scene (`lf_flame.projection`), and so do the views that a
system looks at; no light field is formed.
"""

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from lf_flame._common.config import strict
from lf_flame.datasets.config import DatasetConfig, read_config
from lf_flame.errors import InputError
from lf_flame.optics.sensor import Sensor, expose
from lf_flame.projection import Projector
from lf_flame.scenes.dead_leaves import DeadLeaves
from lf_flame.scenes.scene import Scene
from lf_flame.simulation.layouts import blank_image
from lf_flame.simulation.rendering import render_plan
from lf_flame.systems.base import NetworkSystem, ViewIndices
from lf_flame.systems.formulas import REFERENCES, average

BEYOND_MM = 3.0
"""How far beyond the depths of a template its objects may stand."""

PROJECTED = "shift-and-sum"
"""The one of the `REFERENCES` that needs no light field."""

SEED_OF_SCENES = 7
"""Keeps these scenes apart from those of data sets, which are drawn from (seed, index)."""

Looks = Callable[[int, int], ViewIndices]
"""From the numbers of rows and columns of views to the indices of those that are looked at."""


@dataclass(frozen=True, eq=False)
class TrainingSample:
    """A light field, or its scene, and slopes at which to look at it.

    Attributes
    ----------
    views : ndarray of float32, shape (v, u, t, s)
        All, or without a light field those that are looked at; the others are 0.
    slopes : ndarray of float64, shape (n,)
        In lenslets per view step.
    block : (int, int)
        Lenslets in a pixel of the images.
    seen : ndarray of float32, shape (v, u, t, s)
        The views with noise; without any they are `views`.
    projector : Projector, optional
        Of the scene, where there is no light field.
    """

    views: np.ndarray
    slopes: np.ndarray
    block: tuple[int, int]
    seen: np.ndarray
    projector: Projector | None = None

    def truth(self, slopes: np.ndarray, reference: str = "shift-and-sum") -> np.ndarray:
        """Refocus with all views, without noise: float32, shape (n, h, w); see `REFERENCES`.

        Raises
        ------
        InputError
            If there is no light field and the reference needs one.
        """
        if self.projector is not None:
            if reference != PROJECTED:
                raise InputError(
                    f"A sample without its light field knows no {reference!r}; draw all views."
                )
            return np.clip(self.projector.refocus(slopes, block=self.block), 0, 1)
        return average(REFERENCES[reference](self.views, slopes), self.block)


@strict
@dataclass(frozen=True)
class TrainingSamples:
    """Where training samples come from.

    Parameters
    ----------
    data : list of str
        Files of data-set configurations whose scenes are shown in turn.
    leaves : float
        Share of the light fields that are dead leaves.
    leaf_views : int
        Views of these along each axis.
    slopes : int
        At which each light field is seen: half of them where something is sharp, the rest anywhere
        between.
    look : DeadLeaves
    electrons : (float, float)
        That a pixel at full scale holds in low light; drawn evenly in its logarithm.
    """

    data: list[str]
    leaves: float = 0.4
    leaf_views: int = 9
    slopes: int = 6
    look: DeadLeaves = DeadLeaves()
    electrons: tuple[float, float] = (0.3, 300.0)

    def __post_init__(self):
        if not self.data or not 0 <= self.leaves <= 1 or min(self.slopes, self.leaf_views) < 1:
            raise InputError(
                f"Training samples need a data set, a share of leaves from 0 to 1, and slopes and "
                f"views of 1 or more, got {len(self.data)}, {self.leaves}, {self.slopes}, "
                f"{self.leaf_views}."
            )
        if not 0 < self.electrons[0] <= self.electrons[1] < np.inf:
            raise InputError(f"electrons must be two rising numbers above 0, got {self.electrons}.")

    @cached_property
    def configs(self) -> list[DatasetConfig]:
        """The data sets' configurations; their images must be of one size."""
        configs = [read_config(Path(path)) for path in self.data]
        sizes = {config.image for config in configs}
        if len(sizes) > 1:
            raise InputError(
                f"Training samples need images of one size, {self.data} have {sorted(sizes)}."
            )
        return configs

    def draw(
        self, seed: int, index: int, low_light: float = 0.0, looks: Looks | None = None
    ) -> TrainingSample:
        """Draw a sample that depends on these numbers alone; a share of them is in low light.

        Parameters
        ----------
        seed, index : int
        low_light : float, optional
        looks : callable, optional
            Which views are looked at: no more are made, where the effect plan and the light allow,
            and no light field is formed. Default: all.
        """
        rng = np.random.default_rng([seed, index, SEED_OF_SCENES])
        if rng.uniform() < self.leaves:
            sample = self._draw_leaves(rng)
            dark = rng.uniform() < low_light
        else:
            config = self.configs[rng.integers(len(self.configs))]
            scene, slopes, noise = self._draw_scene(config, rng)
            dark = rng.uniform() < low_light
            # Noise is drawn for every view, in its order.
            sample = _simulate(config, scene, slopes, noise, None if dark else looks)
        if not dark:
            return sample
        light = Sensor(exposure_e=np.exp(rng.uniform(*np.log(self.electrons))))
        return replace(sample, seen=expose(sample.views, light, {"shot_noise"}, rng))

    def _draw_leaves(self, rng: np.random.Generator) -> TrainingSample:
        image = self.configs[0].image
        views = self.look.draw((self.leaf_views, self.leaf_views), image, rng).views
        slopes = rng.uniform(*self.look.slopes, self.slopes)
        return TrainingSample(views, slopes, (1, 1), views)

    def _draw_scene(
        self, config: DatasetConfig, rng: np.random.Generator
    ) -> tuple[Scene, np.ndarray, int]:
        """Draw a scene, the slopes at which it is seen, and the seed of its sensor's noise."""
        scene, _ = config.template.draw(rng)
        own = np.array(config.depths_mm)
        depths = rng.permutation(own)
        if rng.uniform() < 0.5:
            depths = rng.uniform(own.min() - BEYOND_MM, own.max() + BEYOND_MM, len(own))
        placed = scene.at_depths(depths, config.camera)
        noise = int(rng.integers(2**31))
        sharp = np.array([config.camera.depth_to_slope(depth) for depth in depths])
        low, high = sharp.min() - 0.2, sharp.max() + 0.2
        chosen = np.resize(rng.permutation(sharp), self.slopes // 2)
        between = rng.uniform(low, high, self.slopes - len(chosen))
        return placed, np.concatenate([chosen, between]), noise


def _simulate(
    config: DatasetConfig, scene: Scene, slopes: np.ndarray, noise: int, looks: Looks | None
) -> TrainingSample:
    """Make the views that are looked at, straight from the scene if the plan allows; or all."""
    camera, plan = config.camera, config.plan_of(scene)
    if looks is None or plan.not_separable:
        views = render_plan(scene, camera, plan, seed=noise).views
        return TrainingSample(views, slopes, config.block, views)
    projector, views = Projector(scene, camera, plan), blank_image(camera, "views")
    indices = looks(camera.views, camera.views)
    views[tuple(np.transpose(indices))] = projector.align_views(0.0, indices)[0]
    return TrainingSample(views, slopes, config.block, views, projector)


def draw_arrays(
    training_samples: TrainingSamples,
    system: NetworkSystem,
    seed: int,
    indices: Collection[int],
    reference: str = "shift-and-sum",
    low_light: float = 0.0,
) -> tuple[np.ndarray, np.ndarray]:
    """Make what a network is shown, and what it should draw.

    Parameters
    ----------
    training_samples : TrainingSamples
    system : lf_flame.systems.base.NetworkSystem
    seed : int
    indices : collection of int
        Of the training samples.
    reference : str, optional
        What all views give: a key of `lf_flame.systems.formulas.REFERENCES`.
    low_light : float, optional
        Share of the light fields that are seen in low light, with shot noise.

    Returns
    -------
    ndarray of float32, shape (n, h, w, channels)
    ndarray of float32, shape (n, h, w, channels)
    """
    arrays: list[np.ndarray] = []
    looks = system.view_indices if reference == PROJECTED else None
    for k, index in enumerate(indices):
        sample = training_samples.draw(seed, index, low_light, looks)
        slopes = system.slopes_to_learn(sample.slopes, sample.block)
        images = (
            system.show(sample.seen, slopes, sample.block),
            system.truth(sample.truth(slopes, reference)),
        )
        if not arrays:  # at once for all: these are gigabytes
            arrays = [np.empty((len(indices), *x.shape), np.float32) for x in images]
        for array, some in zip(arrays, images, strict=True):
            array[k] = some
    shown, truth = (array.reshape(-1, *array.shape[2:]) for array in arrays)
    return shown, truth
