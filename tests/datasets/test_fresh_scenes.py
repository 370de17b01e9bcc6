"""Scenes beyond a data set's end."""

from contextlib import contextmanager

import numpy as np
import pytest
from builders import DATA

from lf_flame.datasets import fresh_scenes
from lf_flame.datasets.config import config_from_json
from lf_flame.datasets.fresh_scenes import AHEAD, TOGETHER, fresh_samples
from lf_flame.datasets.making import make_dataset
from lf_flame.datasets.store import Dataset


@pytest.fixture(scope="module", params=["direct", "exact", "rays"])
def some_and_all(request, tmp_path_factory):
    """A data set of three samples, and one of the same scenes that goes on to eight."""
    folder = tmp_path_factory.mktemp("data")
    config = config_from_json({**DATA, "route": request.param}, "here")
    for count in (3, 8):
        path = folder / f"{count}.zarr"
        make_dataset(config, count, path)
    return Dataset(folder / "3.zarr"), Dataset(folder / "8.zarr")


@pytest.mark.slow
def test_they_are_what_a_longer_data_set_would_hold(some_and_all, monkeypatch):
    """Two processes, which take seconds to start, make those that take longest."""
    some, whole = some_and_all
    workers = 2 if some.config.route == "rays" else 1
    monkeypatch.setattr(fresh_scenes, "TOGETHER", 2)
    blocks = list(fresh_samples(some, 5, workers))
    assert [len(inputs) for inputs, _ in blocks] == [2, 2, 1]
    inputs, targets = (np.concatenate(x) for x in zip(*blocks, strict=True))
    np.testing.assert_array_equal(inputs, whole.inputs[3:])
    np.testing.assert_array_equal(targets, whole.targets[3:])


@pytest.mark.slow
def test_workers_wait_for_who_needs_the_blocks(some_and_all, monkeypatch):
    """However many are asked for, few are made before they are wanted."""
    made = []

    class Job:
        def __init__(self, *ask):
            made.append(ask)

        def result(self):
            return None

    class Pool:
        submit = Job

    @contextmanager
    def worker_pool(workers):
        yield Pool()

    monkeypatch.setattr(fresh_scenes, "worker_pool", worker_pool)
    blocks = fresh_samples(some_and_all[0], 100 * TOGETHER, workers=3)
    for wanted in range(1, 6):
        next(blocks)
        assert wanted <= len(made) <= wanted + 3 * AHEAD


def test_none_are_none(some_and_all):
    assert list(fresh_samples(some_and_all[0], 0)) == []
