"""Loss and gradients of a batch on accelerators, through Keras's JAX backend.

The gradient of the dense layer's kernel, nearly all parameters, is written as a sum of outer
products, one for each sample: the compiler puts it into Adam's pass over that kernel, and it is
never stored.
"""

import keras
from keras import ops

from lf_flame.learning.array_training import mean_squared_error
from lf_flame.learning.fast_decoder import find_dense, training_view

OUTER_PRODUCTS = 8
"""Largest batch whose gradient is written as outer products; a matrix product beyond."""


class DeviceGradients:
    """Loss and gradients of a batch as functions that JAX compiles.

    Parameters
    ----------
    decoder : keras.Model
        Decoder from `lf_flame.learning.decoder.build_decoder`.

    Attributes
    ----------
    model : keras.Model
        Training view of the decoder, on the same variables.
    """

    def __init__(self, decoder: keras.Model):
        self.model = training_view(decoder)
        self._dense = find_dense(self.model)

    def of_batch(self, trainable: list, others: list, features, targets):
        """Compute loss, new other values and gradients of a batch in training mode."""
        import jax

        place = self._dense.kernel
        kernel = trainable[place]

        def loss_of(rest, offset):
            parameters = [*rest[:place], kernel, *rest[place:]]
            (vectors, stack), new = self.model.stateless_call(
                parameters, others, [features, offset], training=True
            )
            return mean_squared_error(targets, stack), (vectors, new)

        rest = [x for k, x in enumerate(trainable) if k != place]
        offset = ops.zeros((len(features), self._dense.units))
        both = jax.value_and_grad(loss_of, argnums=(0, 1), has_aux=True)
        (loss, (vectors, new)), (rest, back) = both(rest, offset)
        rest = [*rest[:place], _product(vectors, back), *rest[place:]]
        return loss, new, rest

    def in_inference(self, trainable: list, others: list, features, targets):
        """Compute the loss of a batch in inference mode."""
        inputs = [features, ops.zeros((len(features), self._dense.units))]
        (_, stack), _ = self.model.stateless_call(trainable, others, inputs, training=False)
        return mean_squared_error(targets, stack)


def _product(vectors, back):
    """Gradient ``vectors.T @ back`` of the dense kernel."""
    if len(vectors) > OUTER_PRODUCTS:
        return vectors.T @ back
    return sum(v[:, None] * b[None, :] for v, b in zip(vectors, back, strict=True))
