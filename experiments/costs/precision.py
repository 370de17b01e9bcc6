"""A network in fewer bits than float32, and how a backend compiles it."""

import keras

REFERENCE = "float32"

PRECISIONS = (REFERENCE, "bfloat16", "float16", "int8")
"""Precisions of Keras; in int8 it has dense layers, but no convolutions."""


def in_precision(network: keras.Model, precision: str) -> keras.Model:
    """Make the same network compute, and keep its weights, in another precision.

    "int8" are the dense layers alone: weights by channel, inputs by sample, as they come
    (`keras.Model.quantize`). In the others every layer computes in that type, and keeps its weights
    in it; but normalisations keep theirs in float32, because variances of ImageNet's features
    exceed 65,504, the largest number of float16. float32 is the network itself. A ValueError says
    that the network has no layer that Keras can quantise.
    """
    if precision == REFERENCE:
        return network

    def copied(layer):
        config = layer.get_config()
        if precision != "int8":
            mixed = isinstance(layer, keras.layers.BatchNormalization)
            config["dtype"] = f"mixed_{precision}" if mixed else precision
        return type(layer).from_config(config)

    clone = keras.models.clone_model(network, clone_function=copied, recursive=True)
    clone.set_weights(network.get_weights())
    if precision == "int8":
        clone.quantize("int8", filters=lambda layer: isinstance(layer, keras.layers.Dense))
        if not quantised_layers(clone):
            raise ValueError("It has no dense layer, and Keras quantises no other.")
    return clone


def quantised_layers(network: keras.Model) -> list[str]:
    """Name the layers that compute in int8, in their order."""
    parts = [layer for part in network.layers for layer in getattr(part, "layers", [part])]
    return [layer.name for layer in parts if getattr(layer, "quantization_mode", None)]


def weight_bytes(network: keras.Model) -> int:
    """Count the bytes of all weights in memory."""
    return sum(keras.ops.convert_to_numpy(x).nbytes for x in network.weights)


def compilers() -> dict[str, bool]:
    """Name the compilers that the backend has, with Keras's `jit_compile` for each."""
    if keras.backend.backend() == "tensorflow":
        return {"TensorFlow": False, "XLA": True}
    return {"XLA": True}


def compiled(model: keras.Model, xla: bool) -> keras.Model:
    """Give the same layers and weights in a model that is compiled apart, by XLA or without."""
    twin = keras.Model(model.inputs, model.outputs)
    twin.compile(jit_compile=xla)
    return twin


def describe(network: keras.Model, precision: str) -> str:
    """Say what computes in which type."""
    if precision == "int8":
        return f"dense layers alone ({', '.join(quantised_layers(network))}), all else {REFERENCE}"
    if precision == REFERENCE:
        return "all layers"
    return f"all layers; statistics of normalisations kept in {REFERENCE}"
