"""Starting the decoder from the training images instead of from noise.

The decoder's last big layer is linear in 256 averages. The two convolutions start by passing on
the principal components of the backbone's averages; the best weights of the big layer for what
arrives there have a closed form, the ridge regression of the training targets before the sigmoid;
and the last convolution starts as the identity. Training then begins there. Not in the paper
(deviation 13); off in PRESET=paper.
"""

import keras
import numpy as np

FLOOR = 1e-3
"""Targets are clipped to [FLOOR, 1 - FLOOR] before the logarithms of the logit."""

RIDGE = 1e-2
"""Strength of the ridge relative to the mean square of the averages about their mean."""

STATISTICS_SAMPLES = 512
"""Samples that set the batch normalisations; more change nothing and need much memory."""


def warm_start(decoder: keras.Model, features: np.ndarray, targets: np.ndarray) -> None:
    """Set all weights of the decoder from training samples.

    Parameters
    ----------
    decoder : keras.Model
        From `lf_flame.models.build_decoder`; what the samples do not determine stays random.
    features : ndarray, shape (n, h', w', channels)
    targets : ndarray, shape (n, planes, h, w, 1)
    """
    _pass_on_components(decoder, features)
    _set_normalisations(decoder, features[:STATISTICS_SAMPLES])
    dense, last = decoder.get_layer("basis"), decoder.get_layer("planes")
    averages = keras.Model(decoder.input, dense.input).predict(features, verbose=0)
    images = np.moveaxis(targets[..., 0], 1, -1).reshape(len(targets), -1)
    clipped = np.clip(images, FLOOR, 1 - FLOOR)
    kernel, bias = _ridge_regression(averages, np.log(clipped / (1 - clipped)))
    dense.kernel.assign(kernel)
    dense.bias.assign(bias)
    _set_pointwise(last, np.eye(last.filters))


def _pass_on_components(decoder: keras.Model, features: np.ndarray) -> None:
    """Let the convolutions pass on the principal components of the samples' averages.

    The first takes each component with both signs, the second their difference: a leaky ReLU of
    slope a keeps (1 + a) x of that, so what reaches the second is linear in the features.
    """
    first, second = (
        x for x in decoder.layers if isinstance(x, keras.layers.Conv2D) and x.name != "planes"
    )
    averages = features.mean(axis=(1, 2), dtype=np.float64)
    count = min(second.filters, first.filters // 2, len(averages) - 1)
    _, _, components = np.linalg.svd(averages - averages.mean(axis=0), full_matrices=False)
    components = components[:count].T
    components /= np.maximum((features[:32] @ components).std(axis=(0, 1, 2)), 1e-12)
    _set_pointwise(first, np.hstack([components, -components]))
    _set_pointwise(second, np.vstack([np.eye(count), -np.eye(count)]))


def _set_pointwise(convolution: keras.layers.Conv2D, matrix: np.ndarray) -> None:
    """Make the first filters act on each position alone, by `matrix` (channels, filters)."""
    kernel = keras.ops.convert_to_numpy(convolution.kernel).copy()
    channels, filters = matrix.shape
    kernel[..., :filters] = 0
    kernel[1, 1, :channels, :filters] = matrix
    convolution.kernel.assign(kernel)


def freeze_normalisations(decoder: keras.Model) -> None:
    """Let the batch normalisations keep their stored statistics, as `warm_start` sets them.

    What tells one sample from another is a small part of the features' spread; statistics that
    change with every batch would drown it. Call it before the optimiser is built.
    """
    for norm in _normalisations(decoder):
        norm.trainable = False


def _normalisations(decoder: keras.Model) -> list:
    return [x for x in decoder.layers if isinstance(x, keras.layers.BatchNormalization)]


def _set_normalisations(decoder: keras.Model, features: np.ndarray) -> None:
    """Store the statistics of these samples in every batch normalisation."""
    norms = _normalisations(decoder)
    before = [(norm.momentum, norm.trainable) for norm in norms]
    for norm in norms:
        norm.momentum, norm.trainable = 0.0, True  # forget the initial statistics
    keras.Model(decoder.input, decoder.get_layer("basis").input)(features, training=True)
    for norm, (momentum, trainable) in zip(norms, before, strict=True):
        norm.momentum, norm.trainable = momentum, trainable


def _ridge_regression(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Kernel (inputs, outputs) and bias of the ridge regression of y (n, outputs) on x."""
    x_mean, y_mean = x.mean(axis=0, dtype=np.float64), y.mean(axis=0, dtype=np.float64)
    centred = x - x_mean
    gram = centred.T @ centred
    gram += RIDGE * np.trace(gram) / min(x.shape) * np.eye(len(gram))
    kernel = np.linalg.solve(gram, centred.T @ (y - y_mean))
    return kernel.astype(np.float32), (y_mean - x_mean @ kernel).astype(np.float32)
