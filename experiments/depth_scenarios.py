"""Depth scenarios: the objects of a data set at other depths than those of training.

Objects are scaled so that the central view stays the same: only parallax and defocus distinguish
the scenes.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from lf_flame._common.config import to_json
from lf_flame.datasets.config import DatasetConfig
from lf_flame.datasets.sampling import render_drawn
from lf_flame.errors import InputError
from lf_flame.lightfield import LightField
from lf_flame.scenes.scene import Scene
from lf_flame.simulation.planning.decisions import plan_effects

FIRST_SAMPLE = 1_000_000
"""Index of the first scene; data sets draw theirs from lower ones."""


@dataclass(frozen=True)
class DepthScenario:
    """Depths of the objects of a data set, and the indices of those that are present."""

    name: str
    depths_mm: tuple[float, ...]
    present: tuple[int, ...]

    def place(self, scene: Scene, config: DatasetConfig) -> Scene:
        """Move the objects of a scene to these depths."""
        placed = scene.at_depths(self.depths_mm, config.camera)
        return Scene([placed.layers[k] for k in self.present])


def make_scenarios(config: DatasetConfig) -> list[DepthScenario]:
    """List the scenarios of a data set, its own first; an InputError refuses a single depth."""
    own, names = config.depths_mm, [item.name for item in config.template.objects]
    if len(set(own)) < 2:
        raise InputError(
            f"Only objects at two depths at least can change places; those of {config.kind} stand "
            f"at {', '.join(f'{z:g}' for z in own)} mm."
        )
    everyone = tuple(range(len(own)))
    half = float(np.diff(np.unique(own)).min()) / 2
    scenarios = [
        DepthScenario("as trained", tuple(own), everyone),
        DepthScenario("first and last exchanged", (own[-1], *own[1:-1], own[0]), everyone),
        DepthScenario("order reversed", tuple(own[::-1]), everyone),
        DepthScenario(f"all {half:g} mm nearer", tuple(z - half for z in own), everyone),
        DepthScenario(f"{names[0]} alone", tuple(own), (0,)),
    ]
    # For two or three objects, exchanging the ends is reversing the order.
    different = {(one.depths_mm, one.present): one for one in scenarios[::-1]}
    return list(different.values())[::-1]


def draw_scenario(
    config: DatasetConfig, scenario: DepthScenario, samples: int
) -> Iterator[LightField]:
    """Draw light fields of a scenario, from the same scenes for every scenario."""
    mean, _ = config.template.draw(None)
    plan = plan_effects(scenario.place(mean, config), config.camera, effects=config.effects)
    for index in range(FIRST_SAMPLE, FIRST_SAMPLE + samples):
        scene, _ = config.template.draw(np.random.default_rng([config.seed, index]))
        yield render_drawn(scenario.place(scene, config), config, plan, index)


def scene_settings(config: DatasetConfig) -> dict:
    """Return the settings of a data set that its scenes depend on, without depths and inputs."""
    free = ("input", "shuffled_depths", "samples")
    return {key: value for key, value in to_json(config).items() if key not in free}
