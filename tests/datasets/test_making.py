"""The bytes of a data set follow from configuration and size, however it was made."""

import json
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
import zarr

from lf_flame import InputError, render
from lf_flame._common.config import to_json
from lf_flame.datasets import making
from lf_flame.datasets.making import LEAST_TOGETHER, make_dataset
from lf_flame.datasets.sampling import simulate_sample
from lf_flame.datasets.store import Dataset, split_indices
from lf_flame.refocus import shift_and_sum


@pytest.mark.slow
def test_a_data_set_has_the_samples_of_its_configuration(tiny, tmp_path):
    make_dataset(tiny, 2, tmp_path / "a.zarr")
    dataset = Dataset(tmp_path / "a.zarr")
    scene, parameters = tiny.template.draw(np.random.default_rng([tiny.seed, 1]))
    stack = shift_and_sum(render(scene, tiny.camera), dataset.attrs["slopes"])
    blocks = stack.reshape(2, 8, 3, 12, 3).mean(axis=(2, 4))
    np.testing.assert_allclose(dataset.targets[1], blocks, atol=1e-6)
    sample = simulate_sample(tiny, dataset.attrs["slopes"], 1)
    np.testing.assert_array_equal(dataset.inputs[1], sample["input"])
    np.testing.assert_array_equal(dataset.parameters("size_mm")[1], parameters["size_mm"])
    assert (len(dataset), dataset.config) == (2, tiny)
    assert set(dataset.attrs["provenance"]) >= {"command", "versions", "git_revision", "wall_s"}


@pytest.mark.slow
def test_samples_lie_in_shards_each_with_its_checksum(tiny, tmp_path):
    make_dataset(tiny, LEAST_TOGETHER + 3, tmp_path / "a.zarr")
    array = zarr.open_group(tmp_path / "a.zarr", mode="r")["target"]
    assert (array.shards[0], array.chunks[0]) == (LEAST_TOGETHER, 1)
    assert "crc32c" in json.dumps(array.metadata.to_dict()["codecs"], default=str)
    files = [path for path in (tmp_path / "a.zarr").rglob("c/*") if path.name.isdigit()]
    assert {path.name for path in files} == {"0", "1"}


@pytest.mark.slow
def test_bytes_do_not_depend_on_who_does_the_work(tiny, tmp_path, samples_of):
    """This process, others, or any executor: here threads, each with one thread of Numba's."""
    make_dataset(tiny, 40, tmp_path / "one.zarr")
    make_dataset(tiny, 40, tmp_path / "two.zarr", workers=2)
    with ThreadPoolExecutor(2) as executor:
        make_dataset(tiny, 40, tmp_path / "threads.zarr", executor=executor)
    one, two, threads = (samples_of(tmp_path / f"{x}.zarr") for x in ("one", "two", "threads"))
    assert one == two == threads
    made = Dataset(tmp_path / "threads.zarr").attrs["provenance"]
    assert made["workers"] == "ThreadPoolExecutor"


@pytest.mark.slow
def test_an_interrupted_run_resumes_to_the_same_bytes(tiny, tmp_path, samples_of, monkeypatch):
    asked = []

    def cut(tasks, *others):
        asked.append(len(tasks))
        yield from tasks[0]()
        if len(asked) == 1:
            raise KeyboardInterrupt

    monkeypatch.setattr(making, "carry_out", cut)
    with pytest.raises(KeyboardInterrupt):
        make_dataset(tiny, 20, tmp_path / "a.zarr")
    with pytest.raises(InputError, match="begun, but is not finished"):
        Dataset(tmp_path / "a.zarr")
    left = tmp_path / "a.zarr.part" / "input" / "c" / "0" / f"0.{'0' * 32}.partial"
    left.write_bytes(b"half")  # as Zarr leaves it of a write that was cut off
    more = {**tiny.samples, "large": 99}  # a further preset changes nothing
    make_dataset(replace(tiny, samples=more), 20, tmp_path / "a.zarr")
    assert asked == [2, 1]
    monkeypatch.undo()
    make_dataset(tiny, 20, tmp_path / "b.zarr")
    assert samples_of(tmp_path / "a.zarr") == samples_of(tmp_path / "b.zarr")


MAKE = """
import json, sys
from lf_flame.datasets.config import config_from_json
from lf_flame.datasets.making import make_dataset
if __name__ == "__main__":
    make_dataset(config_from_json(json.loads(sys.argv[1]), "here"), 96, sys.argv[2])
"""


@pytest.mark.slow
def test_a_killed_run_resumes_to_the_same_bytes(tiny, tmp_path, samples_of):
    (tmp_path / "make.py").write_text(MAKE)
    settings = json.dumps(to_json(tiny)), str(tmp_path / "a.zarr")
    made = tmp_path / "a.zarr.part" / "complete" / "c"
    command = [sys.executable, tmp_path / "make.py", *settings]
    with subprocess.Popen(command) as process:
        while len(list(made.glob("*"))) < 2:
            assert process.poll() is None
            time.sleep(0.02)
        process.kill()
    assert not (tmp_path / "a.zarr").exists()
    for name in ("a.zarr", "b.zarr"):
        make_dataset(tiny, 96, tmp_path / name)
    assert samples_of(tmp_path / "a.zarr") == samples_of(tmp_path / "b.zarr")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.zarr", "b.zarr", "make.py"]


@pytest.mark.slow
def test_a_run_that_was_cut_at_its_very_start_begins_again(tiny, tmp_path):
    left = tmp_path / f".a.zarr.part.{'0' * 16}.part"
    left.mkdir()
    (left / "zarr.json").write_text('{"zarr_format": 3, "node_type": "group", "attributes": {}}')
    make_dataset(tiny, 2, tmp_path / "a.zarr")
    assert [path.name for path in tmp_path.glob("*a.*")] == ["a.zarr"]


def test_what_is_in_the_way_is_left_alone(tiny, tmp_path):
    mine = tmp_path / "a.zarr.part" / "thesis.txt"
    mine.parent.mkdir()
    mine.write_text("mine")
    with pytest.raises(InputError, match="a.zarr.part is in the way"):
        make_dataset(tiny, 2, tmp_path / "a.zarr")
    (tmp_path / "b.zarr").symlink_to("nowhere")
    with pytest.raises(InputError, match="b.zarr exists; remove it"):
        make_dataset(tiny, 2, tmp_path / "b.zarr")
    assert mine.read_text() == "mine"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.zarr.part", "b.zarr"]


@pytest.mark.parametrize(
    ("n", "shares", "counts"),
    [
        (10, (0.7, 0.2, 0.1), (7, 2, 1)),
        (1000, (0.5, 0.2, 0.3), (500, 200, 300)),
        (7, (0.6, 0.2, 0.2), (4, 2, 1)),  # 4.2 and 5.6, rounded
    ],
)
def test_parts_have_their_shares_and_no_sample_is_in_two(n, shares, counts):
    parts = split_indices(n, shares, seed=3)
    assert tuple(parts) == ("train", "validation", "test")
    assert tuple(map(len, parts.values())) == counts
    np.testing.assert_array_equal(np.sort(np.concatenate([*parts.values()])), np.arange(n))
    for part in parts.values():
        assert np.all(np.diff(part) > 0)


def test_samples_are_drawn_by_the_seed():
    one, same, other = (split_indices(60, (0.5, 0.25, 0.25), seed)["train"] for seed in (1, 1, 2))
    np.testing.assert_array_equal(one, same)
    assert set(one) != set(other)
    assert set(one) != set(range(30))
