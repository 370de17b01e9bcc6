"""The fast form of a training step has the results of Keras's own, and so has JAX."""

import json
import os
import subprocess
import sys

import keras
import numpy as np
import pytest

from lf_flame.learning.decoder import build_decoder
from lf_flame.learning.fast_steps import matrix_view
from lf_flame.learning.fitting import shuffled_batches
from lf_flame.learning.training import compile_for_training

FEATURES, IMAGE = (3, 6, 32), (9, 18)


@pytest.fixture
def decoder():
    return lambda: build_decoder(FEATURES, IMAGE, 4, seed=3)


def test_matrix_products_are_the_same_function_on_the_same_variables(decoder, rng):
    network = decoder()
    view = matrix_view(network)
    features = rng.normal(size=(4, *FEATURES)).astype(np.float32)
    np.testing.assert_allclose(np.array(view(features)), np.array(network(features)), atol=1e-6)
    assert [id(x) for x in view.variables] == [id(x) for x in network.variables]


@pytest.mark.slow
@pytest.mark.skipif(keras.backend.backend() != "tensorflow", reason="TensorFlow has the fast form")
def test_losses_and_weights_are_those_of_plain_fit(decoder, rng):
    """Two epochs with dropout, the last batch of each smaller."""
    features = rng.uniform(size=(9, *FEATURES)).astype(np.float32)
    targets = rng.uniform(size=(9, 4, *IMAGE, 1)).astype(np.float32)
    plain, fast = decoder(), decoder()
    start = plain.get_weights()
    plain.compile(keras.optimizers.Adam(1e-3), "mse", jit_compile=False)
    losses = []
    for network in (plain, compile_for_training(fast, 1e-3, 5)):
        batches = shuffled_batches(features, targets, 2, seed=1)
        history = network.fit(batches, epochs=2, steps_per_epoch=5, shuffle=False, verbose=0)
        losses.append(history.history["loss"])
    np.testing.assert_allclose(losses[1], losses[0], rtol=1e-5)
    moved = [np.abs(a - b).max() for a, b in zip(plain.get_weights(), start, strict=True)]
    assert np.count_nonzero(moved) >= len(moved) - 1
    for one, other in zip(fast.get_weights(), plain.get_weights(), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-4)


def losses_from(path):
    """Losses of two epochs without dropout, from the samples and weights in a file."""
    with np.load(path) as arrays:
        features, targets, *weights = arrays.values()
    network = build_decoder(FEATURES, IMAGE, 4, dropout=0.0)
    network.set_weights(weights)
    batches = shuffled_batches(features, targets, 2, seed=1)
    fit = compile_for_training(network, 1e-3, 5).fit
    return fit(batches, epochs=2, steps_per_epoch=5, shuffle=False, verbose=0).history["loss"]


@pytest.mark.slow
def test_jax_trains_as_tensorflow_does(decoder, rng, tmp_path):
    """In a process of its own, as KERAS_BACKEND is read once."""
    shapes, path = ((9, *FEATURES), (9, 4, *IMAGE, 1)), str(tmp_path / "arrays.npz")
    samples = [rng.uniform(size=shape).astype(np.float32) for shape in shapes]
    np.savez(path, *samples, *decoder().get_weights())
    code = f"import runpy; print(runpy.run_path({__file__!r})['losses_from']({path!r}))"
    by_jax = subprocess.run(
        [sys.executable, "-c", code], env=os.environ | {"KERAS_BACKEND": "jax"},
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    np.testing.assert_allclose(json.loads(by_jax.stdout), losses_from(path), rtol=1e-3)
