"""Training the decoder on cached backbone features; resumable, with a record of its origin.

The run folder is that of `lf_flame.learning.training_run`. Epoch 0 of the history is the start; its
seconds include everything before training: reading, the backbone's features, the warm start.
"""

import logging
import math
import time
from dataclasses import asdict
from pathlib import Path

import keras
import numpy as np

from lf_flame._common.output_folders import recorded_path
from lf_flame.datasets.split import split_indices
from lf_flame.datasets.store import Dataset
from lf_flame.errors import InputError
from lf_flame.learning.backbone import NO_BACKBONE, build_backbone, describe_weights
from lf_flame.learning.decoder import build_refocus_resnet50
from lf_flame.learning.feature_stream import FeatureStream, compute_features
from lf_flame.learning.imagenet_weights import ImagenetUnavailable, imagenet_file
from lf_flame.learning.run_folders import describe_dataset
from lf_flame.learning.trainers import all_variables, make_trainer
from lf_flame.learning.training_config import ModelConfig, Recipe, TrainingConfig
from lf_flame.learning.training_run import Job, assign, carry_out
from lf_flame.learning.warm_start import Blocks, freeze_normalisations, solve_decoder

LOGGER = logging.getLogger(__name__)


def build_model(
    config: TrainingConfig, recipe: Recipe, dataset: Dataset
) -> tuple[keras.Model, str]:
    """Build the network for a data set, with a random backbone if ImageNet's is not available.

    Returns
    -------
    keras.Model
        Network.
    str
        Backbone weights that were used, for tables and records.
    """
    planes, *image = dataset.targets.shape[1:]
    options = {**asdict(config.model), "seed": config.seed, "shown": dataset.inputs.shape[1:]}
    options |= {"dropout_place": recipe.dropout_place, "neck": recipe.neck}
    options["backbone_weights"] = available_weights(config.model, recipe)
    model = build_refocus_resnet50(tuple(image), planes, **options)
    weights = describe_weights(
        options["backbone_weights"], options["backbone_depth"], options["seed"]
    )
    return model, weights


def available_weights(model: ModelConfig, recipe: Recipe) -> str:
    """Find the backbone's weights: the configured ones, or "random" if the recipe allows it.

    Raises
    ------
    ImagenetUnavailable
        If ImageNet's are not available, and the recipe does not continue without them.
    """
    if model.backbone_weights != "imagenet" or model.backbone_depth == NO_BACKBONE:
        return model.backbone_weights
    try:
        imagenet_file()
    except ImagenetUnavailable as error:
        choice = (
            "--backbone-weights FILE takes them from a file, --backbone-weights random does "
            "without (as a variable of make: BACKBONE_WEIGHTS)"
        )
        if recipe.without_imagenet == "stop":
            raise ImagenetUnavailable(f"{error} {choice}.") from None
        LOGGER.warning(f"NOTE: {error} Going on with RANDOM backbone weights; {choice}.")
        return "random"
    return "imagenet"


def find_backbone(config: TrainingConfig, preset: str) -> str:
    """Find the backbone's weights and load them, before other work depends on them.

    Returns
    -------
    str
        Name of the weights that a training with this preset would use, as in its record.

    Raises
    ------
    InputError
        If they are not available, or a file does not contain them.
    """
    model = config.with_recipe(preset).model
    weights = available_weights(model, config.recipe(preset))
    if weights not in ("imagenet", "random"):
        build_backbone(weights=weights, depth=model.backbone_depth)
    return describe_weights(weights, model.backbone_depth, config.seed)


def train(
    config: TrainingConfig,
    preset: str,
    data: str | Path,
    out: str | Path,
    *,
    minutes: float = 0.0,
) -> Path:
    """Train a network from light-field images to focal stacks, or continue an interrupted run.

    Parameters
    ----------
    config : TrainingConfig
        Configuration, from `read_training_config`.
    preset : str
        Name of the preset in the configuration.
    data : str or Path
        Data set made by `lf_flame.datasets.make_dataset`.
    out : str or Path
        Run folder, for checkpoints, records and the network; made if it is missing.
    minutes : float, optional
        Time in minutes at which the call ends, at the nearest end of an epoch, with the network of
        the lowest validation loss so far; the next call continues. 0 trains to the end.

    Returns
    -------
    Path
        Network ``model.keras`` in the run folder.

    Raises
    ------
    InputError
        If the run folder contains a run with another configuration, or the loss becomes NaN or
        infinite.
    """
    started = time.perf_counter()
    if not 0 <= minutes < math.inf:
        raise InputError(f"minutes must be 0 (to the end) or more, got {minutes}.")
    training = _Training(config.with_recipe(preset), preset, Dataset(data))
    recipe = training.recipe
    job = Job(
        training.request(),
        recipe.epochs,
        config.seed,
        recipe.checkpoint_s,
        training.start,
        training.finish,
        {**training.metadata(), "data": recorded_path(data, out)},
        minutes,
    )
    return carry_out(job, Path(out), started)


class _Training:
    """Network, recipe and data of a training.

    Attributes
    ----------
    recipe : Recipe
    parts : dict of ndarray of int
        Indices of the samples of each part: train, validation, test.

    Raises
    ------
    InputError
        If the recipe does not fit the data set, or the backbone's weights are not available.
    """

    def __init__(self, config: TrainingConfig, preset: str, dataset: Dataset):
        self.recipe = recipe = config.recipe(preset)
        self._config, self._preset, self._dataset = config, preset, dataset
        self.parts = split_indices(len(dataset), config.split, config.seed)
        if recipe.warm_start and recipe.bands > 1 and dataset.config.input.kind == "grid":
            raise InputError(
                f"The warm start draws each of {recipe.bands} bands from the same band of what the "
                f"network is shown, and views side by side have none: bands must be 1 with a grid."
            )
        self._model, self._weights = build_model(config, recipe, dataset)
        self._decoder = self._model.get_layer("decoder")

    def request(self) -> dict:
        """Everything that determines the result, as `Job.request`."""
        config = self._config
        return {
            "title": config.title,
            "preset": self._preset,
            "seed": config.seed,
            "split": list(config.split),
            "model": _without_folder(asdict(config.model)),
            "recipe": asdict(self.recipe),
            "backbone_weights": self._weights,
            "samples": len(self._dataset),
            "dataset": describe_dataset(self._dataset),
        }

    def metadata(self) -> dict:
        """Further content of the record, as `Job.metadata`."""
        sizes = {name: len(indices) for name, indices in self.parts.items()}
        sizes["train"] += self.recipe.fresh_scenes
        return {
            "backbone_depth": self._config.model.backbone_depth,
            "parts": sizes,
            "test_indices": self.parts["test"].tolist(),
        }

    def start(self, new: bool):
        """Make the trainer; a new run may start from the training images."""
        recipe, dataset, decoder = self.recipe, self._dataset, self._decoder
        stream = FeatureStream(
            self._model,
            dataset,
            self.parts["train"],
            recipe.fresh_scenes,
            recipe.needs_all_features,
        )
        shown, targets = (x[self.parts["validation"]] for x in (dataset.inputs, dataset.targets))
        held_out = compute_features(self._model, shown), targets[..., None]
        if recipe.warm_start:
            freeze_normalisations(decoder)
            if new:
                pairs = [stream.kept()] if recipe.needs_all_features else stream
                blocks = Blocks(len(stream), pairs)
                solve_decoder(decoder, blocks, held_out, recipe.bands, recipe.refinements)
        arrays = {"train": stream.kept(), "validation": held_out}
        steps = -(-len(arrays["train"][0]) // recipe.batch_size)
        rate = _learning_rate(recipe, steps)
        return make_trainer(decoder, rate, recipe.batch_size, arrays, recipe.trainer)

    def finish(self, best: list[np.ndarray]) -> keras.Model:
        """Give the network with the best weights."""
        assign(all_variables(self._decoder), best)
        return self._model


def _without_folder(model: dict) -> dict:
    """Model options with the weights file's name only: its hash in the record identifies it."""
    return {**model, "backbone_weights": Path(model["backbone_weights"]).name}


def _learning_rate(recipe: Recipe, steps_per_epoch: int):
    if recipe.schedule == "constant":
        return recipe.learning_rate
    return keras.optimizers.schedules.CosineDecay(
        recipe.learning_rate, recipe.epochs * steps_per_epoch
    )
