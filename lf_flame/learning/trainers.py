"""What runs the epochs: Adam on the mean squared error of the decoder, over cached features.

`ArrayTrainer` is for processor cores: TensorFlow computes the gradients, and the parameters live in
NumPy arrays that one compiled pass updates. `DeviceTrainer` is for accelerators, on Keras's JAX
backend: features, parameters and the loop over the batches stay on the device for a whole epoch.
Both use Keras's own layers and give, within rounding, the losses of `keras.Model.train_on_batch`
with `keras.optimizers.Adam`.
"""

import keras
import numpy as np
from keras import ops

from lf_flame.errors import InputError
from lf_flame.learning import _adam
from lf_flame.learning.fast_decoder import training_view

EVALUATION_BATCH = 32


def make_trainer(decoder: keras.Model, learning_rate, batch_size: int, arrays: dict):
    """Choose the trainer for Keras's backend.

    Parameters
    ----------
    decoder : keras.Model
        From `lf_flame.learning.decoder.build_decoder`; training starts from its weights.
    learning_rate : float or keras.optimizers.schedules.LearningRateSchedule
    batch_size : int
    arrays : dict
        ``name: (features, targets)``, at least "train"; float32, shapes (n, h', w', channels) and
        (n, planes, h, w, 1).

    Returns
    -------
    ArrayTrainer or DeviceTrainer

    Raises
    ------
    InputError
        If the backend is another than TensorFlow or JAX.
    """
    kinds = {"tensorflow": ArrayTrainer, "jax": DeviceTrainer}
    backend = keras.backend.backend()
    if backend not in kinds:
        raise InputError(
            f"Training runs on Keras's backends {' and '.join(kinds)}; KERAS_BACKEND is {backend}."
        )
    return kinds[backend](decoder, learning_rate, batch_size, arrays)


def decoder_variables(decoder: keras.Model) -> list[keras.Variable]:
    """Variables of a decoder, in the order of the trainers' `weights`."""
    return [*decoder.trainable_variables, *decoder.non_trainable_variables]


class _Trainer:
    """What the trainers share."""

    def __init__(self, model: keras.Model, batch_size: int, arrays: dict):
        self.model, self.batch_size, self.arrays = model, batch_size, arrays

    def train_epoch(self, rng: np.random.Generator) -> float:
        """Train on all samples once, in an order drawn at random; mean loss while doing so."""
        return self.train_in_order(rng.permutation(len(self.arrays["train"][0])))


class ArrayTrainer(_Trainer):
    """Trains on processor cores; see the module's text and `make_trainer`."""

    def __init__(self, decoder: keras.Model, learning_rate, batch_size: int, arrays: dict):
        super().__init__(training_view(decoder), batch_size, arrays)
        self._learning_rate = learning_rate
        self._adam = keras.optimizers.Adam()  # its constants
        self._steps = np.zeros((), np.int64)
        variables = self.model.trainable_variables
        self._parameters = [_aligned(keras.ops.convert_to_numpy(x)) for x in variables]
        self._moments = [np.zeros((2, *x.shape), np.float32) for x in variables]
        self._others = [x.numpy() for x in self.model.non_trainable_variables]
        basis = decoder.get_layer("basis")
        self._kernel, self._bias = (
            next(k for k, x in enumerate(variables) if x is y) for y in (basis.kernel, basis.bias)
        )
        self._gradients, self._evaluate = self._compile()

    def _compile(self):
        """Compile a batch's gradients, and its loss in inference.

        The gradient of the dense layer's kernel is given by its factors: the vectors that went in
        and what comes back to its outputs, which is the gradient of an offset of zero there. All
        stays on the processor, where the parameters are, even if there is a GPU.
        """
        import tensorflow as tf

        model, apart = self.model, (self._kernel, self._bias)
        units = self._parameters[self._bias].size

        def gradients(parameters, others, features, targets):
            offset = tf.zeros((len(features), units))
            watched = [x for k, x in enumerate(parameters) if k not in apart]
            with tf.GradientTape(watch_accessed_variables=False) as tape:
                tape.watch([*watched, offset])
                (vectors, stack), others = model.stateless_call(
                    parameters, others, [features, offset], training=True
                )
                loss = _loss(targets, stack)
            *rest, back = tape.gradient(loss, [*watched, offset])
            return loss, others, rest, vectors, back

        def evaluate(parameters, others, features, targets):
            inputs = [features, tf.zeros((len(features), units))]
            (_, stack), _ = model.stateless_call(parameters, others, inputs, training=False)
            return _loss(targets, stack)

        def on_processor(function):
            def placed(*arguments):
                with tf.device("CPU:0"):
                    return function(*arguments)

            return tf.function(placed)

        return on_processor(gradients), on_processor(evaluate)

    def train_in_order(self, order: np.ndarray) -> float:
        """Train on the samples in this order, once each; mean loss while doing so."""
        features, targets = self.arrays["train"]
        batches = _batches(order, self.batch_size)
        return sum(self._step(features[k], targets[k]) * len(k) for k in batches) / len(order)

    def _step(self, features: np.ndarray, targets: np.ndarray) -> float:
        loss, others, *gradients = self._gradients(self._tensors(), self._others, features, targets)
        self._others = [x.numpy() for x in others]
        self._update(*gradients)
        return float(loss)

    def _tensors(self) -> list:
        """Parameters as tensors on the same memory, which does not change while they are used."""
        from tensorflow.experimental import dlpack

        return [dlpack.from_dlpack(x.__dlpack__()) for x in self._parameters]

    def _update(self, rest: list, vectors, back) -> None:
        constants, rest, back = self._next_constants(), iter(rest), np.from_dlpack(back)
        for k, (parameter, moments) in enumerate(zip(self._parameters, self._moments, strict=True)):
            if k == self._kernel:
                _adam.update_product(parameter, *moments, np.from_dlpack(vectors), back, *constants)
                continue
            gradient = back.sum(axis=0) if k == self._bias else np.from_dlpack(next(rest))
            flat = (x.reshape(-1) for x in (parameter, *moments, gradient))
            _adam.update_all(*flat, *constants)

    def _next_constants(self) -> list[np.float32]:
        """Rate of the next step with its bias corrections, 1 - beta twice, and epsilon."""
        rate, adam = self._learning_rate, self._adam
        rate = float(rate(self._steps)) if callable(rate) else rate
        self._steps += 1
        step = int(self._steps)
        rate *= np.sqrt(1 - adam.beta_2**step) / (1 - adam.beta_1**step)
        return [np.float32(x) for x in (rate, 1 - adam.beta_1, 1 - adam.beta_2, adam.epsilon)]

    def evaluate(self, part: str) -> float:
        """Loss over all samples of a part, in inference."""
        features, targets = self.arrays[part]
        parameters, total = self._tensors(), 0.0
        for k in _batches(np.arange(len(features)), EVALUATION_BATCH):
            loss = self._evaluate(parameters, self._others, features[k], targets[k])
            total += float(loss) * len(k)
        return total / len(features)

    @property
    def weights(self) -> list[np.ndarray]:
        """Copies of all values of the decoder, in the order of `decoder_variables`."""
        return [x.copy() for x in (*self._parameters, *self._others)]

    @property
    def state(self) -> list[np.ndarray]:
        """Everything that the next epoch depends on; set it to go on from there."""
        return [self._steps, *self._parameters, *self._moments, *self._others]

    @state.setter
    def state(self, values) -> None:
        for array, value in zip(self.state, values, strict=True):
            array[...] = value


class DeviceTrainer(_Trainer):
    """Trains on an accelerator through JAX; see the module's text and `make_trainer`."""

    def __init__(self, decoder: keras.Model, learning_rate, batch_size: int, arrays: dict):
        import jax

        super().__init__(decoder, batch_size, jax.device_put(arrays))
        self._adam = keras.optimizers.Adam(learning_rate)
        self._adam.build(decoder.trainable_variables)
        groups = decoder.trainable_variables, decoder.non_trainable_variables, self._adam.variables
        # Copied, because an epoch takes over the memory of the state that it is given.
        self._state = [[x.value.copy() for x in group] for group in groups]
        self._epoch = jax.jit(self._run, donate_argnums=0)
        self._evaluate = jax.jit(self._loss_in_inference)

    def train_in_order(self, order: np.ndarray) -> float:
        """Train on the samples in this order, once each; mean loss while doing so."""
        whole = len(order) // self.batch_size * self.batch_size
        total = 0.0
        for part in (order[:whole].reshape(-1, self.batch_size), order[None, whole:]):
            if part.size:
                self._state, losses = self._epoch(self._state, part, *self.arrays["train"])
                total += float(losses.sum()) * part.shape[1]
        return total / len(order)

    def _run(self, state, batches, features, targets):
        """Train on each row of indices; new state and the losses."""
        import jax

        def step(state, chosen):
            trainable, others, optimizer = state
            gradient = jax.value_and_grad(self._loss_in_training, has_aux=True)
            (loss, others), gradients = gradient(
                trainable, others, features[chosen], targets[chosen]
            )
            trainable, optimizer = self._adam.stateless_apply(optimizer, gradients, trainable)
            return [list(trainable), list(others), list(optimizer)], loss

        return jax.lax.scan(step, state, batches)

    def _loss_in_training(self, trainable, others, features, targets):
        stack, others = self.model.stateless_call(trainable, others, features, training=True)
        return _loss(targets, stack), others

    def _loss_in_inference(self, trainable, others, features, targets):
        stack, _ = self.model.stateless_call(trainable, others, features, training=False)
        return _loss(targets, stack)

    def evaluate(self, part: str) -> float:
        """Loss over all samples of a part, in inference."""
        features, targets = self.arrays[part]
        total = 0.0
        for first in range(0, len(features), EVALUATION_BATCH):
            batch = (x[first : first + EVALUATION_BATCH] for x in (features, targets))
            x, y = batch
            total += float(self._evaluate(*self._state[:2], x, y)) * len(x)
        return total / len(features)

    @property
    def weights(self) -> list[np.ndarray]:
        """Copies of all values of the decoder, in the order of `decoder_variables`."""
        return [np.array(x) for group in self._state[:2] for x in group]

    @property
    def state(self) -> list[np.ndarray]:
        """Everything that the next epoch depends on; set it to go on from there."""
        return [np.asarray(x) for group in self._state for x in group]

    @state.setter
    def state(self, values) -> None:
        import jax

        values = iter(values)
        self._state = [[jax.device_put(next(values)) for _ in group] for group in self._state]


def _loss(targets, stack):
    return ops.mean(ops.square(stack - targets))


def _batches(order: np.ndarray, size: int):
    return (order[first : first + size] for first in range(0, len(order), size))


def _aligned(values: np.ndarray) -> np.ndarray:
    """Copy to memory that TensorFlow can share: it wants addresses divisible by 64."""
    memory = np.empty(values.nbytes + 64, np.uint8)
    start = -memory.ctypes.data % 64
    array = memory[start : start + values.nbytes].view(values.dtype).reshape(values.shape)
    array[...] = values
    return array
