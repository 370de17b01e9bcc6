import os
import subprocess
import sys

import keras
import numpy as np
import pytest

from lf_flame.learning.decoder import build_decoder
from lf_flame.learning.device_training import _product
from lf_flame.learning.trainers import all_variables, make_trainer

FEATURES, IMAGE = (3, 6, 32), (9, 18)


def decoder(**options):
    return build_decoder(FEATURES, IMAGE, 4, seed=3, **options)


@pytest.fixture
def samples(rng):
    features = rng.uniform(size=(9, *FEATURES)).astype(np.float32)
    targets = rng.uniform(size=(9, 4, *IMAGE, 1)).astype(np.float32)
    return {"train": (features, targets), "validation": (features[:5], targets[:5])}


@pytest.mark.slow
def test_training_is_that_of_keras(samples):
    """Losses of all batches of two epochs, the last one smaller, at a rate that falls."""
    rate = keras.optimizers.schedules.CosineDecay(1e-4, 40)
    plain, trained, expected = decoder(), decoder(), []
    plain.compile(keras.optimizers.Adam(rate), "mse", jit_compile=keras.backend.backend() == "jax")
    trainer = make_trainer(trained, rate, 8, samples)
    batches = [np.arange(8), np.arange(8, 9)] * 2
    for batch in batches:
        plain.reset_metrics()
        expected.append(float(plain.train_on_batch(*(x[batch] for x in samples["train"]))))
    losses = [trainer.train_in_order(batch) for batch in batches]
    np.testing.assert_allclose(losses, expected, rtol=1e-4)
    for variable, value in zip(all_variables(trained), trainer.weights, strict=True):
        variable.assign(value)
    features, targets = samples["train"]
    stacks = [np.array(x(features)) for x in (plain, trained)]
    np.testing.assert_allclose(*stacks, atol=1e-4)
    mean_squared = ((stacks[0] - targets) ** 2).mean()
    assert trainer.evaluate("train") == pytest.approx(mean_squared, rel=1e-4)


@pytest.mark.slow
def test_keras_s_own_training_has_the_losses_of_the_fast_form(samples):
    """Over epochs in one order, with the other neck and dropout; and it goes on from its state."""
    options = {"neck": "positions", "dropout_place": "vector"}
    fast, plain = (
        make_trainer(decoder(**options), 1e-3, 9, samples, kind) for kind in ("fast", "keras")
    )
    order = np.random.default_rng(0).permutation(9)
    expected = [fast.train_in_order(order) for _ in range(3)]
    losses = [plain.train_in_order(order)]
    state = plain.state
    losses += [plain.train_in_order(order) for _ in range(2)]
    np.testing.assert_allclose(losses, expected, rtol=1e-5)
    assert losses[2] < losses[1] < losses[0]
    assert plain.evaluate("validation") == pytest.approx(fast.evaluate("validation"), rel=1e-4)
    for one, other in zip(plain.weights, fast.weights, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-4)
    plain.state = state
    assert [plain.train_in_order(order) for _ in range(2)] == pytest.approx(losses[1:], rel=1e-6)


@pytest.mark.slow
def test_an_epoch_is_its_batches_and_goes_on_to_the_same_bits(samples):
    """The mean loss weighs samples alike; weights that were taken before stay as they were."""
    trainer = make_trainer(decoder(), 1e-3, 3, samples)
    start, before = [np.array(x) for x in trainer.state], trainer.weights
    kept = [x.copy() for x in before]
    order = np.random.default_rng(0).integers(9, size=7)
    losses = [trainer.train_in_order(batch) for batch in np.split(order, (3, 6))]
    by_batches = trainer.weights
    trainer.state = start
    assert trainer.train_in_order(order) == pytest.approx(np.average(losses, weights=[3, 3, 1]))
    for one, other in zip(by_batches, trainer.weights, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-5)
    for now, then in zip(before, kept, strict=True):
        np.testing.assert_array_equal(now, then)
    assert not np.array_equal(trainer.weights[0], kept[0])
    state = [np.array(x) for x in trainer.state]
    expected, last = trainer.train_in_order(order[::-1]), trainer.weights
    trainer.state = state
    assert trainer.train_in_order(order[::-1]) == expected
    for one, other in zip(trainer.weights, last, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.slow
def test_frozen_normalisations_stay(samples):
    frozen = decoder()
    for layer in frozen.layers:
        layer.trainable = not isinstance(layer, keras.layers.BatchNormalization)
    norms = [layer.get_weights() for layer in frozen.layers if not layer.trainable]
    trainer = make_trainer(frozen, 1e-2, 9, samples)
    trainer.train_in_order(np.arange(9))
    for variable, value in zip(all_variables(frozen), trainer.weights, strict=True):
        variable.assign(value)
    kept = [layer.get_weights() for layer in frozen.layers if not layer.trainable]
    assert norms
    for before, after in zip(norms, kept, strict=True):
        np.testing.assert_array_equal(np.array(after), np.array(before))


@pytest.mark.parametrize("count", [1, 8, 9])
def test_a_gradient_as_outer_products_is_the_matrix_product(rng, count):
    vectors, back = rng.normal(size=(count, 5)), rng.normal(size=(count, 7))
    np.testing.assert_allclose(_product(vectors, back), np.einsum("ni,nj->ij", vectors, back))


@pytest.mark.skipif(
    keras.backend.backend() != "jax" or len(keras.distribution.list_devices()) != 8,
    reason="needs JAX with eight devices; the test below starts it",
)
def test_devices_share_a_batch(samples, caplog):
    several = make_trainer(decoder(), 1e-3, 8, samples)
    part = several._shared(np.ones((8, 3), np.float32))
    assert [shard.data.shape for shard in part.addressable_shards] == [(1, 3)] * 8
    assert len(several._state[0][0].sharding.device_set) == 8
    assert not caplog.messages
    assert make_trainer(decoder(), 1e-3, 6, samples).devices.device_mesh.devices.size == 2
    assert "on 2 of 8 devices" in caplog.text


@pytest.mark.slow
@pytest.mark.skipif(keras.backend.backend() == "jax", reason="this is the test on JAX")
def test_the_same_on_jax():
    """The device trainer, on a processor here: eight devices in the first test, one in the next."""
    tests = [
        "test_training_is_that_of_keras",
        "test_an_epoch_is_its_batches_and_goes_on_to_the_same_bits",
        "test_devices_share_a_batch",
    ]
    # Compiling takes nearly all of the time; what is compiled runs for a moment.
    flags = "--xla_force_host_platform_device_count=8 --xla_backend_optimization_level=0"
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", *(f"{__file__}::{name}" for name in tests)],
        env={**os.environ, "KERAS_BACKEND": "jax", "XLA_FLAGS": flags},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout[-3000:]
    assert "3 passed" in done.stdout
