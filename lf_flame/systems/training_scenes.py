"""Training samples: light fields to learn refocusing from, each at several slopes.

Most of them are the paper's scenes with every object at a random depth, so that nothing can be
memorised; the rest are dead leaves, which resemble photographs. The true image is that from all
views, by shift-and-sum or by the Fourier slice. Where the effect plan allows, it comes directly
from the scene (`lf_flame.projection`), like the views that a system uses; no light field is formed.
"""

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from lf_flame._common import progress
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
"""Largest distance in mm of an object beyond the depths of its template."""

PROJECTED = "shift-and-sum"
"""Name of the one of the `REFERENCES` that needs no light field."""

SEED_OF_SCENES = 7
"""Number in the seeds of these scenes, which separates them from data sets' (seed, index)."""

Looks = Callable[[int, int], ViewIndices]
"""Function from the number of rows and columns of views to the indices of the views used."""


@dataclass(frozen=True, eq=False)
class TrainingSample:
    """A light field, or its scene, with slopes at which to refocus it.

    Attributes
    ----------
    views : ndarray of float32, shape (v, u, t, s)
        All views, or without a light field only those used; the others are 0.
    slopes : ndarray of float64, shape (n,)
        Slopes in lenslets per view step.
    block : (int, int)
        Number of lenslets in a pixel of the images, along (t, s).
    seen : ndarray of float32, shape (v, u, t, s)
        Views with noise; equal to `views` if there is none.
    projector : Projector, optional
        Projector of the scene, if there is no light field.
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
            If the reference needs a light field, and there is none.
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
    """Source of training samples.

    Parameters
    ----------
    data : list of str
        Files of data-set configurations whose scenes are used, chosen at random.
    leaves : float
        Fraction of the light fields that are dead leaves.
    leaf_views : int
        Number of views of these along each axis.
    slopes : int
        Number of slopes for each light field: at half of them an object is in focus, the rest are
        random in between.
    look : DeadLeaves
        Appearance of the dead leaves.
    electrons : (float, float)
        Range of the number of electrons in a pixel at full scale in low light; uniform in its
        logarithm.
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
        """Configurations of the data sets; their images must have one size."""
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
        """Draw a sample that depends on these numbers alone; a fraction is in low light.

        Parameters
        ----------
        seed, index : int
            Seed, and index of the sample.
        low_light : float, optional
            Fraction of the samples in low light.
        looks : callable, optional
            Function that selects the views to use: only these are computed, where the effect plan
            and the light allow, and no light field is formed. Default: all views.
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
    what: str = "training samples",
) -> tuple[np.ndarray, np.ndarray]:
    """Make the inputs of a network, and its true outputs.

    Parameters
    ----------
    training_samples : TrainingSamples
        Source of the samples.
    system : lf_flame.systems.base.NetworkSystem
        System of the network.
    seed : int
        Seed of the samples.
    indices : collection of int
        Indices of the samples.
    reference : str, optional
        Reference of the truth: a key of `lf_flame.systems.formulas.REFERENCES`.
    low_light : float, optional
        Fraction of the light fields in low light, with shot noise.
    what : str, optional
        Name of the work, for the progress bar.

    Returns
    -------
    ndarray of float32, shape (n, h, w, channels)
        Inputs.
    ndarray of float32, shape (n, h, w, channels)
        True outputs.
    """
    arrays: list[np.ndarray] = []
    looks = system.view_indices if reference == PROJECTED else None
    shown = progress.steps(indices, what, len(indices), "light field", stays=True)
    for k, index in enumerate(shown):
        sample = training_samples.draw(seed, index, low_light, looks)
        slopes = system.slopes_to_learn(sample.slopes, sample.block)
        images = (
            system.show(sample.seen, slopes, sample.block),
            system.truth(sample.truth(slopes, reference)),
        )
        if not arrays:  # allocated once for all: these are gigabytes
            arrays = [np.empty((len(indices), *x.shape), np.float32) for x in images]
        for array, some in zip(arrays, images, strict=True):
            array[k] = some
    seen, truth = (array.reshape(-1, *array.shape[2:]) for array in arrays)
    return seen, truth
