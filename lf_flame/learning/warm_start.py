"""Starting the decoder from the training images instead of from noise.

The decoder's last large layer is linear in 256 numbers. The best images for given numbers therefore
have a closed form: ridge regression of the training images before the sigmoid. With the neck
"positions" the regression also finds the 256 numbers. With the paper's pooled neck the two
convolutions initially pass on the result of a regression on the backbone's averages. The last
convolution starts as the identity. Training begins from there. This is not in the paper (deviation
13), and is off in the recipes that follow it.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import keras
import numpy as np

from lf_flame._common import progress
from lf_flame._common.memory import check_memory
from lf_flame.errors import InputError
from lf_flame.learning import ridge
from lf_flame.learning.ridge import ProductGatherer, Regression, gather_products, ridge_regression
from lf_flame.learning.sigmoid_regression import refine

STATISTICS_SAMPLES = 512
"""Number of samples for the batch normalisations; more change nothing and need much memory."""


@dataclass(frozen=True)
class Blocks:
    """Samples that come block by block.

    Attributes
    ----------
    count : int
        Total number of samples.
    pairs : iterable of (ndarray, ndarray)
        Features (n, h', w', channels) and targets (n, planes, h, w, 1) of the next samples; read
        once.
    """

    count: int
    pairs: Iterable[tuple[np.ndarray, np.ndarray]]


def solve_decoder(
    decoder: keras.Model, training: Blocks, held_out: tuple, bands: int = 1, refinements: int = 0
) -> None:
    """Set all weights of the decoder from training samples.

    Parameters
    ----------
    decoder : keras.Model
        Decoder from `lf_flame.learning.decoder.build_decoder`; weights that the samples do not
        determine stay random.
    training : Blocks
        Training samples. With the neck "positions" a block's features are released before the next
        one, and images of more than `lf_flame.learning.ridge.LANDMARKS` samples are kept in half
        precision.
    held_out : (ndarray, ndarray)
        Features and targets of other samples, which only choose the strength of the regularisation.
    bands : int, optional
        Number of vertical bands of the image for the neck "positions", each computed only from the
        features in the same band: refocusing is local, and the regression need not learn that.
    refinements : int, optional
        Number of steps for the neck "positions" that lower the error of the images themselves, see
        `lf_flame.learning.sigmoid_regression`. Two achieve nearly everything.
    """
    if "neck" in [layer.name for layer in decoder.layers]:
        _regress_by_bands(decoder, training, held_out, bands, refinements)
    else:
        _regress_on_averages(decoder, _joined(training.pairs), held_out)
    last = decoder.get_layer("planes")
    _set_pointwise(last, np.eye(last.filters))


def _joined(pairs: Iterable[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, ...]:
    """Join blocks into one; a single one is not copied."""
    first, *others = pairs
    return tuple(map(np.concatenate, zip(first, *others, strict=True))) if others else first


class _Band:
    """A vertical band of the image: its numbers, and the samples gathered for it."""

    def __init__(self, decoder: keras.Model, band: int, bands: int, count: int):
        neck = decoder.get_layer("neck")
        _, height, width, planes = decoder.get_layer("planes").output.shape
        self.units, self.drawn = (_part(band, bands, whole) for whole in (neck.units, width))
        self.seen = _overlapped(band, bands, decoder.input.shape[2])
        pixels = height * (self.drawn.stop - self.drawn.start) * planes
        # Half precision has an error of 77 dB; a fit to so many samples leaves 55.
        kind = np.float32 if count <= ridge.LANDMARKS else np.float16
        needed = (
            bands * count * (np.dtype(kind).itemsize * pixels + 4 * min(count, ridge.LANDMARKS))
        )
        check_memory(needed, f"what is kept of {count} training samples")
        self.products = ProductGatherer(count)
        self.images = np.empty((count, pixels), kind)
        self._filled = 0

    def cut(self, features: np.ndarray, targets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Cut samples to the band, (n, features) and (n, pixels)."""
        return _flat(features[:, :, self.seen]), _flat(_as_drawn(targets)[:, :, self.drawn])

    def add(self, features: np.ndarray, targets: np.ndarray) -> None:
        """Add the next samples."""
        seen, images = self.cut(features, targets)
        self.products.add(seen)
        self.images[self._filled : self._filled + len(images)] = images
        self._filled += len(images)


def _regress_by_bands(decoder, training: Blocks, held_out, bands: int, refinements: int) -> None:
    """Set neck and basis, with a part of the 256 numbers for each band."""
    neck, basis = decoder.get_layer("neck"), decoder.get_layer("basis")
    _, height, width, planes = decoder.get_layer("planes").output.shape
    shape = decoder.input.shape[1:]
    if bands > min(shape[1], neck.units):
        raise InputError(f"bands must be at most {min(shape[1], neck.units)}, got {bands}.")
    gathered = [_Band(decoder, band, bands, training.count) for band in range(bands)]
    for pair in training.pairs:
        for band in gathered:
            band.add(*pair)
    inward = np.zeros((*shape, neck.units), np.float32)
    pictures = np.zeros((neck.units, height, width, planes), np.float32)
    centre, offset = np.zeros(neck.units), np.zeros((height, width, planes))
    for _ in progress.steps(
        range(bands), "start from the training images", bands, "band", stays=True
    ):
        band = gathered.pop()  # and released
        weights, centre[band.units], drawings, dark = _regress_band(band, held_out, refinements)
        inward[:, band.seen, :, band.units] = weights.reshape(
            inward[:, band.seen, :, band.units].shape
        )
        part = pictures[band.units, :, band.drawn]
        pictures[band.units, :, band.drawn] = drawings.reshape(part.shape)
        offset[:, band.drawn] = dark.reshape(offset[:, band.drawn].shape)
    neck.set_weights([inward.reshape(-1, neck.units), centre])
    basis.set_weights([pictures.reshape(neck.units, -1), offset.reshape(-1)])


def _regress_band(band: _Band, held_out, refinements: int) -> tuple[np.ndarray, ...]:
    """Weights of features, minus their value for the mean, drawings of the numbers, and offset."""
    products = band.products.finish()
    found = ridge_regression(products, band.images, band.cut(*held_out))
    turn, drawings = found.components(band.units.stop - band.units.start)
    weights = found.of_features(turn)
    drawings, dark = refine(
        products.values @ turn, band.images, drawings, found.offset, refinements
    )
    return weights, -(found.mean @ weights), drawings, dark


def _part(band: int, bands: int, whole: int) -> slice:
    return slice(band * whole // bands, (band + 1) * whole // bands)


def _overlapped(band: int, bands: int, columns: int) -> slice:
    """Columns of a map that a band overlaps."""
    return slice(band * columns // bands, -(-(band + 1) * columns // bands))


def _as_drawn(targets: np.ndarray) -> np.ndarray:
    """Targets (n, planes, h, w, 1) in the order of the dense layer's outputs."""
    return np.moveaxis(targets[..., 0], 1, -1)


def _flat(x: np.ndarray) -> np.ndarray:
    return x.reshape(len(x), -1)


def _regress_on_averages(decoder, training, held_out) -> None:
    """Let the convolutions pass on components of the averages, and set the basis for them."""
    basis = decoder.get_layer("basis")
    averages, others = ((x.mean(axis=(1, 2)), _flat(_as_drawn(y))) for x, y in (training, held_out))
    found = ridge_regression(gather_products(averages[0]), averages[1], others)
    _pass_on(decoder, found, training[0][:STATISTICS_SAMPLES])
    head = keras.Model(decoder.input, basis.input)
    vectors = [head.predict(x, verbose=0) for x, _ in (training, held_out)]
    found = ridge_regression(gather_products(vectors[0]), averages[1], (vectors[1], others[1]))
    weights = found.weights()
    basis.set_weights([weights, found.offset - found.mean @ weights])


def _pass_on(decoder: keras.Model, found: Regression, features: np.ndarray) -> None:
    """Let the convolutions pass on the result of a regression on the averages.

    The first convolution gives each component with both signs, the second their difference. A
    leaky ReLU of slope a turns that into (1 + a) x, so the second's result is linear in the
    features.
    """
    first, second = (
        x for x in decoder.layers if isinstance(x, keras.layers.Conv2D) and x.name != "planes"
    )
    count = min(second.filters, first.filters // 2)
    turn, _ = found.components(count)
    components = found.of_features(turn)
    components /= np.maximum((features[:32] @ components).std(axis=(0, 1, 2)), 1e-12)
    _set_pointwise(first, np.hstack([components, -components]))
    _set_pointwise(second, np.vstack([np.eye(count), -np.eye(count)]))
    _set_normalisations(decoder, features)


def _set_pointwise(convolution: keras.layers.Conv2D, matrix: np.ndarray) -> None:
    """Make the first filters act on each position separately, with `matrix` (channels, filters)."""
    kernel = keras.ops.convert_to_numpy(convolution.kernel).copy()
    channels, filters = matrix.shape
    kernel[..., :filters] = 0
    kernel[1, 1, :channels, :filters] = matrix
    convolution.kernel.assign(kernel)


def freeze_normalisations(decoder: keras.Model) -> None:
    """Let the batch normalisations keep their stored statistics, as `solve_decoder` sets them.

    The difference between samples is a small part of the features' spread; statistics that change
    with every batch would hide it. Call it before the optimiser is built.
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
