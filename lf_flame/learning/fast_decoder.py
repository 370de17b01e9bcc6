"""A form of the decoder that trains fast at the paper's batch of two, on processor cores.

The decoder (`lf_flame.learning.decoder`) consists of Keras's own layers. Its training view is the
same function of the same variables, rearranged where batches of two waste time:

- Each 3x3 convolution becomes one matrix product. On feature maps of a few positions and thousands
  of channels a library's convolution spends most of its time rearranging.
- The dense layer outputs its inputs too, and takes an offset of its outputs. The gradient of its
  kernel, as large as the kernel itself, is therefore never stored: Adam is applied to its two
  factors (`lf_flame.learning._adam.update_product`).

Measured on two cores, the matrix products make a step at batch 2 up to 3.1 times faster (1.6 times
with other work on the cores). Only training needs this module: the plain decoder is saved and used.
"""

from typing import NamedTuple

import keras
from keras import layers, ops


class MatrixConvolution(layers.Layer):
    """A "same" 3x3 convolution as one matrix product, on the weights of a `Conv2D`.

    The nine neighbours of every position are concatenated, and multiplied by the kernel as a
    matrix (9 channels, filters).

    Parameters
    ----------
    convolution : keras.layers.Conv2D
        Convolution with a 3x3 kernel, "same" padding, stride 1, with a bias, without activation.
    """

    def __init__(self, convolution: layers.Conv2D):
        super().__init__(name=f"{convolution.name}_as_matrix")
        self.convolution = convolution

    def call(self, x):
        """Convolve [n, h, w, channels] to [n, h, w, filters]."""
        height, width = x.shape[1:3]
        padded = ops.pad(x, ((0, 0), (1, 1), (1, 1), (0, 0)))
        neighbours = [padded[:, i : i + height, j : j + width] for i in range(3) for j in range(3)]
        kernel = ops.reshape(self.convolution.kernel, (-1, self.convolution.filters))
        return ops.matmul(ops.concatenate(neighbours, axis=-1), kernel) + self.convolution.bias

    def compute_output_shape(self, input_shape):
        """Shape of the result: that of the convolution."""
        return self.convolution.compute_output_shape(input_shape)


class OffsetDense(layers.Layer):
    """A dense layer, on its own weights, with an offset of its outputs for each sample.

    The gradient of the offset is that of the outputs. Together with the inputs it gives the
    gradient of the kernel, which need not be stored (`lf_flame.learning.trainers`).

    Parameters
    ----------
    dense : keras.layers.Dense
        Dense layer with a bias, without activation.
    """

    def __init__(self, dense: layers.Dense):
        super().__init__(name=f"{dense.name}_with_offset")
        self.dense = dense

    def call(self, inputs):
        """Apply to [n, inputs] and an offset [n, outputs]; returns [n, outputs]."""
        x, offset = inputs
        return ops.matmul(x, self.dense.kernel) + (offset + self.dense.bias)

    def compute_output_shape(self, input_shapes):
        """Shape of the result: that of the offset."""
        return input_shapes[1]


def training_view(decoder: keras.Model) -> keras.Model:
    """Give the same decoder, on the same variables, in the form that trains fastest on a CPU.

    The convolutions on the feature map become matrix products, and the dense layer outputs its
    inputs and takes an offset; the rest is shared. Training this model trains `decoder`.

    Parameters
    ----------
    decoder : keras.Model
        Decoder from `lf_flame.learning.decoder.build_decoder`.

    Returns
    -------
    keras.Model
        Model with inputs: features [n, h', w', channels], and the offset [n, outputs of the dense
        layer]; outputs: inputs of the dense layer [n, 256], and images [n, planes, h, w, 1].
    """
    x = decoder.input
    offset = keras.Input((decoder.get_layer("basis").units,), name="offset")
    for layer in decoder.layers[1:]:
        if layer.name == "basis":
            vectors, x = x, OffsetDense(layer)([x, offset])
        elif isinstance(layer, layers.Conv2D) and layer.activation is keras.activations.linear:
            x = MatrixConvolution(layer)(x)
        else:
            x = layer(x)
    return keras.Model([decoder.input, offset], [vectors, x], name="decoder_in_training")


class DensePlace(NamedTuple):
    """Place of the dense layer in a training view.

    Attributes
    ----------
    units : int
        Number of the layer's outputs.
    kernel, bias : int
        Index of its kernel and of its bias among the view's trainable variables.
    """

    units: int
    kernel: int
    bias: int


def find_dense(view: keras.Model) -> DensePlace:
    """Find the place of the dense layer in a decoder's training view."""
    dense = next(layer for layer in view.layers if isinstance(layer, OffsetDense)).dense
    places = {id(variable): k for k, variable in enumerate(view.trainable_variables)}
    return DensePlace(dense.units, places[id(dense.kernel)], places[id(dense.bias)])
