"""The paper's training (section III.E) in Keras: Adam at 1e-4, mean squared error, batches of two.

The frozen backbone never changes, so its features are computed once, and `fit` trains the decoder
on them; a test shows that the losses are those of training the whole network. `fit` runs in
`lf_flame.learning.fitting`, which resumes an interrupted run.
"""

import logging
import time
from dataclasses import asdict, replace
from pathlib import Path

import keras
import numpy as np

from lf_flame._common import progress
from lf_flame._common.atomic_files import recorded_path
from lf_flame._common.input_files import check_memory
from lf_flame.datasets.store import Dataset, split_indices
from lf_flame.learning.backbone import NO_BACKBONE, describe_weights
from lf_flame.learning.decoder import build_refocus_resnet50
from lf_flame.learning.fast_steps import FusedAdam, matrix_view
from lf_flame.learning.fitting import RunFolder, assign_weights, shuffled_batches
from lf_flame.learning.imagenet_weights import ImagenetUnavailable, imagenet_file
from lf_flame.learning.keras_loading import accelerators
from lf_flame.learning.run_folders import describe_dataset
from lf_flame.learning.training_config import TrainingConfig

LOGGER = logging.getLogger(__name__)

FEATURE_BATCH = 16
"""Number of samples that the backbone processes together."""

STEPS_PER_EXECUTION = 32
"""Largest number of steps, a divisor of an epoch's, that are taken without a return to Python."""


def train(
    config: TrainingConfig, preset: str, data: str | Path, out: str | Path, *, minutes: float = 0.0
) -> Path:
    """Train a network from light-field images to focal stacks, or resume an interrupted run.

    Parameters
    ----------
    config : TrainingConfig
        Configuration, from `read_training_config`.
    preset : str
        Name of the preset in the configuration.
    data : str or Path
        Data set made by `lf_flame.datasets.make_dataset`.
    out : str or Path
        Run folder, for checkpoint, record and network; made if it is missing.
    minutes : float, optional
        Time limit of this call in minutes, preparation included: it stops at the end of the epoch
        nearest to it, with the best network so far, and the next call resumes. 0: no limit.

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
    started, recipe, dataset = time.perf_counter(), config.recipe(preset), Dataset(data)
    parts = split_indices(len(dataset), config.split, config.seed)
    source, described = find_weights(config, preset)
    progress.report(f"Weights of the backbone: {described}.")
    planes, *image = dataset.targets.shape[1:]
    network = build_refocus_resnet50(
        tuple(image), planes, **asdict(replace(config.model, backbone_weights=source)),
        seed=config.seed, shown=dataset.inputs.shape[1:],
    )  # fmt: skip
    decoder = network.get_layer("decoder")

    metadata = {
        "title": config.title,
        "preset": preset,
        "backbone_depth": config.model.backbone_depth,
        "parts": {name: len(indices) for name, indices in parts.items()},
        "test_indices": parts["test"].tolist(),
        "data": recorded_path(data, out),
    }

    def samples(part: str) -> tuple[np.ndarray, np.ndarray]:
        features = compute_features(network, dataset.inputs[parts[part]], part)
        return features, dataset.targets[parts[part]][..., None]

    request = _request(config, preset, dataset, described)
    run = RunFolder(Path(out), request, recipe.epochs, recipe.checkpoint_s, started, minutes)
    with run.opened():
        if run.finished:
            return run.network
        if run.epochs_missing:  # features take a while
            batches = shuffled_batches(*samples("train"), recipe.batch_size, config.seed)
            # On the decoder's own variables, so that `network` learns too.
            trained = compile_for_training(decoder, recipe.learning_rate, batches.steps)
            run.fit(trained, batches, samples("validation"))
        assign_weights(decoder, run.state.best)
        run.write(network, metadata)
        return run.network


def _request(config: TrainingConfig, preset: str, dataset: Dataset, weights: str) -> dict:
    """Collect all that determines the result but the epochs; a file of weights by name and hash."""
    recipe, model = asdict(config.recipe(preset)), asdict(config.model)
    for name in ("epochs", "checkpoint_s", "without_imagenet"):
        del recipe[name]
    del model["backbone_weights"]
    return {
        "seed": config.seed,
        "split": list(config.split),
        "model": model,
        "recipe": recipe,
        "backbone_weights": weights,
        "samples": len(dataset),
        "dataset": describe_dataset(dataset),
    }


def compile_for_training(decoder: keras.Model, learning_rate: float, steps: int) -> keras.Model:
    """Compile the decoder with Adam and the mean squared error, for epochs of this many steps.

    On a CPU with TensorFlow the decoder is trained through `matrix_view`, a second model on the
    same variables, with `FusedAdam`: the same losses in less time. Elsewhere XLA compiles Keras's
    own Adam and layers.
    """
    at_once = max(k for k in range(1, STEPS_PER_EXECUTION + 1) if steps % k == 0)
    if keras.backend.backend() == "tensorflow" and not accelerators():
        network, optimizer, jit = matrix_view(decoder), FusedAdam(learning_rate), False
    else:
        network = keras.Model(decoder.input, decoder.output)  # what is saved has no optimiser
        optimizer, jit = keras.optimizers.Adam(learning_rate), True
    network.compile(optimizer, "mse", jit_compile=jit, steps_per_execution=at_once)
    network.optimizer.build(network.trainable_variables)  # a checkpoint contains its variables too
    return network


def compute_features(network: keras.Model, inputs: np.ndarray, part: str = "samples") -> np.ndarray:
    """Run the frozen backbone over inputs [n, h, w, channels], with a progress bar."""
    backbone = network.get_layer("backbone")
    shape = (len(inputs), *backbone.output.shape[1:])
    check_memory(4 * int(np.prod(shape)), f"features of {len(inputs)} samples")
    features = np.empty(shape, np.float32)
    with progress.bar(f"features, {part}", len(inputs), "image") as bar:
        for k in range(0, len(inputs), FEATURE_BATCH):
            some = inputs[k : k + FEATURE_BATCH]
            features[k : k + FEATURE_BATCH] = backbone.predict_on_batch(some)
            bar.update(len(some))
    return features


def find_weights(config: TrainingConfig, preset: str) -> tuple[str, str]:
    """Find the backbone's weights: the configured ones, or random ones if the recipe allows it.

    Returns the value of `backbone_weights` for `build_refocus_resnet50`, and the weights' name
    for tables and records. ImagenetUnavailable is raised if ImageNet's are not available, and the
    recipe does not continue without them.
    """
    model, source = config.model, config.model.backbone_weights
    if source == "imagenet" and model.backbone_depth != NO_BACKBONE:
        try:
            imagenet_file()
        except ImagenetUnavailable as error:
            choice = (
                "--backbone-weights FILE takes them from a file, --backbone-weights random does "
                "without (as a variable of make: BACKBONE_WEIGHTS)"
            )
            if config.recipe(preset).without_imagenet == "stop":
                raise ImagenetUnavailable(f"{error} {choice}.") from None
            LOGGER.warning(f"NOTE: {error} Continuing with RANDOM backbone weights; {choice}.")
            source = "random"
    return source, describe_weights(source, model.backbone_depth, config.seed)
