"""Starting the decoder from the training images instead of from noise.

The decoder's last big layer is linear in 256 averages, so its best weights for the averages that
the untrained convolutions give have a closed form: the ridge regression of the training targets,
before the sigmoid, on those averages. Training then begins there. Not in the paper (deviation
13); off in PRESET=paper.
"""

import keras
import numpy as np

FLOOR = 5e-3
"""Targets are clipped to [FLOOR, 1 - FLOOR] before the logarithms of the logit."""

RIDGE = 1e-2
"""Strength of the ridge relative to the mean square of the averages about their mean."""

STATISTICS_SAMPLES = 512
"""Samples that set the batch normalisations; more change nothing and need much memory."""


def warm_start(decoder: keras.Model, features: np.ndarray, targets: np.ndarray) -> None:
    """Set the normalisations, the dense layer and the last convolution from training samples.

    Parameters
    ----------
    decoder : keras.Model
        From `lf_flame.models.build_decoder`; its first two convolutions stay as they are.
    features : ndarray, shape (n, h', w', channels)
    targets : ndarray, shape (n, planes, h, w, 1)
    """
    _set_normalisations(decoder, features[:STATISTICS_SAMPLES])
    dense, last = decoder.get_layer("basis"), decoder.get_layer("planes")
    averages = keras.Model(decoder.input, dense.input).predict(features, verbose=0)
    images = np.moveaxis(targets[..., 0], 1, -1).reshape(len(targets), -1)
    clipped = np.clip(images, FLOOR, 1 - FLOOR)
    kernel, bias = _ridge_regression(averages, np.log(clipped / (1 - clipped)))
    dense.kernel.assign(kernel)
    dense.bias.assign(bias)
    identity = np.zeros(last.kernel.shape, np.float32)
    identity[1, 1] = np.eye(last.kernel.shape[-1])
    last.kernel.assign(identity)
    last.bias.assign(np.zeros(last.bias.shape))


def _set_normalisations(decoder: keras.Model, features: np.ndarray) -> None:
    """Store the statistics of these samples in every batch normalisation."""
    norms = [x for x in decoder.layers if isinstance(x, keras.layers.BatchNormalization)]
    momenta = [norm.momentum for norm in norms]
    for norm in norms:
        norm.momentum = 0.0  # forget the initial statistics
    keras.Model(decoder.input, decoder.get_layer("basis").input)(features, training=True)
    for norm, momentum in zip(norms, momenta, strict=True):
        norm.momentum = momentum


def _ridge_regression(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Kernel (inputs, outputs) and bias of the ridge regression of y (n, outputs) on x."""
    x_mean, y_mean = x.mean(axis=0, dtype=np.float64), y.mean(axis=0, dtype=np.float64)
    centred = x - x_mean
    gram = centred.T @ centred
    gram += RIDGE * np.trace(gram) / min(x.shape) * np.eye(len(gram))
    kernel = np.linalg.solve(gram, centred.T @ (y - y_mean))
    return kernel.astype(np.float32), (y_mean - x_mean @ kernel).astype(np.float32)
