"""Scenes beyond a data set's end."""

import numpy as np
import pytest

from lf_flame.datasets import fresh_scenes
from lf_flame.datasets.config import config_from_json
from lf_flame.datasets.fresh_scenes import fresh_samples
from lf_flame.datasets.making import make_dataset
from lf_flame.datasets.store import Dataset
from lf_flame.errors import InputError
from tests.tiny_data import DATA


@pytest.fixture(scope="module", params=[False, True], ids=["straight", "through light fields"])
def some_and_all(request, tmp_path_factory):
    """A data set of three samples, and one of the same scenes that goes on to eight."""
    folder, config = tmp_path_factory.mktemp("data"), config_from_json(DATA, "here")
    for count in (3, 8):
        path = folder / f"{count}.zarr"
        make_dataset(config, count, path, through_light_field=request.param)
    return Dataset(folder / "3.zarr"), Dataset(folder / "8.zarr")


@pytest.mark.parametrize("workers", [1, 2])
def test_they_are_what_a_longer_data_set_would_hold(some_and_all, workers, monkeypatch):
    some, whole = some_and_all
    monkeypatch.setattr(fresh_scenes, "TOGETHER", 2)
    seen = []
    inputs, targets = fresh_samples(some, 5, workers, lambda x, total: seen.append(total) or x)
    np.testing.assert_array_equal(inputs, whole.inputs[3:])
    np.testing.assert_array_equal(targets, whole.targets[3:])
    assert seen == [3]


def test_what_memory_does_not_hold_is_refused_beforehand(some_and_all, monkeypatch):
    monkeypatch.setenv("LF_FLAME_MEMORY_GB", "0.001")
    with pytest.raises(InputError, match="1000 scenes besides those of .* would need .* 0.001 GB"):
        fresh_samples(some_and_all[0], 1000)
