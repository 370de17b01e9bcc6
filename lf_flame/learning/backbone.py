"""The frozen encoder: ResNet-50 in inference mode, cut after its third, fourth or fifth stage.

It can also be left out, to measure its benefit.

Its weights come from ImageNet (`lf_flame.learning.imagenet_weights`), from a file, or from a seed.
Frozen means that the batch normalisations also use their stored statistics (deviation 8).
"""

import hashlib
import warnings
from pathlib import Path

import keras
import numpy as np

from lf_flame._common.arrays_in_files import ArrayFile
from lf_flame._common.input_files import printable, readable
from lf_flame.datasets.encodings import SMALLEST
from lf_flame.errors import InputError
from lf_flame.learning.imagenet_weights import imagenet_file
from lf_flame.learning.keras_loading import check_keras

STAGES = {f"conv{k}": f"conv{k}_block{n}_out" for k, n in ((3, 4), (4, 6), (5, 3))}
"""Layer that is the backbone's output, for each depth at which it can be cut."""

NO_BACKBONE = "none"
"""Depth without a backbone: the image itself is the feature map."""

IMAGENET_BGR_MEAN = (103.939, 116.779, 123.68)
"""Mean that `keras.applications.resnet.preprocess_input` subtracts, on a scale from 0 to 255."""


def build_backbone(
    shown: tuple[int, int, int] = (90, 180, 1),
    weights: str | Path = "imagenet",
    depth: str = "conv5",
    seed: int = 0,
) -> keras.Model:
    """Build the frozen encoder with its own preprocessing; input [h, w, 1 or 3] in [0, 1].

    `weights`, `depth` and `seed` are those of `lf_flame.learning.decoder.build_refocus_resnet50`;
    three channels are red, green, blue, and one is repeated.
    """
    check_keras()
    if depth == NO_BACKBONE:
        picture = keras.Input(shown, name="light_field_image")
        return keras.Model(picture, keras.layers.Rescaling(1.0)(picture), name="backbone")
    if depth not in STAGES:
        known = ", ".join([*STAGES, NO_BACKBONE])
        raise InputError(f"backbone_depth must be one of {known}, got {depth!r}.")
    if min(shown[:2]) < SMALLEST:  # Keras refuses them in other words
        raise InputError(
            f"ResNet-50 needs images of {SMALLEST} pixels or more along each side, got "
            f"{shown[0]} x {shown[1]}."
        )
    resnet = _load_resnet50(shown[:2], weights, seed, depth)
    seen = keras.Input(shown, name="light_field_image")
    channels = _to_bgr(seen)
    offset = [-mean for mean in IMAGENET_BGR_MEAN]
    centred = keras.layers.Rescaling(255.0, offset=offset, name="imagenet_preprocessing")(channels)
    backbone = keras.Model(seen, resnet(centred, training=False), name="backbone")
    backbone.trainable = False
    return backbone


def _to_bgr(seen):
    """Repeat one channel, or reverse the order of three."""
    if seen.shape[-1] == 1:
        return keras.layers.Concatenate(name="grey_to_bgr")([seen, seen, seen])
    return keras.ops.flip(seen, axis=-1)


def describe_weights(weights: str | Path, depth: str, seed: int) -> str:
    """Name the weights for tables and records: a file by its name and part of its SHA-256."""
    if depth == NO_BACKBONE:
        return "no backbone"
    if weights == "imagenet":
        return f"imagenet, {depth}"
    if weights == "random":
        return f"random (seed {seed}), {depth}"
    if not Path(weights).is_file():
        raise InputError(
            f"backbone_weights must be imagenet, random or a weights file, "
            f"and there is no file {weights}."
        )
    digest = hashlib.sha256(Path(weights).read_bytes()).hexdigest()[:12]
    return f"{printable(Path(weights).name)} (sha256 {digest}), {depth}"


def _load_resnet50(image, weights, seed, depth) -> keras.Model:
    file = imagenet_file() if weights == "imagenet" else None
    full = keras.applications.ResNet50(include_top=False, weights=file, input_shape=(*image, 3))
    cut = keras.Model(full.input, full.get_layer(STAGES[depth]).output, name="resnet50")
    if weights == "random":
        _randomise(cut, seed)
    elif weights != "imagenet":
        _load_file(full, cut, Path(weights))
        _refuse_untrained(cut, Path(weights))
    return cut


def _randomise(model: keras.Model, seed: int) -> None:
    """Draw He-normal kernels (He et al. 2015) that keep the features of order 1.

    The first normalisation divides by the range of the pixels, as no statistics are measured; the
    last of each residual block keeps the sum from doubling its variance.
    """
    rng = np.random.default_rng(seed)
    for layer in model.layers:
        for weight in layer.weights:
            if weight.name == "kernel":
                fan_in = np.prod(weight.shape[:-1])
                value = rng.normal(0, np.sqrt(2 / fan_in), weight.shape)
            elif weight.name == "gamma":
                value = np.full(weight.shape, 0.5 if layer.name.endswith("_3_bn") else 1.0)
            elif weight.name == "moving_variance":
                value = np.full(weight.shape, 128.0**2 if layer.name == "conv1_bn" else 1.0)
            else:
                value = np.zeros(weight.shape)
            weight.assign(value.astype(np.float32))


def _load_file(full: keras.Model, cut: keras.Model, path: Path) -> None:
    if path.suffix == ".npz":
        _load_npz(cut, path)
        return
    fault = "does not contain the weights of keras.applications.ResNet50(include_top=False)"
    with readable(path, fault), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Keras warns of each layer that the file lacks
        full.load_weights(path)


def _refuse_untrained(model: keras.Model, path: Path) -> None:
    """Refuse kernels without a number: a pruned network has many zeros, but also others."""
    for layer in model.layers:
        for weight in layer.weights:
            values = keras.ops.convert_to_numpy(weight)
            if not np.isfinite(values).all() or (weight.name == "kernel" and not values.any()):
                raise InputError(
                    f"{layer.name}/{weight.name} in {path} is all zeros, or contains NaN or "
                    f"infinite values: the file contains no trained weights."
                )


def _load_npz(model: keras.Model, path: Path) -> None:
    wanted = {
        f"{layer.name}/{weight.name}": weight for layer in model.layers for weight in layer.weights
    }
    file = ArrayFile(path)
    for name, weight in wanted.items():
        if name not in file.names:
            raise InputError(
                f"{path} lacks {name}; it must contain every layer up to the chosen depth "
                f"(a file that ends at conv4 goes with backbone_depth conv4)."
            )
        shape = file.header(name).shape
        if shape != tuple(weight.shape):
            raise InputError(
                f"{name} in {path} must have shape {tuple(weight.shape)}, got {shape}."
            )
    for weight, values in zip(wanted.values(), file.read(wanted), strict=True):
        weight.assign(values)
