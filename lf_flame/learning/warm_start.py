"""Starting the decoder from the training images instead of from noise.

The decoder's last big layer is linear in 256 numbers, so the best images it can draw for what
arrives there have a closed form: ridge regression of the training images before the sigmoid. With
the neck "positions" the regression finds the 256 numbers too. With the paper's pooled neck the two
convolutions start by passing on what a regression on the backbone's averages found. The last
convolution starts as the identity. Training then begins there. Not in the paper (deviation 13), and
off in the recipes that follow it.
"""

import keras
import numpy as np
from tqdm import tqdm

from lf_flame.errors import InputError
from lf_flame.learning.ridge import Regression, ridge_regression
from lf_flame.learning.sigmoid_regression import refine

STATISTICS_SAMPLES = 512
"""Samples that set the batch normalisations; more change nothing and need much memory."""


def warm_start(
    decoder: keras.Model, training: tuple, held_out: tuple, bands: int = 1, refinements: int = 0
) -> None:
    """Set all weights of the decoder from training samples.

    Parameters
    ----------
    decoder : keras.Model
        From `lf_flame.learning.decoder.build_decoder`; what the samples do not determine stays
        random.
    training, held_out : (ndarray, ndarray)
        Features (n, h', w', channels) and targets (n, planes, h, w, 1). Those held out only
        choose the strength of the ridge.
    bands : int, optional
        For the neck "positions": vertical bands of the image, each drawn from the features in the
        same band alone. Refocusing is local, and what the regression need not find out from the
        samples it gets right.
    refinements : int, optional
        For the neck "positions": steps that lower the images' own error behind the sigmoid, see
        `lf_flame.learning.sigmoid_regression`. Two do nearly all there is.
    """
    if "neck" in [layer.name for layer in decoder.layers]:
        _regress_by_bands(decoder, training, held_out, bands, refinements)
    else:
        _regress_on_averages(decoder, training, held_out)
    last = decoder.get_layer("planes")
    _set_pointwise(last, np.eye(last.filters))


def _regress_by_bands(decoder, training, held_out, bands: int, refinements: int) -> None:
    """Set neck and basis: a part of the 256 numbers for each band."""
    neck, basis = decoder.get_layer("neck"), decoder.get_layer("basis")
    _, height, width, planes = decoder.get_layer("planes").output.shape
    shape = decoder.input.shape[1:]
    if bands > min(shape[1], neck.units):
        raise InputError(f"bands must be at most {min(shape[1], neck.units)}, got {bands}.")
    inward = np.zeros((*shape, neck.units), np.float32)
    images = np.zeros((neck.units, height, width, planes), np.float32)
    centre, offset = np.zeros(neck.units), np.zeros((height, width, planes))
    for band in tqdm(range(bands), "start from the training images", unit="band"):
        units, drawn = (_part(band, bands, whole) for whole in (neck.units, width))
        seen = _overlapped(band, bands, shape[1])
        parts = [
            (_flat(x[:, :, seen]), _flat(_as_drawn(y)[:, :, drawn]))
            for x, y in (training, held_out)
        ]
        found = ridge_regression(*parts)
        weights, drawings = found.components(units.stop - units.start)
        centre[units] = -(found.mean @ weights)
        numbers = parts[0][0] @ weights + centre[units].astype(np.float32)
        drawings, dark = refine(numbers, parts[0][1], drawings, found.offset, refinements)
        inward[:, seen, :, units] = weights.reshape(inward[:, seen, :, units].shape)
        images[units, :, drawn] = drawings.reshape(images[units, :, drawn].shape)
        offset[:, drawn] = dark.reshape(offset[:, drawn].shape)
    neck.set_weights([inward.reshape(-1, neck.units), centre])
    basis.set_weights([images.reshape(neck.units, -1), offset.reshape(-1)])


def _part(band: int, bands: int, whole: int) -> slice:
    return slice(band * whole // bands, (band + 1) * whole // bands)


def _overlapped(band: int, bands: int, columns: int) -> slice:
    """Columns of a map that a band overlaps."""
    return slice(band * columns // bands, -(-(band + 1) * columns // bands))


def _as_drawn(targets: np.ndarray) -> np.ndarray:
    """Targets (n, planes, h, w, 1) in the order in which the dense layer draws them."""
    return np.moveaxis(targets[..., 0], 1, -1)


def _flat(x: np.ndarray) -> np.ndarray:
    return x.reshape(len(x), -1)


def _regress_on_averages(decoder, training, held_out) -> None:
    """Let the convolutions pass on components of the averages, and set the basis for them."""
    basis = decoder.get_layer("basis")
    found = ridge_regression(
        *((x.mean(axis=(1, 2)), _flat(_as_drawn(y))) for x, y in (training, held_out))
    )
    _pass_on(decoder, found, training[0][:STATISTICS_SAMPLES])
    head = keras.Model(decoder.input, basis.input)
    found = ridge_regression(
        *((head.predict(x, verbose=0), _flat(_as_drawn(y))) for x, y in (training, held_out))
    )
    weights = found.weights()
    basis.set_weights([weights, found.offset - found.mean @ weights])


def _pass_on(decoder: keras.Model, found: Regression, features: np.ndarray) -> None:
    """Let the convolutions pass on what a regression on the averages found.

    The first takes each component with both signs, the second their difference: a leaky ReLU of
    slope a keeps (1 + a) x of that, so what reaches the second is linear in the features.
    """
    first, second = (
        x for x in decoder.layers if isinstance(x, keras.layers.Conv2D) and x.name != "planes"
    )
    count = min(second.filters, first.filters // 2)
    components, _ = found.components(count)
    components /= np.maximum((features[:32] @ components).std(axis=(0, 1, 2)), 1e-12)
    _set_pointwise(first, np.hstack([components, -components]))
    _set_pointwise(second, np.vstack([np.eye(count), -np.eye(count)]))
    _set_normalisations(decoder, features)


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
