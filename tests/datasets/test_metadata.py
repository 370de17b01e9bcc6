"""What a stored data set says of itself is looked at before Zarr sees it."""

import json
import os
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from sentences import sentence_of

from lf_flame import InputError
from lf_flame._common.memory import LIMIT
from lf_flame.datasets.config import read_config
from lf_flame.datasets.making import make_dataset
from lf_flame.datasets.store import Dataset

SCENES = """
kind = "shapes"
seed = 3
image = [4, 6]
samples = { smoke = 3 }
[camera]
main_lens_focal_mm = 150.0
focus_distance_mm = 326.0
lenslet_focal_mm = 2.0
lenslet_pitch_mm = 0.56
views = 3
lenslets = [12, 18]
[template]
position_mm = 0.4
size = 0.08
brightness = [0.85, 1.0]
[[template.objects]]
shape = "square"
depth_mm = 10.0
size_mm = [3.0, 3.0]
centre_mm = [0.0, 0.0]
"""

ODD = [None, True, 0, -1, 1e300, 2**62, "", "x", "a" * 5000, [], {}, [[]], {"a": 1}, [1, 2], ["a"]]
ARRAYS = ("input", "target", "complete", "parameters/brightness")


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    folder = tmp_path_factory.mktemp("data")
    (folder / "a.toml").write_text(SCENES)
    make_dataset(read_config(folder / "a.toml"), 3, folder / "a.zarr")
    return folder / "a.zarr"


@pytest.fixture
def path(whole, tmp_path):
    return Path(shutil.copytree(whole, tmp_path / "a.zarr"))


def change(path, keys, value):
    """Put a value into a JSON file, under some keys within each other."""
    found = inner = json.loads(path.read_text())
    for key in keys[:-1]:
        inner = inner[key]
    inner[keys[-1]] = value
    path.write_text(json.dumps(found))


@pytest.mark.parametrize(
    ("name", "keys", "value", "words"),
    [
        ("", ["attributes", "config"], 3, "a.zarr/zarr.json: config: "),
        ("", ["attributes", "config", "kind"], ["shapes"], "kind: "),
        ("", ["attributes", "config", "template"], [], "template: "),
        ("", ["attributes", "slopes"], ["1.0"], "slopes #1: input should be a valid number"),
        ("", ["attributes", "slopes"], [1.0, 2.0], "slopes or objects are not as many as depths"),
        ("", ["attributes"], {}, "does not say what of"),
        ("", ["node_type"], "array", "a.zarr/zarr.json is damaged, or not that of a group"),
        ("input", ["shape"], [3, 4, 7, 1], "chunks of whole samples, up to 4096 together"),
        ("target", ["data_type"], "object", "target/zarr.json is damaged"),
        ("target", ["codecs"], [{"name": "pickle"}], "target/zarr.json is damaged"),
        ("complete", ["shape"], [10**15], "must have as many samples, up to 1000000, got 3, 1000"),
        ("complete", ["chunk_grid"], "all", "complete/zarr.json is damaged"),
        ("complete", ["fill_value"], [1], "complete/zarr.json is damaged"),
    ],
)
def test_metadata_that_are_not_ours_are_named(path, name, keys, value, words):
    change(path / name / "zarr.json", keys, value)
    with pytest.raises(InputError, match=words):
        Dataset(path)


def test_an_array_of_another_shape_is_refused(path):
    change(path / "target" / "zarr.json", ["shape"], [3, 2, 4, 6])
    change(
        path / "target" / "zarr.json", ["chunk_grid", "configuration", "chunk_shape"], [16, 2, 4, 6]
    )
    with pytest.raises(
        InputError, match=r"target is damaged: a sample must have the shape \(1, 4, 6"
    ):
        Dataset(path)


def test_what_samples_need_is_known_before_they_are_read(path, monkeypatch):
    dataset = Dataset(path)
    assert dataset.targets.shape == (3, 1, 4, 6)
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


def test_a_part_that_is_damaged_is_named(path, whole, tmp_path):
    path.rename(tmp_path / "b.zarr.part")
    change(tmp_path / "b.zarr.part" / "input" / "zarr.json", ["codecs"], [])
    (tmp_path / "b.zarr.part" / "complete" / "zarr.json").unlink()
    with pytest.raises(InputError, match=r"complete/zarr\.json cannot be read: there is no such"):
        make_dataset(read_config(whole.parent / "a.toml"), 3, tmp_path / "b.zarr")


@pytest.mark.parametrize("name", ["complete/c/0", "parameters/brightness/c/0/0"])
def test_a_device_or_a_pipe_in_place_of_a_chunk_is_not_read(path, name):
    for kind in ("a device", "a pipe"):
        (path / name).unlink()
        if kind == "a device":
            (path / name).symlink_to("/dev/zero")
        else:
            os.mkfifo(path / name)
        with pytest.raises(InputError, match=f"{name} cannot be read: .* is {kind}"):
            Dataset(path)
