"""Training on processor cores, in three parts: arrays, gradients, and Adam.

`ParameterArrays` keeps the values of a decoder's variables in NumPy arrays, `FactoredGradients`
computes the gradients of a batch from them with TensorFlow, and `ArrayAdam` updates them in place.
`lf_flame.learning.trainers.ArrayTrainer` runs the epochs with the three. The dense layer before the
image has nearly all parameters; its kernel's gradient is kept as two factors throughout
(`lf_flame.learning.fast_decoder`).
"""

from typing import NamedTuple

import keras
import numpy as np
from keras import ops

from lf_flame.learning import _adam
from lf_flame.learning.fast_decoder import find_dense, training_view

ALIGNMENT = 64
"""Alignment of addresses, in bytes, with which TensorFlow reads memory without a copy."""


class Product(NamedTuple):
    """Gradient of a dense layer's kernel, as the factors of ``inputs.T @ back``.

    Attributes
    ----------
    inputs : ndarray of float32, shape (samples, rows)
        Inputs of the layer.
    back : ndarray of float32, shape (samples, columns)
        Gradient of its outputs.
    """

    inputs: np.ndarray
    back: np.ndarray


class ParameterArrays:
    """Values of a model's variables, in memory that TensorFlow reads without a copy.

    Parameters
    ----------
    model : keras.Model

    Attributes
    ----------
    trainable : list of ndarray of float32
        Values in the order of the model's trainable variables; updated in place.
    others : list of ndarray
        Values in the order of the model's other variables: statistics of batch normalisations, and
        states of random generators. Each batch replaces them.
    """

    def __init__(self, model: keras.Model):
        self.trainable = [_aligned(ops.convert_to_numpy(x)) for x in model.trainable_variables]
        self.others = [x.numpy() for x in model.non_trainable_variables]

    def tensors(self) -> list:
        """Tensors on the memory of the trainable arrays, which must not change meanwhile."""
        from tensorflow.experimental import dlpack

        return [dlpack.from_dlpack(x.__dlpack__()) for x in self.trainable]

    def copies(self) -> list[np.ndarray]:
        """Copy all values, the trainable ones first."""
        return [x.copy() for x in (*self.trainable, *self.others)]


class FactoredGradients:
    """Loss and gradients of a batch by TensorFlow, with the dense kernel's gradient in factors.

    The factors are the inputs of the layer and the gradient of its outputs, which is the gradient
    of a zero offset added there. Everything stays on the processor, where the parameters are, even
    if there is a GPU.

    Parameters
    ----------
    decoder : keras.Model
        Decoder from `lf_flame.learning.decoder.build_decoder`.

    Attributes
    ----------
    model : keras.Model
        Training view of the decoder.
    """

    def __init__(self, decoder: keras.Model):
        self.model = training_view(decoder)
        self._dense = find_dense(self.model)
        self.run_batch = _on_processor(self._run_batch)
        self.run_in_inference = _on_processor(self._run_in_inference)

    def of_batch(
        self, arrays: ParameterArrays, features: np.ndarray, targets: np.ndarray
    ) -> tuple[float, list[np.ndarray | Product], list[np.ndarray]]:
        """Compute loss and gradients of a batch in training mode.

        Parameters
        ----------
        arrays : ParameterArrays
        features : ndarray of float32, shape (samples, h', w', channels)
        targets : ndarray of float32, shape (samples, planes, h, w, 1)

        Returns
        -------
        loss : float
        gradients : list of (ndarray of float32 or Product)
            Gradient of each trainable array.
        others : list of ndarray
            New values of the other variables.
        """
        loss, others, rest, vectors, back = self.run_batch(
            arrays.tensors(), arrays.others, features, targets
        )
        others = [x.numpy() for x in others]
        rest, back = (np.from_dlpack(x) for x in rest), np.from_dlpack(back)
        of_dense = {
            self._dense.kernel: Product(np.from_dlpack(vectors), back),
            self._dense.bias: back.sum(axis=0),
        }
        count = len(arrays.trainable)
        gradients = [of_dense[k] if k in of_dense else next(rest) for k in range(count)]
        return float(loss), gradients, others

    def _run_batch(self, parameters, others, features, targets):
        """Loss, new other values, gradients except the dense layer's, and that one's factors."""
        import tensorflow as tf

        offset = tf.zeros((tf.shape(features)[0], self._dense.units))
        apart = (self._dense.kernel, self._dense.bias)
        watched = [x for k, x in enumerate(parameters) if k not in apart]
        with tf.GradientTape(watch_accessed_variables=False) as tape:
            tape.watch([*watched, offset])
            (vectors, stack), others = self.model.stateless_call(
                parameters, others, [features, offset], training=True
            )
            loss = mean_squared_error(targets, stack)
        *rest, back = tape.gradient(loss, [*watched, offset])
        return loss, others, rest, vectors, back

    def _run_in_inference(self, parameters, others, features, targets):
        import tensorflow as tf

        inputs = [features, tf.zeros((tf.shape(features)[0], self._dense.units))]
        (_, stack), _ = self.model.stateless_call(parameters, others, inputs, training=False)
        return mean_squared_error(targets, stack)


class ArrayAdam:
    """Adam (Kingma & Ba 2015) with Keras's constants, on arrays, in place.

    Parameters
    ----------
    learning_rate : float or keras.optimizers.schedules.LearningRateSchedule
    parameters : list of ndarray of float32
        Arrays to update; only their shapes are read here.

    Attributes
    ----------
    steps : ndarray of int64, shape ()
        Number of updates so far.
    moments : list of ndarray of float32, shape (2, *shape of the parameter)
        Running means of the gradient and of its square.
    """

    def __init__(self, learning_rate, parameters: list[np.ndarray]):
        self._learning_rate = learning_rate
        self._constants = keras.optimizers.Adam()
        self.steps = np.zeros((), np.int64)
        self.moments = [np.zeros((2, *x.shape), np.float32) for x in parameters]

    def update(self, parameters: list[np.ndarray], gradients: list[np.ndarray | Product]) -> None:
        """Take one step; `gradients` has an array or a `Product` for each parameter."""
        constants = self._next_constants()
        for parameter, moments, gradient in zip(parameters, self.moments, gradients, strict=True):
            if isinstance(gradient, Product):
                _adam.update_product(parameter, *moments, *gradient, *constants)
            else:
                flat = (x.reshape(-1) for x in (parameter, *moments, gradient))
                _adam.update_all(*flat, *constants)

    def _next_constants(self) -> list[np.float32]:
        """Rate of the next step with its bias corrections, 1 - beta twice, and epsilon."""
        rate, adam = self._learning_rate, self._constants
        rate = float(rate(self.steps)) if callable(rate) else rate
        self.steps += 1
        step = int(self.steps)
        rate *= np.sqrt(1 - adam.beta_2**step) / (1 - adam.beta_1**step)
        return [np.float32(x) for x in (rate, 1 - adam.beta_1, 1 - adam.beta_2, adam.epsilon)]


def mean_squared_error(targets, stack):
    """Mean squared difference over samples, output images (planes) and pixels."""
    return ops.mean(ops.square(stack - targets))


def _on_processor(function):
    """Compile a function for the processor."""
    import tensorflow as tf

    def placed(*arguments):
        with tf.device("CPU:0"):
            return function(*arguments)

    return tf.function(placed)


def _aligned(values: np.ndarray) -> np.ndarray:
    """Copy to memory that TensorFlow can share."""
    memory = np.empty(values.nbytes + ALIGNMENT, np.uint8)
    start = -memory.ctypes.data % ALIGNMENT
    array = memory[start : start + values.nbytes].view(values.dtype).reshape(values.shape)
    array[...] = values
    return array
