"""What a stored data set says of itself is looked at before Zarr sees it."""

import json
import re

import numpy as np
import pytest
from sentences import sentence_of

from lf_flame import InputError
from lf_flame._common.memory import LIMIT
from lf_flame.datasets.store import Dataset

ODD = [None, True, 0, -1, 1e300, 2**62, "", "x", "a" * 5000, [], {}, [[]], {"a": 1}, [1, 2], ["a"]]
ARRAYS = ("input", "target", "complete", "parameters/brightness")


def test_what_samples_need_is_known_before_they_are_read(path, monkeypatch):
    dataset = Dataset(path)
    assert dataset.targets.shape == (3, 1, 10, 16)
    monkeypatch.setenv(LIMIT, "1e-7")
    with pytest.raises(InputError, match="a.zarr/input would need"):
        _ = dataset.inputs


def read_all(path):
    dataset = Dataset(path)
    assert np.isfinite(dataset.inputs).all() and np.isfinite(dataset.targets).all()  # noqa: PT018
    dataset.parameters("brightness")


@pytest.mark.slow
def test_no_value_in_the_metadata_makes_a_traceback(path, rng):
    for _ in range(100):
        file = path / rng.choice(["", *ARRAYS]) / "zarr.json"
        before = file.read_text()
        found = inner = json.loads(before)
        while True:
            key = rng.choice(list(inner)) if isinstance(inner, dict) else rng.integers(len(inner))
            if not (isinstance(inner[key], dict | list) and inner[key]) or rng.random() < 0.3:
                break
            inner = inner[key]
        inner[key] = ODD[rng.integers(len(ODD))]
        file.write_text(json.dumps(found))
        told = sentence_of(read_all, path)
        assert not told or re.search("a.zarr", told)
        file.write_text(before)


@pytest.mark.slow
def test_no_damage_makes_a_traceback(path, rng):
    files = sorted(file for file in path.rglob("*") if file.is_file())
    refused = 0
    for trial in range(90):
        file = files[rng.integers(len(files))]
        before = file.read_bytes()
        content = bytearray(before)
        if trial % 3 == 0:
            content = content[: rng.integers(len(content))]
        else:
            content[rng.integers(len(content))] ^= 1 << rng.integers(8)
        file.write_bytes(content)
        told = sentence_of(read_all, path)
        refused += bool(told)
        assert "\n" not in told
        file.write_bytes(before)
    assert refused > 30
