"""Ctrl-C, or the end of the minutes: what is done is saved, the next call goes on from there."""

import os
import re
import signal
import time

import numpy as np
import pytest

from lf_flame._common import progress
from lf_flame.learning.checkpoints import load_checkpoint
from lf_flame.learning.training_run import Job, _fit

REQUEST = {"recipe": {"epochs": 12, "schedule": "constant"}}


class RandomWalk:
    """A trainer whose loss is a random walk, interrupted in the middle of some epochs."""

    def __init__(self, interrupts=()):
        self.state, self.epochs, self.interrupts = [np.ones(1)], 0, list(interrupts)

    @property
    def weights(self):
        return [x.copy() for x in self.state]

    def evaluate(self, part):
        return float(np.exp(self.state[0][0] / 10))

    def train_epoch(self, rng):
        self.epochs += 1
        self.state[0] = self.state[0] + rng.normal()
        for _ in range(self.interrupts.count(self.epochs)):
            os.kill(os.getpid(), signal.SIGINT)
        self.state[0] = self.state[0] + rng.normal()
        return self.evaluate("train")


def train(out, trainer, minutes=0.0):
    run = load_checkpoint(out, {"recipe": {"schedule": "constant"}})
    if run.state:
        trainer.state = run.state
    job = Job(REQUEST, 12, 3, 1e9, None, None, {}, minutes)  # no checkpoint by the clock
    _fit(run, trainer, job, out, 0.0)
    return [row["val_loss"] for row in run.history]


@pytest.fixture
def shown(capsys):
    """What is shown to the user of a program."""
    progress.show()
    yield capsys
    progress.show(False)


def test_an_interrupted_epoch_is_finished_and_saved(tmp_path, shown):
    whole = train(tmp_path / "whole", RandomWalk())
    before, interrupted = signal.getsignal(signal.SIGINT), RandomWalk([10])
    with pytest.raises(KeyboardInterrupt):
        train(tmp_path / "cut", interrupted)
    assert signal.getsignal(signal.SIGINT) is before
    assert interrupted.epochs == 10
    said = shown.readouterr()
    assert "Saved behind epoch 10 of 12" in said.out + said.err
    rest = RandomWalk()
    assert train(tmp_path / "cut", rest) == whole
    assert rest.epochs == 2


def test_the_time_left_is_that_of_epochs_of_this_call(tmp_path, shown):
    class Slow(RandomWalk):
        def train_epoch(self, rng):
            time.sleep(0.1)
            return super().train_epoch(rng)

    with pytest.raises(KeyboardInterrupt):
        train(tmp_path, RandomWalk([10]))
    train(tmp_path, Slow())
    last = shown.readouterr().err.splitlines()[-1]
    assert "12/12" in last
    assert float(re.search(r"([\d.]+)epoch/s", last)[1]) <= 10


def test_a_second_interrupt_is_not_waited_for(tmp_path):
    trainer = RandomWalk([4, 4])
    with pytest.raises(KeyboardInterrupt):
        train(tmp_path, trainer)
    assert trainer.epochs == 4
    assert not list(tmp_path.glob("checkpoint-*"))


@pytest.mark.parametrize(("minutes", "epochs"), [(2.4, 2), (2.6, 3)])
def test_minutes_end_a_call_at_the_nearest_end_of_an_epoch(tmp_path, monkeypatch, minutes, epochs):
    """Epochs of a minute each, by a clock of their own."""

    class Timed(RandomWalk):
        def train_epoch(self, rng):
            clock[0] += 60.0
            return super().train_epoch(rng)

    clock = [0.0]
    monkeypatch.setattr("lf_flame.learning.training_run.time.perf_counter", lambda: clock[0])
    some = Timed()
    train(tmp_path, some, minutes)
    assert some.epochs == epochs


def test_minutes_end_a_call_behind_its_epoch_and_the_next_goes_on(tmp_path):
    """The clock has run since time 0: any minutes are over at once, but an epoch is always done."""
    whole = train(tmp_path / "whole", RandomWalk())
    for calls in range(1, 13):
        some = RandomWalk()
        history = train(tmp_path / "cut", some, minutes=1e-9)
        assert some.epochs == 1
        assert history == whole[: calls + 1]
    assert train(tmp_path / "cut", RandomWalk(), minutes=1e-9) == whole
