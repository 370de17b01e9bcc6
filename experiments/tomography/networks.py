"""The planes of the paper's network, taken for sections of a flame."""

from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from experiments.systems.compared import by_recipe
from experiments.tomography.phantoms import BLOCK, Recorder, paper_flames, truth_on
from experiments.tomography.tasks import (
    DEPTHS_MM,
    OURS,
    Row,
    by_focal_stack,
    by_reconstruction,
    worst_planes,
)
from lf_flame import LightField
from lf_flame.learning.keras_loading import load_keras
from lf_flame.tomography import FrustumGrid


def networks_as_sections(runs: Sequence[Path], rng: np.random.Generator) -> Iterator[Row]:
    """Take the planes of the paper's network for emission, on a scene it has not learnt from."""
    load_keras()
    from lf_flame.learning.run_folders import open_run
    from lf_flame.systems.resnet50 import ResNet50

    for run in runs:
        sample = open_run(run).record["test_indices"][0]
        scene, camera = paper_flames(sample)
        grid = FrustumGrid(camera, DEPTHS_MM, BLOCK)
        truth = truth_on(grid, scene)
        light_field = Recorder(scene, camera).with_noise(0.01, rng)
        system = ResNet50.of_run(run)
        methods = {
            by_recipe(run): partial(_by_network, system),
            OURS: by_reconstruction,
            "focal stack as emission": by_focal_stack,
        }
        task = f"the paper's four flames, test sample {sample}"
        yield from worst_planes(task, "1 %", light_field, grid, truth, methods)


def _by_network(system, light_field: LightField, grid: FrustumGrid) -> np.ndarray:
    return system.refocus(light_field.views, system.slopes, (BLOCK, BLOCK))
