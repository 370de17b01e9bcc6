"""Training in a folder: resumed as if it had never stopped, with the best weights."""

import json
from functools import partial

import keras
import numpy as np
import pandas as pd
import pytest

from lf_flame import InputError
from lf_flame.learning import fitting
from lf_flame.learning.fitting import RunFolder, assign_weights, shuffled_batches

RNG = np.random.default_rng(7)
INPUTS, TARGETS = (RNG.normal(size=(n, 4)).astype(np.float32) for n in (11, 7))
REQUEST = {"seed": 3}


def run_once(out, epochs, rate=1e-2, **options):
    """Train a dense network with dropout; the truth is a product with a fixed matrix."""
    network = keras.Sequential([
        keras.Input((4,)), keras.layers.Dropout(0.3, seed=1),
        keras.layers.Dense(3, kernel_initializer=keras.initializers.GlorotUniform(seed=2)),
    ])  # fmt: skip
    truth = np.arange(12, dtype=np.float32).reshape(4, 3) / 10
    run = RunFolder(out, REQUEST, epochs, 0.0, started=0.0, **options)
    with run.opened():
        if run.finished:
            return
        if run.epochs_missing:
            network.compile(keras.optimizers.Adam(rate), "mse", jit_compile=False)
            network.optimizer.build(network.trainable_variables)
            batches = shuffled_batches(INPUTS, INPUTS @ truth, 2, seed=3)
            run.fit(network, batches, (TARGETS, TARGETS @ truth))
        assign_weights(network, run.state.best)
        run.write(network, {})


def train(out, epochs, **options):
    run_once(out, epochs, **options)
    network = keras.saving.load_model(out / "model.keras", compile=False)
    return network.get_weights(), json.loads((out / "run.json").read_text())


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A run of five epochs that nothing stopped: folder, weights, record."""
    out = tmp_path_factory.mktemp("whole")
    return out, *train(out, 5)


@pytest.mark.slow
def test_a_run_stopped_three_times_ends_with_the_same_bits(whole, tmp_path, monkeypatch):
    """One epoch, then the time limit, then Ctrl-C in an epoch."""
    folder, weights, record = whole
    train(tmp_path, 1)
    _, stopped = train(tmp_path, 5, minutes=1e-9)
    assert (stopped["epochs"], stopped["finished"]) == (2, False)

    def interrupt(self, epoch, logs=None):
        if epoch == 3:
            raise KeyboardInterrupt
        return on_epoch_end(self, epoch, logs)

    on_epoch_end = fitting.EpochEnd.on_epoch_end
    monkeypatch.setattr(fitting.EpochEnd, "on_epoch_end", interrupt)
    with pytest.raises(KeyboardInterrupt):
        train(tmp_path, 5)
    monkeypatch.undo()
    left = tmp_path / ".checkpoint.npz.0123456789abcdef.part.npz"  # as a kill leaves one
    left.touch()
    ended, last = train(tmp_path, 5)
    assert not left.exists()
    for one, other in zip(ended, weights, strict=True):
        np.testing.assert_array_equal(one, other)
    columns = ["epoch", "loss", "val_loss", "val_psnr_db"]
    histories = [pd.read_csv(x / "history.csv")[columns] for x in (tmp_path, folder)]
    pd.testing.assert_frame_equal(*histories, check_exact=True)
    assert last["best_validation_loss"] == record["best_validation_loss"]


@pytest.mark.slow
def test_the_best_weights_are_kept(tmp_path):
    """At too high a rate, the loss rises again."""
    weights, record = train(tmp_path, 4, rate=3.0)
    history = pd.read_csv(tmp_path / "history.csv")
    best = history.val_loss.idxmin()
    assert best < 3, history
    assert record["best_epoch"] == best + 1
    truth = np.arange(12, dtype=np.float32).reshape(4, 3) / 10
    loss = np.mean((TARGETS @ weights[0] + weights[1] - TARGETS @ truth) ** 2)
    assert loss == pytest.approx(history.val_loss.min(), rel=1e-4)


def test_an_epoch_has_every_sample_once_in_the_order_of_seed_and_epoch():
    """Six steps an epoch; the second series resumes after the first epoch."""
    batches = [shuffled_batches(INPUTS, np.arange(11), 2, seed) for seed in (3, 3, 4)]
    batches[1].epochs_done = 1
    orders = []
    for one, first in zip((*batches, batches[0]), (6, 0, 6, 12), strict=True):
        orders.append(np.concatenate([one[first + k][1] for k in range(6)]))
        assert sorted(orders[-1]) == list(range(11))
        np.testing.assert_array_equal(one[first + 5][0], INPUTS[one[first + 5][1]])
    np.testing.assert_array_equal(orders[0], orders[1])
    assert list(orders[0]) != list(orders[2])
    assert list(orders[0]) != list(orders[3])


@pytest.mark.slow
@pytest.mark.parametrize(("minutes", "epochs"), [(2.4, 2), (2.6, 3)])
def test_a_limit_ends_at_the_nearest_end_of_an_epoch(tmp_path, monkeypatch, minutes, epochs):
    """Epochs of a minute each, by a clock of their own."""
    clock, end = [0.0], fitting.EpochEnd.on_epoch_end

    def a_minute_later(self, *args):
        clock[0] += 60.0
        end(self, *args)

    monkeypatch.setattr(fitting.EpochEnd, "on_epoch_end", a_minute_later)
    monkeypatch.setattr(fitting.time, "perf_counter", lambda: clock[0])
    run_once(tmp_path, 6, minutes=minutes)
    assert json.loads((tmp_path / "run.json").read_text())["epochs"] == epochs


def change_checkpoint(out, change):
    with np.load(out / "checkpoint.npz") as old:
        arrays = dict(old)
    change(arrays)
    np.savez(out / "checkpoint.npz", **arrays)


def set_about(text):
    return lambda arrays: arrays.update(about=np.frombuffer(text, np.uint8))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda out: (out / "checkpoint.npz").write_bytes(b"PK\3\4 and nothing"), "NumPy file"),
        (partial(change_checkpoint, change=set_about(b"{")), "is not a JSON file"),
        (partial(change_checkpoint, change=lambda x: x.pop("state_000")), "of another network"),
        (lambda out: (out / "config.json").unlink(), "a checkpoint.npz of no run"),
        (lambda out: (out / "config.json").write_text('{"seed": 4}'), r"another seed \(4, now 3\)"),
        (lambda out: (out / "config.json").write_text('{"mine": 4}'), "a config.json of no run"),
    ],
)
def test_a_damaged_or_other_run_is_refused(whole, tmp_path, spoil, said):
    for name in ("checkpoint.npz", "config.json"):
        (tmp_path / name).write_bytes((whole[0] / name).read_bytes())
    spoil(tmp_path)
    with pytest.raises(InputError, match=said) as caught:
        run_once(tmp_path, 6)
    assert "\n" not in str(caught.value)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"rate": 1e38}, "Epoch 1 has no finite loss"),
        ({"minutes": -1.0}, "minutes must be 0"),
        ({"minutes": np.nan}, "minutes must be 0"),
    ],
)
def test_a_run_that_cannot_be_is_refused(tmp_path, options, said):
    with pytest.raises(InputError, match=said):
        run_once(tmp_path / "run", 2, **options)


@pytest.mark.slow
def test_a_finished_run_stays_and_a_missing_network_is_written_again(whole, tmp_path):
    for file in whole[0].iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    model = tmp_path / "model.keras"
    before = model.stat().st_ino
    train(tmp_path, 5)
    assert model.stat().st_ino == before
    with pytest.raises(InputError, match="contains 5 epochs .* from which 3 epochs cannot"):
        train(tmp_path, 3)
    model.unlink()
    weights, _ = train(tmp_path, 5)
    for one, other in zip(weights, whole[1], strict=True):
        np.testing.assert_array_equal(one, other)
