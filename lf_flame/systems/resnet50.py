"""The paper's ResNet-50 as a system: all views in one image, refocused images at fixed slopes.

A network of this kind is for one camera and for the depths that it was trained on.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from lf_flame.datasets.config import DatasetConfig
from lf_flame.errors import InputError
from lf_flame.learning.run_folders import open_run
from lf_flame.lightfield import LightField
from lf_flame.systems.base import NetworkSystem, ViewIndices

if TYPE_CHECKING:
    import keras

NEAR = 0.02
"""Largest distance of a requested slope from one of the network's, in lenslets per view step."""


class ResNet50(NetworkSystem):
    """A trained run of the paper's network, with any input encoding.

    Parameters
    ----------
    model : keras.Model
        Trained network.
    config : DatasetConfig
        Configuration of the data set that it was trained on.
    slopes : sequence of float
        Slopes of its outputs, in lenslets per view step.
    """

    name = "ResNet-50"

    def __init__(self, model: "keras.Model", config: DatasetConfig, slopes: Sequence[float]):
        super().__init__(model)
        self.config, self.slopes = config, np.asarray(slopes, float)

    @classmethod
    def of_run(cls, folder: str | Path) -> "ResNet50":
        """Load a finished run."""
        run = open_run(folder)
        return cls(run.load_network(), run.config, run.slopes)

    def view_indices(self, rows: int, columns: int) -> ViewIndices:
        """Choose the views that the encoding uses, out of the camera's views."""
        own = self.config.camera.views
        if (rows, columns) != (own, own):
            raise InputError(
                f"{self.name} was trained on a camera of {own} x {own} views, got {rows} x "
                f"{columns}."
            )
        return self.config.input.view_indices(rows, columns)

    def _check(self, shape: tuple[int, ...], slopes: np.ndarray, block: tuple[int, int]) -> None:
        super()._check(shape, slopes, block)
        lenslets, own = self.config.camera.lenslets, self.config.block
        if tuple(shape[2:4]) != tuple(lenslets) or tuple(block) != own or len(shape) != 4:
            raise InputError(
                f"{self.name} was trained on grey light fields of {lenslets[0]} x {lenslets[1]} "
                f"lenslets, {own[0]} x {own[1]} per pixel, got an array of shape {tuple(shape)} "
                f"and {block[0]} x {block[1]}."
            )
        for slope in slopes:
            if np.abs(self.slopes - slope).min() > NEAR:
                known = ", ".join(f"{x:z.2f}" for x in self.slopes)
                raise InputError(f"{self.name} only takes the slopes {known}, got {slope:.3g}.")

    def prepare_input(self, views: np.ndarray, slopes: np.ndarray, block) -> np.ndarray:
        """Encode the light field as in training."""
        return self.config.encode(LightField.trusted(views))[None]

    def _apply(self, views: np.ndarray, slopes: np.ndarray, block: tuple[int, int]) -> np.ndarray:
        views = np.ascontiguousarray(views, np.float32)
        inputs = self.prepare_input(views, slopes, block)
        images = self.model.predict_on_batch(inputs)[0, ..., 0]
        return images[[int(np.abs(self.slopes - slope).argmin()) for slope in slopes]]
