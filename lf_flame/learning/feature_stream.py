"""Backbone features of the training samples: those of a data set, then fresh scenes, in blocks.

Training by epochs needs all of them repeatedly. The closed form alone reads each block once,
so that its memory hardly grows with the number of scenes.
"""

from collections.abc import Iterable, Iterator

import keras
import numpy as np

from lf_flame._common import progress
from lf_flame._common.memory import check_memory
from lf_flame.datasets.store import Dataset

TOGETHER = 128
"""Number of samples in a block."""

BATCH = 16
"""Number of samples that the backbone processes together."""

REMEMBERED = 2048
"""Number of samples with features that are kept without epochs; the training loss is over these."""

Pair = tuple[np.ndarray, np.ndarray]


def compute_features(model: keras.Model, inputs: np.ndarray) -> np.ndarray:
    """Run the frozen backbone once over inputs.

    Parameters
    ----------
    model : keras.Model
        Model from `lf_flame.learning.decoder.build_refocus_resnet50`.
    inputs : ndarray, shape (n, h, w, channels)

    Returns
    -------
    ndarray of float32, shape (n, h', w', channels)
    """
    backbone = model.get_layer("backbone")
    features = np.empty((len(inputs), *backbone.output.shape[1:]), np.float32)
    for k in range(0, len(inputs), BATCH):
        features[k : k + BATCH] = backbone.predict_on_batch(inputs[k : k + BATCH])
    return features


class FeatureStream:
    """Features and targets of the training samples, block by block, with a progress bar.

    Iteration gives pairs of features (n, h', w', channels) and targets (n, planes, h, w, 1), both
    float32; the length is the total number of samples.

    Parameters
    ----------
    model : keras.Model
        Model from `lf_flame.learning.decoder.build_refocus_resnet50`.
    dataset : Dataset
    indices : ndarray of int
        Indices of its training samples.
    fresh : int
        Number of fresh scenes after them, see `lf_flame.datasets.fresh_scenes`.
    keep_all : bool
        Whether to keep all samples, instead of the first `REMEMBERED`.

    Raises
    ------
    InputError
        If the samples to keep would exceed the memory limit.
    """

    def __init__(
        self, model: keras.Model, dataset: Dataset, indices: np.ndarray, fresh: int, keep_all: bool
    ):
        self._model, self._dataset, self._indices = model, dataset, indices
        self._fresh = fresh
        shapes = model.get_layer("backbone").output.shape[1:], (*dataset.targets.shape[1:], 1)
        count = len(self) if keep_all else min(len(self), REMEMBERED)
        needed = 4 * count * sum(int(np.prod(shape)) for shape in shapes)
        check_memory(needed, f"features and images of {count} training samples")
        self._features, self._targets = (np.empty((count, *x), np.float32) for x in shapes)
        self._filled = 0

    def __len__(self) -> int:
        return len(self._indices) + self._fresh

    def __iter__(self) -> Iterator[Pair]:
        self._filled = 0
        with progress.bar("training samples", len(self), "sample", stays=True) as bar:
            for inputs, targets in self._images():
                pair = compute_features(self._model, inputs), targets[..., None]
                self._keep(pair)
                bar.update(len(inputs))
                yield pair

    def _images(self) -> Iterable[Pair]:
        for first in range(0, len(self._indices), TOGETHER):
            some = self._indices[first : first + TOGETHER]
            yield self._dataset.inputs[some], self._dataset.targets[some]

    def _keep(self, pair: Pair) -> None:
        first = self._filled
        for array, values in zip((self._features, self._targets), pair, strict=True):
            some = array[first : first + len(values)]
            some[...] = values[: len(some)]
        self._filled = min(first + len(pair[0]), len(self._features))

    def kept(self) -> Pair:
        """Features and targets that are kept; computed now if there was no iteration yet."""
        if self._filled < len(self._features):
            for _ in self:
                pass
        return self._features, self._targets
