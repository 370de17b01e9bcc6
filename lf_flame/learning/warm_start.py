"""Starting the decoder from the training images instead of from noise.

The decoder's last big layer is linear in 256 numbers, so the best images it can draw for what
arrives there have a closed form: ridge regression of the training images before the sigmoid. With
the neck "positions" the regression finds the 256 numbers too. With the paper's pooled neck the two
convolutions start by passing on what a regression on the backbone's averages found. The last
convolution starts as the identity. Training then begins there. Not in the paper (deviation 13), and
off in the recipes that follow it.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import keras
import numpy as np
from tqdm import tqdm

from lf_flame._common.memory import check_memory
from lf_flame.errors import InputError
from lf_flame.learning import ridge
from lf_flame.learning.ridge import ProductGatherer, Regression, gather_products, ridge_regression
from lf_flame.learning.sigmoid_regression import refine

STATISTICS_SAMPLES = 512
"""Samples that set the batch normalisations; more change nothing and need much memory."""


@dataclass(frozen=True)
class Blocks:
    """Samples that come block by block.

    Attributes
    ----------
    count : int
        Samples in all.
    pairs : iterable of (ndarray, ndarray)
        Features (n, h', w', channels) and targets (n, planes, h, w, 1) of the next ones; asked for
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
        From `lf_flame.learning.decoder.build_decoder`; what the samples do not determine stays
        random.
    training : Blocks
        With the neck "positions" a block's features are not needed any more when the next one
        comes, and of more than `lf_flame.learning.ridge.LANDMARKS` samples the images are kept in
        half precision.
    held_out : (ndarray, ndarray)
        Features and targets of other samples, which only choose the strength of the ridge.
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
        _regress_on_averages(decoder, _joined(training.pairs), held_out)
    last = decoder.get_layer("planes")
    _set_pointwise(last, np.eye(last.filters))


def _joined(pairs: Iterable[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, ...]:
    """Join blocks into one; a single one is not copied."""
    first, *others = pairs
    return tuple(map(np.concatenate, zip(first, *others, strict=True))) if others else first


class _Band:
    """A vertical band of the image: the numbers it is drawn from, and what is gathered of it."""

    def __init__(self, decoder: keras.Model, band: int, bands: int, count: int):
        neck = decoder.get_layer("neck")
        _, height, width, planes = decoder.get_layer("planes").output.shape
        self.units, self.drawn = (_part(band, bands, whole) for whole in (neck.units, width))
        self.seen = _overlapped(band, bands, decoder.input.shape[2])
        pixels = height * (self.drawn.stop - self.drawn.start) * planes
        # Half precision errs by 77 dB, where a fit to so many samples leaves 55.
        kind = np.float32 if count <= ridge.LANDMARKS else np.float16
        needed = (
            bands * count * (np.dtype(kind).itemsize * pixels + 4 * min(count, ridge.LANDMARKS))
        )
        check_memory(needed, f"what is kept of {count} training samples")
        self.products = ProductGatherer(count)
        self.images = np.empty((count, pixels), kind)
        self._filled = 0

    def cut(self, features: np.ndarray, targets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Take what belongs to the band, (n, features) and (n, pixels)."""
        return _flat(features[:, :, self.seen]), _flat(_as_drawn(targets)[:, :, self.drawn])

    def add(self, features: np.ndarray, targets: np.ndarray) -> None:
        """Gather the next samples."""
        seen, images = self.cut(features, targets)
        self.products.add(seen)
        self.images[self._filled : self._filled + len(images)] = images
        self._filled += len(images)


def _regress_by_bands(decoder, training: Blocks, held_out, bands: int, refinements: int) -> None:
    """Set neck and basis: a part of the 256 numbers for each band."""
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
    for _ in tqdm(range(bands), "start from the training images", unit="band"):
        band = gathered.pop()  # and forgotten
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
    """Weights of features, minus what the mean gives, drawings of the numbers, and offset."""
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
    """Targets (n, planes, h, w, 1) in the order in which the dense layer draws them."""
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
    """Let the convolutions pass on what a regression on the averages found.

    The first takes each component with both signs, the second their difference: a leaky ReLU of
    slope a keeps (1 + a) x of that, so what reaches the second is linear in the features.
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
    """Make the first filters act on each position alone, by `matrix` (channels, filters)."""
    kernel = keras.ops.convert_to_numpy(convolution.kernel).copy()
    channels, filters = matrix.shape
    kernel[..., :filters] = 0
    kernel[1, 1, :channels, :filters] = matrix
    convolution.kernel.assign(kernel)


def freeze_normalisations(decoder: keras.Model) -> None:
    """Let the batch normalisations keep their stored statistics, as `solve_decoder` sets them.

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
