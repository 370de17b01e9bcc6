"""Scenes and histories of training that several experiments share.

Light fields that no network was trained on, scenes whose objects change their depths, and the
history of a run.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from lf_flame._common.config import to_json
from lf_flame._common.input_files import readable
from lf_flame.datasets.config import DatasetConfig
from lf_flame.datasets.sampling import render_drawn
from lf_flame.errors import InputError
from lf_flame.learning.run_folders import open_run
from lf_flame.lightfield import LightField
from lf_flame.scenes.scene import Scene
from lf_flame.simulation.planning.plan import plan_effects

DATA_SETS = tuple(
    Path(__file__).parents[1] / "data_gen" / f"{kind}.toml" for kind in ("shapes", "flames")
)
"""Configurations of the paper's two data sets."""

SAMPLES = 3
"""Number of held-out light fields of each data set."""

FIRST_SAMPLE = 1_000_000
"""Index of the first scene at other depths; data sets draw theirs from lower ones."""


@dataclass(frozen=True)
class HeldOut:
    """Light fields of a data set that no network was trained on, and slopes to refocus them at.

    The run is the network's folder, None without a network; the origin describes the network, or
    says why there is none.
    """

    config: DatasetConfig
    slopes: tuple[float, ...]
    indices: tuple[int, ...]
    run: Path | None
    origin: str


def find_scenes(config: DatasetConfig, run: Path, samples: int = SAMPLES) -> HeldOut:
    """Take the test split of a finished run or, without a run, the last samples of a data set."""
    try:
        found = open_run(run)
    except InputError as error:
        count = min(config.samples.values())
        slopes = tuple(config.camera.depth_to_slope(z) for z in config.depths_mm)
        indices = tuple(range(max(count - samples, 0), count))
        return HeldOut(config, slopes, indices, None, f"missing. {error}")
    record, recipe = found.record, found.record["recipe"]
    planned = recipe.get("epochs", record["epochs"])
    origin = (
        f"preset {record['preset']}, {record['epochs']:,} of {planned:,} epochs, best epoch "
        f"{record['best_epoch']:,}, batch {recipe['batch_size']}, backbone "
        f"{record['backbone_weights']}"
    )
    indices = tuple(record["test_indices"][:samples])
    return HeldOut(found.config, tuple(found.slopes), indices, run, origin)


@dataclass(frozen=True)
class DepthScenario:
    """Depths of the objects of a data set, and the indices of those that are present.

    Objects are scaled so that the central view stays the same: only parallax and defocus
    distinguish the scenes.
    """

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
            f"Objects exchange their depths only if they have two or more; those of {config.kind} "
            f"are at {', '.join(f'{z:g}' for z in own)} mm."
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
        placed = scenario.place(scene, config)
        if any(layer.opaque for layer in placed.layers):  # which may occlude others
            plan = plan_effects(placed, config.camera, effects=config.effects)
        yield render_drawn(placed, config, plan, index)


def scene_settings(config: DatasetConfig) -> dict:
    """Return the settings of a data set that its scenes depend on, without depths and inputs."""
    free = ("input", "shuffled_depths", "samples", "route")
    return {key: value for key, value in to_json(config).items() if key not in free}


def read_history(path: Path, epochs: int) -> pd.DataFrame:
    """Read a run's ``history.csv`` (older ones begin with epoch 0); the seconds are summed up."""
    with readable(path):
        kinds = {"epoch": int, "seconds": float, "val_psnr_db": float}
        rows = pd.read_csv(path, dtype=kinds)
        rows = rows[rows["epoch"] <= epochs]  # a run that goes on has more
        if list(rows["epoch"])[-epochs:] != list(range(1, epochs + 1)):
            raise ValueError(f"it must end with the epochs 1 to {epochs}")
    return rows.assign(seconds=rows["seconds"].cumsum())
