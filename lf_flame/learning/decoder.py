"""The paper's network (section II.C, Figure 4): a frozen ResNet-50 and the paper's decoder.

The input is [n, h, w, channels], the output [n, planes, h, w, 1], both float32 in [0, 1]; `planes`
is the number of refocused images.

Other modules find layers by name: "backbone" and "decoder" of the whole model.
"""

from pathlib import Path

import keras
from keras import layers

from lf_flame.errors import InputError
from lf_flame.learning.backbone import build_backbone

DROPOUT_PLACES = ("image", "vector", "none")
AVERAGES = 256
"""Filters of the second convolution: all images are made from this many averages."""


def build_refocus_resnet50(
    image: tuple[int, int] = (90, 180),
    planes: int = 4,
    backbone_weights: str | Path = "imagenet",
    backbone_depth: str = "conv5",
    dropout: float = 0.3,
    dropout_place: str = "image",
    seed: int = 0,
    shown: tuple[int, int, int] | None = None,
) -> keras.Model:
    """Build the Keras model that turns one light-field image into refocused images.

    Parameters
    ----------
    image : (int, int)
        Height and width of the outputs.
    planes : int
        Number of refocused images.
    backbone_weights : {"imagenet", "random"} or path
        Source of the frozen weights. "imagenet" downloads once into Keras's cache,
        ``~/.keras/models``. A path is that of a Keras weights file (``.h5``, ``.weights.h5``) of
        `keras.applications.ResNet50` without its top, or of an ``.npz`` with arrays
        ``layer/variable``. "random" draws He-normal kernels with NumPy, the same on every backend.
    backbone_depth : {"conv5", "conv4", "conv3", "none"}
        Stage whose output is the feature map; "none": the image itself, without any weights.
    dropout : float
        Rate of the dropout, in [0, 1).
    dropout_place : {"image", "vector", "none"}
        Position of the dropout: "image" is the paper's, before the last convolution; "vector" is
        after the global average pooling (deviation 9).
    seed : int
        Seed of the initial weights, of random backbone weights and of the dropout.
    shown : (int, int, int), optional
        Height, width and channels of the input, see `lf_flame.datasets.encodings`. Default:
        (h, w, 1).

    Returns
    -------
    keras.Model
        Model with input `shown`, output (planes, h, w, 1). Its layers "backbone", frozen and in
        inference mode, and "decoder" are models themselves; since the backbone never changes, the
        decoder can be trained on cached features.

    Raises
    ------
    InputError
        If an argument cannot be used.

    Examples
    --------
    >>> from lf_flame.learning import build_refocus_resnet50
    >>> model = build_refocus_resnet50(
    ...     image=(36, 72), backbone_weights="random", backbone_depth="conv3"
    ... )
    >>> model.output_shape
    (None, 4, 36, 72, 1)
    """
    shown = shown or (*image, 1)
    backbone = build_backbone(shown, backbone_weights, backbone_depth, seed)
    decoder = build_decoder(backbone.output_shape[1:], image, planes, dropout, dropout_place, seed)
    seen = keras.Input(shown, name="light_field_image")
    outputs = decoder(backbone(seen, training=False))
    return keras.Model(seen, outputs, name="refocus_resnet50")


def build_decoder(
    features: tuple[int, int, int],
    image: tuple[int, int],
    planes: int,
    dropout: float = 0.3,
    dropout_place: str = "image",
    seed: int = 0,
) -> keras.Model:
    """Build the trainable part, layer by layer as in the paper's section II.C.

    Where the paper states nothing, Keras's defaults apply: "same" padding, a linear dense layer,
    slope 0.3 of the leaky ReLU, a 3x3 last convolution (deviation 10).

    Parameters
    ----------
    features : (int, int, int)
        Height, width and channels of the feature map.
    image : (int, int)
        Height and width of the outputs.
    planes : int
        Number of refocused images.
    dropout, dropout_place, seed
        See `build_refocus_resnet50`.

    Returns
    -------
    keras.Model
        Model "decoder" with input `features`, output (planes, h, w, 1).

    Examples
    --------
    >>> from lf_flame.learning import build_decoder
    >>> build_decoder((3, 6, 1024), (9, 18), planes=4).output_shape
    (None, 4, 9, 18, 1)
    """
    if not 0 <= dropout < 1 or dropout_place not in DROPOUT_PLACES:
        raise InputError(
            f"dropout must be in [0, 1) and dropout_place one of {', '.join(DROPOUT_PLACES)}, "
            f"got {dropout} and {dropout_place!r}."
        )

    def initial(layer: int) -> keras.initializers.Initializer:
        return keras.initializers.GlorotUniform(seed=1000 * seed + layer)

    def drop_at(place: str, x):
        return layers.Dropout(dropout, seed=seed)(x) if dropout_place == place else x

    feature_map = keras.Input(features, name="features")
    x = _conv_block(feature_map, 512, initial(1))
    x = _conv_block(x, AVERAGES, initial(2))
    x = layers.GlobalAveragePooling2D()(x)
    x = drop_at("vector", x)
    x = layers.Dense(image[0] * image[1] * planes, kernel_initializer=initial(3))(x)
    x = layers.Reshape((*image, planes))(x)
    x = drop_at("image", x)
    last = {"activation": "sigmoid", "kernel_initializer": initial(4)}
    x = layers.Conv2D(planes, 3, padding="same", **last)(x)
    x = layers.Permute((3, 1, 2))(x)
    stack = layers.Reshape((planes, *image, 1))(x)
    return keras.Model(feature_map, stack, name="decoder")


def _conv_block(x, filters: int, initializer):
    x = layers.Conv2D(filters, 3, padding="same", kernel_initializer=initializer)(x)
    return layers.LeakyReLU()(layers.BatchNormalization()(x))
