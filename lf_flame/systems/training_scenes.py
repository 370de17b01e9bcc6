"""Training samples: light fields to learn refocusing from, each at several slopes.

Most of them are the paper's scenes with every object at a random depth, so that nothing can be
memorised; the rest are dead leaves, which resemble photographs. The true image is that from all
views, by shift-and-sum or by the Fourier slice. Where the effect plan allows, it comes directly
from the scene (`lf_flame.projection`), like the views that a system uses; no light field is formed.
"""

from collections.abc import Callable, Collection
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from lf_flame._common import progress
from lf_flame._common.config import strict
from lf_flame.datasets.config import DatasetConfig, read_config
from lf_flame.errors import InputError
from lf_flame.projection import Projector
from lf_flame.scenes.dead_leaves import DeadLeaves
from lf_flame.scenes.scene import Scene
from lf_flame.simulation.layouts import blank_image
from lf_flame.simulation.rendering import render_plan
from lf_flame.systems.base import NetworkSystem, ViewIndices
from lf_flame.systems.formulas import REFERENCES, average

BEYOND_MM = 3.0
"""Largest distance in mm of an object beyond the depths of its template."""

PROJECTED = "shift-and-sum"
"""Name of the one of the `REFERENCES` that needs no light field."""

Looks = Callable[[int, int], ViewIndices]
"""Function from the number of rows and columns of views to the indices of the views used."""


@dataclass(frozen=True, eq=False)
class TrainingSample:
    """A light field, or its scene, with slopes at which to refocus it."""

    views: np.ndarray  # float32 [v, u, t, s]; without a light field, 0 in those that are not used
    slopes: np.ndarray  # in lenslets per view step
    block: tuple[int, int]  # number of lenslets in a pixel of the images, along (t, s)
    projector: Projector | None = None  # of the scene, if there is no light field

    def truth(self, slopes: np.ndarray, reference: str = PROJECTED) -> np.ndarray:
        """Refocus with all views: float32, shape (n, h, w); see `REFERENCES`."""
        if self.projector is None:
            return average(REFERENCES[reference](self.views, slopes), self.block)
        if reference != PROJECTED:
            raise InputError(
                f"A sample without its light field knows no {reference!r}; draw all views."
            )
        return np.clip(self.projector.refocus(slopes, block=self.block), 0, 1)


@strict
@dataclass(frozen=True)
class TrainingSamples:
    """Source of training samples: scenes of data sets, and dead leaves."""

    data: list[str]  # files of data-set configurations, chosen at random
    leaves: float = 0.4  # fraction of the light fields that are dead leaves
    leaf_views: int = 9  # number of views of these along each axis
    slopes: int = 6  # number for each light field; an object is in focus at half of them
    look: DeadLeaves = DeadLeaves()

    def __post_init__(self):
        if not self.data or not 0 <= self.leaves <= 1 or min(self.slopes, self.leaf_views) < 1:
            raise InputError(
                f"Training samples need a data set, a share of leaves from 0 to 1, and slopes and "
                f"views of 1 or more, got {len(self.data)}, {self.leaves}, {self.slopes}, "
                f"{self.leaf_views}."
            )

    @cached_property
    def configs(self) -> list[DatasetConfig]:
        """Configurations of the data sets; their images must have one size."""
        configs = [read_config(Path(path)) for path in self.data]
        sizes = {config.image for config in configs}
        if len(sizes) > 1:
            raise InputError(
                f"Training samples need images of one size, {self.data} have {sorted(sizes)}."
            )
        return configs

    def draw(self, seed: int, index: int, looks: Looks | None = None) -> TrainingSample:
        """Draw the sample of a seed and an index.

        `looks` selects the views to use: only these are computed, where the effect plan allows, and
        no light field is formed. Default: all views.
        """
        rng = np.random.default_rng([seed, index, 7])  # 7: data sets have (seed, index)
        if rng.uniform() < self.leaves:
            return self._draw_leaves(rng)
        config = self.configs[rng.integers(len(self.configs))]
        scene, slopes, noise = self._draw_scene(config, rng)
        return _simulate(config, scene, slopes, noise, looks)

    def _draw_leaves(self, rng: np.random.Generator) -> TrainingSample:
        image = self.configs[0].image
        views = self.look.draw((self.leaf_views, self.leaf_views), image, rng).views
        slopes = rng.uniform(*self.look.slopes, self.slopes)
        return TrainingSample(views, slopes, (1, 1))

    def _draw_scene(
        self, config: DatasetConfig, rng: np.random.Generator
    ) -> tuple[Scene, np.ndarray, int]:
        """Draw a scene, the slopes for it, and the seed of its sensor's noise."""
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
    """Compute the views to use, directly from the scene if the plan allows; or all views."""
    camera, plan = config.camera, config.plan_of(scene)
    if looks is None or plan.not_separable:
        views = render_plan(scene, camera, plan, seed=noise).views
        return TrainingSample(views, slopes, config.block)
    projector, views = Projector(scene, camera, plan), blank_image(camera, "views")
    indices = looks(camera.views, camera.views)
    views[tuple(np.transpose(indices))] = projector.align_views(0.0, indices)[0]
    return TrainingSample(views, slopes, config.block, projector)


def draw_arrays(
    training_samples: TrainingSamples,
    system: NetworkSystem,
    seed: int,
    indices: Collection[int],
    reference: str = PROJECTED,
    what: str = "training samples",
) -> tuple[np.ndarray, np.ndarray]:
    """Make the inputs of a network, and its true outputs: float32, shape (n, h, w, channels).

    `reference` is a key of `lf_flame.systems.formulas.REFERENCES`; `what` names the progress bar.
    """
    arrays: list[np.ndarray] = []
    looks = system.view_indices if reference == PROJECTED else None
    shown = progress.steps(indices, what, len(indices), "light field", stays=True)
    for k, index in enumerate(shown):
        sample = training_samples.draw(seed, index, looks)
        slopes = system.slopes_to_learn(sample.slopes, sample.block)
        images = (
            system.show(sample.views, slopes, sample.block),
            system.truth(sample.truth(slopes, reference)),
        )
        if not arrays:  # allocated once for all: these are gigabytes
            arrays = [np.empty((len(indices), *x.shape), np.float32) for x in images]
        for array, some in zip(arrays, images, strict=True):
            array[k] = some
    seen, truth = (array.reshape(-1, *array.shape[2:]) for array in arrays)
    return seen, truth
