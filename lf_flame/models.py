"""The paper's network (section II.C, Figure 4): frozen ResNet-50 and a decoder of its own.

Images are [n, h, w, 1] in, [n, planes, h, w, 1] out, float32 in [0, 1].
"""

from pathlib import Path

import keras
from keras import layers, ops

from lf_flame.backbone import build_backbone
from lf_flame.errors import InputError

DROPOUT_PLACES = ("image", "vector", "none")


def build_refocus_resnet50(
    image: tuple[int, int] = (90, 180),
    planes: int = 4,
    backbone_weights: str | Path = "imagenet",
    backbone_depth: str = "conv5",
    dropout: float = 0.3,
    dropout_place: str = "image",
    seed: int = 0,
) -> keras.Model:
    """Build the Keras functional model that turns one light-field image into refocused images.

    Parameters
    ----------
    image : (int, int)
        Height and width of input and outputs.
    planes : int
        Number of refocused images.
    backbone_weights, backbone_depth
        See `lf_flame.backbone.build_backbone`.
    dropout : float
        Rate, in [0, 1).
    dropout_place : {"image", "vector", "none"}
        "image" is the paper's order, before the last convolution; "vector" behind the global
        average pooling (deviation 9).
    seed : int
        Of the initial weights, of random backbone weights and of the dropout.

    Returns
    -------
    keras.Model
        Input (h, w, 1), output (planes, h, w, 1). Its layers "backbone", frozen and in inference
        mode, and "decoder" are models themselves; because the first never changes, the second
        can be trained on cached features.

    Raises
    ------
    InputError
        If an argument cannot be used.
    """
    backbone = build_backbone(image, backbone_weights, backbone_depth, seed)
    decoder = build_decoder(backbone.output_shape[1:], image, planes, dropout, dropout_place, seed)
    grey = keras.Input((*image, 1), name="light_field_image")
    outputs = decoder(backbone(grey, training=False))
    return keras.Model(grey, outputs, name="refocus_resnet50")


def build_decoder(
    features: tuple[int, int, int],
    image: tuple[int, int],
    planes: int,
    dropout: float = 0.3,
    dropout_place: str = "image",
    seed: int = 0,
) -> keras.Model:
    """Build the trainable part, layer by layer as in the paper's section II.C.

    What the paper leaves open is as Keras has it by default: "same" padding, a linear dense
    layer, slope 0.3 of the leaky ReLU, a 3x3 last convolution (deviation 10).

    Returns
    -------
    keras.Model
        Named "decoder"; input `features`, output (planes, h, w, 1).
    """
    if not 0 <= dropout < 1 or dropout_place not in DROPOUT_PLACES:
        raise InputError(
            f"dropout must be in [0, 1) and dropout_place one of {', '.join(DROPOUT_PLACES)}, "
            f"got {dropout} and {dropout_place!r}."
        )

    def initial(layer: int) -> keras.initializers.Initializer:
        return keras.initializers.GlorotUniform(seed=1000 * seed + layer)

    def drop(x, place: str):
        return layers.Dropout(dropout, seed=seed)(x) if dropout_place == place else x

    feature_map = keras.Input(features, name="features")
    x = _conv_block(feature_map, 512, initial(1))
    x = _conv_block(x, 256, initial(2))
    x = layers.GlobalAveragePooling2D()(x)
    x = drop(x, "vector")
    x = layers.Dense(image[0] * image[1] * planes, kernel_initializer=initial(3), name="basis")(x)
    x = layers.Reshape((*image, planes))(x)
    x = drop(x, "image")
    x = layers.Conv2D(
        planes,
        3,
        padding="same",
        activation="sigmoid",
        kernel_initializer=initial(4),
        name="planes",
    )(x)
    x = layers.Permute((3, 1, 2))(x)
    stack = layers.Reshape((planes, *image, 1))(x)
    return keras.Model(feature_map, stack, name="decoder")


def _conv_block(x, filters: int, initializer):
    x = layers.Conv2D(filters, 3, padding="same", kernel_initializer=initializer)(x)
    return layers.LeakyReLU()(layers.BatchNormalization()(x))


class MatrixConvolution(layers.Layer):
    """A "same" 3x3 convolution as one matrix product, on the weights of a `Conv2D`.

    On feature maps of 3 x 6 positions and 2,048 channels a library's convolution spends most of
    its time rearranging; gathering the nine neighbours and multiplying once avoids that.
    """

    def __init__(self, convolution: layers.Conv2D):
        super().__init__(name=f"{convolution.name}_as_matrix")
        self.convolution = convolution

    def call(self, x):
        """Convolve [n, h, w, channels]."""
        height, width = x.shape[1:3]
        padded = ops.pad(x, ((0, 0), (1, 1), (1, 1), (0, 0)))
        neighbours = [padded[:, i : i + height, j : j + width] for i in range(3) for j in range(3)]
        kernel = ops.reshape(self.convolution.kernel, (-1, self.convolution.filters))
        return ops.matmul(ops.concatenate(neighbours, axis=-1), kernel) + self.convolution.bias

    def compute_output_shape(self, input_shape):
        """Shape of the result: as the convolution's own."""
        return self.convolution.compute_output_shape(input_shape)


def training_view(decoder: keras.Model) -> keras.Model:
    """Give the same decoder, on the same variables, in the form that trains fastest on a CPU.

    The convolutions on the feature map become matrix products; all else is shared. Training this
    trains `decoder`.

    Parameters
    ----------
    decoder : keras.Model
        From `build_decoder`.

    Returns
    -------
    keras.Model
    """
    x = decoder.input
    for layer in decoder.layers[1:]:
        on_features = isinstance(layer, layers.Conv2D) and layer.name != "planes"
        x = MatrixConvolution(layer)(x) if on_features else layer(x)
    return keras.Model(decoder.input, x, name="decoder_in_training")
