import os
import subprocess
import sys
from pathlib import Path

import keras
import numpy as np
import pytest

from lf_flame import InputError
from lf_flame.learning.decoder import build_decoder
from lf_flame.learning.trainers import all_variables, make_trainer

FEATURES, IMAGE = (3, 6, 32), (9, 18)


def decoder(**options):
    return build_decoder(FEATURES, IMAGE, 4, seed=3, **options)


@pytest.fixture
def samples(rng):
    features = rng.uniform(size=(9, *FEATURES)).astype(np.float32)
    targets = rng.uniform(size=(9, 4, *IMAGE, 1)).astype(np.float32)
    return {"train": (features, targets), "validation": (features[:5], targets[:5])}


def plain_losses(samples, rate, batch_size, options):
    """Losses of every batch of two epochs of Keras by itself, and the decoder."""
    plain, losses = decoder(**options), []
    plain.compile(keras.optimizers.Adam(rate), "mse", jit_compile=False)
    for _ in range(2):
        for k in range(0, 9, batch_size):
            plain.reset_metrics()
            batch = (x[k : k + batch_size] for x in samples["train"])
            losses.append(float(plain.train_on_batch(*batch)))
    return losses, plain


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "batch_size"),
    [
        pytest.param({}, 2, id="image-2"),
        pytest.param({"dropout_place": "vector"}, 9, id="vector-9"),
        pytest.param({"dropout": 0.0}, 2, id="none-2"),
        pytest.param({"neck": "positions"}, 9, id="positions-9"),
    ],
)
def test_training_is_that_of_keras(samples, batch_size, options):
    rate = keras.optimizers.schedules.CosineDecay(1e-4, 40)
    expected, plain = plain_losses(samples, rate, batch_size, options)
    trained = decoder(**options)
    trainer = make_trainer(trained, rate, batch_size, samples)
    starts = [*range(0, 9, batch_size)] * 2
    losses = [trainer.train_in_order(np.arange(k, min(k + batch_size, 9))) for k in starts]
    np.testing.assert_allclose(losses, expected, rtol=1e-4)
    assert trainer.evaluate("train") == pytest.approx(
        plain.evaluate(*samples["train"], verbose=0), rel=1e-4
    )
    for variable, value in zip(all_variables(trained), trainer.weights, strict=True):
        variable.assign(value)
    stacks = (np.array(x(samples["train"][0])) for x in (plain, trained))
    np.testing.assert_allclose(*stacks, atol=1e-4)


@pytest.mark.slow
def test_keras_s_own_training_has_the_losses_of_the_fast_form(samples):
    """Over epochs in one order, with dropout and normalisation; and it goes on from its state."""
    fast, plain, later = (
        make_trainer(decoder(), 1e-3, 2, samples, kind) for kind in ("fast", "keras", "keras")
    )
    order = np.random.default_rng(0).permutation(9)
    expected = [fast.train_in_order(order) for _ in range(3)]
    losses = [plain.train_in_order(order)]
    later.state = plain.state
    losses += [plain.train_in_order(order) for _ in range(2)]
    np.testing.assert_allclose(losses, expected, rtol=1e-5)
    assert losses[2] < losses[1] < losses[0]
    assert plain.evaluate("validation") == pytest.approx(fast.evaluate("validation"), rel=1e-4)
    for one, other in zip(plain.weights, fast.weights, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-4)
    assert [later.train_in_order(order) for _ in range(2)] == pytest.approx(losses[1:], rel=1e-6)


def test_an_epoch_is_its_batches(samples):
    """The mean loss weighs samples alike, in a last batch that is smaller too."""
    whole, parts = (make_trainer(decoder(), 1e-3, 4, samples) for _ in range(2))
    order = np.random.default_rng(0).permutation(9)
    losses = [parts.train_in_order(order[k : k + 4]) for k in (0, 4, 8)]
    assert whole.train_in_order(order) == pytest.approx(np.average(losses, weights=[4, 4, 1]))


def test_frozen_normalisations_stay(samples):
    frozen = decoder()
    for layer in frozen.layers:
        layer.trainable = not isinstance(layer, keras.layers.BatchNormalization)
    norms = [layer.get_weights() for layer in frozen.layers if not layer.trainable]
    trainer = make_trainer(frozen, 1e-2, 2, samples)
    trainer.train_in_order(np.arange(9))
    for variable, value in zip(all_variables(frozen), trainer.weights, strict=True):
        variable.assign(value)
    kept = [layer.get_weights() for layer in frozen.layers if not layer.trainable]
    assert norms
    for before, after in zip(norms, kept, strict=True):
        np.testing.assert_array_equal(np.array(after), np.array(before))


def test_a_state_goes_on_to_the_same_bits(samples):
    """And weights that were taken before stay as they were."""
    first = make_trainer(decoder(), 1e-3, 2, samples)
    before = first.weights
    kept = [x.copy() for x in before]
    first.train_in_order(np.arange(9))
    for now, then in zip(before, kept, strict=True):
        np.testing.assert_array_equal(now, then)
    assert not np.array_equal(first.weights[0], kept[0])
    state = [np.array(x) for x in first.state]
    expected = first.train_in_order(np.arange(9)[::-1])
    second = make_trainer(decoder(), 1e-3, 2, samples)
    second.state = state
    assert second.train_in_order(np.arange(9)[::-1]) == expected
    for ours, theirs in zip(second.weights, first.weights, strict=True):
        np.testing.assert_array_equal(ours, theirs)


@pytest.mark.slow
@pytest.mark.skipif(keras.backend.backend() == "jax", reason="these are the tests on JAX")
def test_the_same_on_jax():
    """The device trainer, on a processor here: Keras's losses, restart to the same bits."""
    tests = [
        "test_trainers.py::test_training_is_that_of_keras[image-2]",
        "test_trainers.py::test_training_is_that_of_keras[vector-9]",
        "test_trainers.py::test_an_epoch_is_its_batches",
        "test_trainers.py::test_a_state_goes_on_to_the_same_bits",
    ]
    here = Path(__file__).parent
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", *(str(here / name) for name in tests)],
        env={**os.environ, "KERAS_BACKEND": "jax"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout[-3000:]
    assert "4 passed" in done.stdout


@pytest.mark.skipif(
    keras.backend.backend() != "jax" or len(keras.distribution.list_devices()) != 8,
    reason="needs JAX with eight devices; the test below starts it",
)
def test_devices_share_a_batch(samples, monkeypatch):
    """With a last batch of 1 that eight do not divide."""
    devices = keras.distribution.list_devices()
    several = make_trainer(decoder(), 1e-3, 8, samples)
    monkeypatch.setattr(keras.distribution, "list_devices", lambda: devices[:1])
    alone = make_trainer(decoder(), 1e-3, 8, samples)
    order = np.random.default_rng(0).permutation(9)
    losses = [[one.train_in_order(order) for _ in range(3)] for one in (several, alone)]
    np.testing.assert_allclose(*losses, rtol=1e-5)
    assert losses[0][-1] < losses[0][0]
    part = several._shared(np.ones((8, 3), np.float32))
    assert [shard.data.shape for shard in part.addressable_shards] == [(1, 3)] * 8
    assert len(several._state[0][0].sharding.device_set) == 8
    monkeypatch.setattr(keras.distribution, "list_devices", lambda: devices)
    assert make_trainer(decoder(), 1e-3, 6, samples).devices.device_mesh.devices.size == 2


@pytest.mark.slow
@pytest.mark.skipif(keras.backend.backend() == "jax", reason="this is the test on JAX")
def test_eight_devices_have_the_losses_of_one():
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", f"{__file__}::test_devices_share_a_batch"],
        env={
            **os.environ,
            "KERAS_BACKEND": "jax",
            "XLA_FLAGS": "--xla_force_host_platform_device_count=8",
        },
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout[-3000:]
    assert "1 passed" in done.stdout


def test_another_backend_is_refused(monkeypatch, samples):
    monkeypatch.setattr(keras.backend, "backend", lambda: "torch")
    with pytest.raises(InputError, match="tensorflow and jax; KERAS_BACKEND is torch"):
        make_trainer(None, 1e-3, 2, samples)
