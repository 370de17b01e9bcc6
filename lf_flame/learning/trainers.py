"""Trainers that run the epochs: Adam on the decoder's mean squared error, over cached features.

`ArrayTrainer` is for processor cores: TensorFlow computes the gradients, and the parameters are
NumPy arrays that one compiled pass updates (`lf_flame.learning.array_training`). `DeviceTrainer` is
for accelerators, on Keras's JAX backend: features, parameters and the loop over the batches stay on
the device for a whole epoch. Both use Keras's own layers. Up to rounding, their losses are those of
`KerasTrainer`, which compiles the decoder with `keras.optimizers.Adam` and calls its `fit`.
"""

import logging
import math
from abc import ABC, abstractmethod

import keras
import numpy as np
from keras import ops

from lf_flame.errors import InputError
from lf_flame.learning.array_training import ArrayAdam, FactoredGradients, ParameterArrays
from lf_flame.learning.device_training import DeviceGradients

LOGGER = logging.getLogger(__name__)

EVALUATION_BATCH = 32

UNROLLED = 4
"""Steps in one round of a device's loop: an epoch of 640 steps takes 0.24 s in place of 0.26 on an
NVIDIA H200 (shapes of the paper, from epoch 1,935 on)."""


def make_trainer(
    decoder: keras.Model, learning_rate, batch_size: int, arrays: dict, kind: str = "fast"
) -> "ArrayTrainer | DeviceTrainer | KerasTrainer":
    """Choose the trainer for Keras's backend, or Keras's own.

    Parameters
    ----------
    decoder : keras.Model
        Decoder from `lf_flame.learning.decoder.build_decoder`; training starts from its weights.
    learning_rate : float or keras.optimizers.schedules.LearningRateSchedule
        Learning rate of Adam.
    batch_size : int
        Number of samples in a batch.
    arrays : dict
        Pairs ``name: (features, targets)``, at least "train"; float32, shapes (n, h', w', channels)
        and (n, planes, h, w, 1).
    kind : {"fast", "keras"}, optional
        Fastest form for the backend, or Keras's own `fit`.

    Returns
    -------
    ArrayTrainer, DeviceTrainer or KerasTrainer

    Raises
    ------
    InputError
        If the kind is "fast" and the backend is neither TensorFlow nor JAX.
    """
    if kind == "keras":
        return KerasTrainer(decoder, learning_rate, batch_size, arrays)
    kinds: dict[str, type[ArrayTrainer | DeviceTrainer]]
    kinds = {"tensorflow": ArrayTrainer, "jax": DeviceTrainer}
    backend = keras.backend.backend()
    if backend not in kinds:
        raise InputError(
            f"Training runs on Keras's backends {' and '.join(kinds)}; KERAS_BACKEND is {backend}."
        )
    return kinds[backend](decoder, learning_rate, batch_size, arrays)


def all_variables(model: keras.Model) -> list[keras.Variable]:
    """Variables of a model, in the order of the trainers' `weights`."""
    return [*model.trainable_variables, *model.non_trainable_variables]


class _Trainer(ABC):
    """Base of the trainers."""

    def __init__(self, model: keras.Model, batch_size: int, arrays: dict):
        self.model, self.batch_size, self.arrays = model, batch_size, arrays

    def train_epoch(self, rng: np.random.Generator) -> float:
        """Train once on all samples in random order; returns the mean loss meanwhile."""
        return self.train_in_order(rng.permutation(len(self.arrays["train"][0])))

    @abstractmethod
    def train_in_order(self, order: np.ndarray) -> float:
        """Train once on the samples in this order; returns the mean loss meanwhile."""


class ArrayTrainer(_Trainer):
    """Trainer for processor cores; see `lf_flame.learning.trainers` and `make_trainer`.

    Attributes
    ----------
    parameters : lf_flame.learning.array_training.ParameterArrays
        Values of the decoder's variables.
    gradients : lf_flame.learning.array_training.FactoredGradients
        Computation of the gradients.
    adam : lf_flame.learning.array_training.ArrayAdam
        Optimiser.
    """

    def __init__(self, decoder: keras.Model, learning_rate, batch_size: int, arrays: dict):
        self.gradients = FactoredGradients(decoder)
        super().__init__(self.gradients.model, batch_size, arrays)
        self.parameters = ParameterArrays(self.model)
        self.adam = ArrayAdam(learning_rate, self.parameters.trainable)

    def train_in_order(self, order: np.ndarray) -> float:
        """Train once on the samples in this order; returns the mean loss meanwhile."""
        features, targets = self.arrays["train"]
        batches = _batches(order, self.batch_size)
        return sum(self._step(features[k], targets[k]) * len(k) for k in batches) / len(order)

    def _step(self, features: np.ndarray, targets: np.ndarray) -> float:
        loss, gradients, others = self.gradients.of_batch(self.parameters, features, targets)
        self.parameters.others = others
        self.adam.update(self.parameters.trainable, gradients)
        return loss

    def evaluate(self, part: str) -> float:
        """Loss over all samples of a part, in inference mode."""
        features, targets = self.arrays[part]
        values, total = (self.parameters.tensors(), self.parameters.others), 0.0
        for k in _batches(np.arange(len(features)), EVALUATION_BATCH):
            loss = self.gradients.run_in_inference(*values, features[k], targets[k])
            total += float(loss) * len(k)
        return total / len(features)

    @property
    def weights(self) -> list[np.ndarray]:
        """Copies of all values of the decoder, in the order of `all_variables`."""
        return self.parameters.copies()

    @property
    def state(self) -> list[np.ndarray]:
        """Everything that the next epoch depends on; set it to continue from there."""
        parameters, adam = self.parameters, self.adam
        return [adam.steps, *parameters.trainable, *adam.moments, *parameters.others]

    @state.setter
    def state(self, values) -> None:
        for array, value in zip(self.state, values, strict=True):
            array[...] = value


class DeviceTrainer(_Trainer):
    """Trainer for accelerators, through JAX; see `lf_flame.learning.trainers`.

    Several devices share each batch (`keras.distribution.DataParallel`): every device holds the
    parameters, and computes the gradients of its part. Up to rounding, the losses are those of one
    device. As many devices are used as divide the batch; a smaller last batch that they do not
    divide is computed by each of them in whole.
    """

    def __init__(self, decoder: keras.Model, learning_rate, batch_size: int, arrays: dict):
        import jax

        devices = keras.distribution.list_devices()
        count = math.gcd(batch_size, len(devices))
        if count < len(devices):
            LOGGER.warning(
                f"Training on {count} of {len(devices)} devices, which divide the batch of "
                f"{batch_size} samples."
            )
        self.devices = keras.distribution.DataParallel(devices=devices[:count])
        self.gradients = DeviceGradients(decoder)
        super().__init__(self.gradients.model, batch_size, jax.tree.map(self._on_all, arrays))
        self._adam = keras.optimizers.Adam(learning_rate)
        self._adam.build(decoder.trainable_variables)
        groups = decoder.trainable_variables, decoder.non_trainable_variables, self._adam.variables
        # Copied, because an epoch takes over the memory of the state passed to it.
        self._state = [[self._on_all(x.value.copy()) for x in group] for group in groups]
        self._epoch = jax.jit(self._run, donate_argnums=0)
        self._evaluate = jax.jit(self.gradients.in_inference)

    def train_in_order(self, order: np.ndarray) -> float:
        """Train once on the samples in this order; returns the mean loss meanwhile."""
        whole = len(order) // self.batch_size * self.batch_size
        total = 0.0
        for part in (order[:whole].reshape(-1, self.batch_size), order[None, whole:]):
            if part.size:
                self._state, losses = self._epoch(self._state, part, *self.arrays["train"])
                total += float(losses.sum()) * part.shape[1]
        return total / len(order)

    def _run(self, state, batches, features, targets):
        """Train on each row of indices; returns new state and losses."""
        import jax

        def step(state, batch):
            trainable, others, optimizer = state
            parts = (self._shared(x[batch]) for x in (features, targets))
            loss, others, gradients = self.gradients.of_batch(trainable, others, *parts)
            trainable, optimizer = self._adam.stateless_apply(optimizer, gradients, trainable)
            return [list(trainable), list(others), list(optimizer)], loss

        return jax.lax.scan(step, state, batches, unroll=UNROLLED)

    def _on_all(self, array):
        """Give every device the whole array."""
        layout = keras.distribution.TensorLayout([None] * array.ndim, self.devices.device_mesh)
        return keras.distribution.distribute_tensor(array, layout)

    def _shared(self, batch):
        """Give each device its part of a batch, if they divide it."""
        if len(batch) % self.devices.device_mesh.devices.size:
            return self._on_all(batch)
        layout = self.devices.get_data_layout(batch.shape)
        return keras.distribution.distribute_tensor(batch, layout)

    def evaluate(self, part: str) -> float:
        """Loss over all samples of a part, in inference mode."""
        features, targets = self.arrays[part]
        total = 0.0
        for first in range(0, len(features), EVALUATION_BATCH):
            batch = (x[first : first + EVALUATION_BATCH] for x in (features, targets))
            x, y = batch
            total += float(self._evaluate(*self._state[:2], x, y)) * len(x)
        return total / len(features)

    @property
    def weights(self) -> list[np.ndarray]:
        """Copies of all values of the decoder, in the order of `all_variables`."""
        return [np.array(x) for group in self._state[:2] for x in group]

    @property
    def state(self) -> list[np.ndarray]:
        """Everything that the next epoch depends on; set it to continue from there."""
        return [np.asarray(x) for group in self._state for x in group]

    @state.setter
    def state(self, values) -> None:
        values = iter(values)
        self._state = [[self._on_all(next(values)) for _ in group] for group in self._state]


class KerasTrainer(_Trainer):
    """Trainer with `keras.Model.fit`, on any backend; see `make_trainer`.

    It is several times slower than the others on processor cores, and serves as their reference.
    """

    def __init__(self, decoder: keras.Model, learning_rate, batch_size: int, arrays: dict):
        super().__init__(decoder, batch_size, arrays)
        decoder.compile(keras.optimizers.Adam(learning_rate), "mse", jit_compile=False)
        decoder.optimizer.build(decoder.trainable_variables)

    def train_in_order(self, order: np.ndarray) -> float:
        """Train once on the samples in this order; returns the mean loss meanwhile."""
        features, targets = (x[order] for x in self.arrays["train"])
        options = {"batch_size": self.batch_size, "shuffle": False, "verbose": 0}
        return float(self.model.fit(features, targets, **options).history["loss"][0])

    def evaluate(self, part: str) -> float:
        """Loss over all samples of a part, in inference mode."""
        options = {"batch_size": EVALUATION_BATCH, "verbose": 0}
        return float(self.model.evaluate(*self.arrays[part], **options))

    @property
    def weights(self) -> list[np.ndarray]:
        """Copies of all values of the decoder, in the order of `all_variables`."""
        return [_copied(x) for x in all_variables(self.model)]

    @property
    def state(self) -> list[np.ndarray]:
        """Everything that the next epoch depends on; set it to continue from there."""
        return [_copied(x) for x in self._variables]

    @state.setter
    def state(self, values) -> None:
        for variable, value in zip(self._variables, values, strict=True):
            variable.assign(value)

    @property
    def _variables(self) -> list[keras.Variable]:
        return [*all_variables(self.model), *self.model.optimizer.variables]


def _batches(order: np.ndarray, size: int):
    return (order[first : first + size] for first in range(0, len(order), size))


def _copied(variable: keras.Variable) -> np.ndarray:
    return np.array(ops.convert_to_numpy(variable))
