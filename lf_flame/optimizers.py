"""Adam in one pass over memory."""

import keras
from keras import ops


class FusedAdam(keras.optimizers.Adam):
    """Keras's Adam, its update done by TensorFlow's fused kernel where that is the backend.

    Keras writes the update as ten element-wise operations; on a CPU each of them reads and writes
    all 27 million parameters. TensorFlow's ``ResourceApplyAdam`` evaluates the same formula
    (Kingma & Ba 2015, section 2, last paragraph) in one pass. Other backends fuse by themselves.
    """

    def update_step(self, gradient, variable, learning_rate):
        """Update one variable and its two moments."""
        if keras.backend.backend() != "tensorflow":
            super().update_step(gradient, variable, learning_rate)
            return
        import tensorflow as tf

        index = self._get_variable_index(variable)
        moments = self._momentums[index], self._velocities[index]
        step = ops.cast(self.iterations + 1, "float32")
        tf.raw_ops.ResourceApplyAdam(
            var=_handle(variable),
            m=_handle(moments[0]),
            v=_handle(moments[1]),
            beta1_power=ops.power(ops.cast(self.beta_1, "float32"), step),
            beta2_power=ops.power(ops.cast(self.beta_2, "float32"), step),
            lr=ops.cast(learning_rate, "float32"),
            beta1=self.beta_1,
            beta2=self.beta_2,
            epsilon=self.epsilon,
            grad=gradient,
        )


def _handle(variable):
    """Resource behind a Keras variable, or behind the TensorFlow variable it wraps."""
    return variable.value.handle if isinstance(variable, keras.Variable) else variable.handle
