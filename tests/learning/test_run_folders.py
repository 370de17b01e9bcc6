"""Records of runs are read through one description: what is missing or of another type is named."""

import json

import pytest
from builders import shapes

from lf_flame import InputError
from lf_flame.learning.model_card import read_card
from lf_flame.learning.run_folders import load_run, open_run

DATA = shapes(12, views=3, sides_mm=(9.0, 9.0))

RECORD = {
    "title": "Test", "preset": "smoke", "seed": 1, "epochs": 2, "best_epoch": 1,
    "recipe": {"batch_size": 2},
    "train_s": 3.5, "machine": "a machine", "backbone_weights": "random", "model": {},
    "split": [0.5, 0.25, 0.25], "parts": {"train": 6, "validation": 3, "test": 3},
    "test_indices": [1, 4, 7], "data": "../a.zarr",
    "dataset": {"config": DATA, "slopes": [1.0, -1.0], "objects": ["square", "circle"]},
}  # fmt: skip


@pytest.fixture
def write(tmp_path):
    def write(record):
        (tmp_path / "model.keras").write_bytes(b"PK\5\6" + bytes(18))  # an empty archive
        (tmp_path / "run.json").write_text(json.dumps(record))
        return tmp_path

    return write


def test_a_whole_record_is_taken(write):
    run = open_run(write(RECORD))
    assert (run.slopes, run.objects) == ([1.0, -1.0], ["square", "circle"])
    assert run.record == RECORD
    assert read_card(run.folder).image == (40, 64)


@pytest.mark.parametrize("name", sorted(set(RECORD) - {"dataset", "data"}))
def test_what_is_missing_or_of_another_type_is_named(write, name):
    left = {key: value for key, value in RECORD.items() if key != name}
    with pytest.raises(InputError, match=rf"run\.json: {name} is missing"):
        open_run(write(left))
    for odd in ([[1]], [{"a": {}}], None):
        with pytest.raises(InputError, match=rf"run\.json: {name}\b"):
            open_run(write(RECORD | {name: odd}))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"test_indices": []}, "test_indices must be samples"),
        ({"test_indices": [-1]}, "test_indices must be samples"),
        ({"recipe": {"epochs": 2}}, "recipe.batch_size is missing"),
        ({"parts": {}}, "parts hold train and test"),
        ({"split": [0.5, 1e308, 0.1]}, "split must be three shares"),
        ({"dataset": RECORD["dataset"] | {"slopes": [1.0]}}, "as many as the depths"),
        ({"dataset": RECORD["dataset"] | {"config": {}}}, "run.json: dataset: "),
        ({"dataset": RECORD["dataset"] | {"config": 3}}, "dataset.config: "),
        ({"dataset": 3}, "run.json: dataset: "),
        ({"train_s": "3.5"}, "train_s: input should be a valid number, got '3.5'"),
        ({"system": 3}, "system: input should be a valid string"),
    ],
)
def test_what_does_not_go_together_is_named(write, change, words):
    with pytest.raises(InputError, match=words):
        open_run(write(RECORD | change))


def test_a_run_of_a_system_says_what_it_is_and_what_is_wanted(write):
    folder = write({"system": "refocusnet", "title": "RefocusNet", "train_s": 1.0})
    assert load_run(folder)["system"] == "refocusnet"
    words = "holds a run of the system refocusnet; it must hold one of the paper's network, by `lf"
    with pytest.raises(InputError, match=words):
        open_run(folder)


def test_a_network_that_is_a_link_to_a_device_is_refused_at_once(write):
    folder = write(RECORD)
    (folder / "model.keras").unlink()
    (folder / "model.keras").symlink_to("/dev/zero")
    with pytest.raises(InputError, match="must be a regular file, and is a device"):
        open_run(folder).load_network()


def test_the_data_set_of_a_run_behind_a_link_is_found(tmp_path, monkeypatch, write):
    """A scratch disk is linked."""
    (tmp_path / "scratch" / "disk" / "run").mkdir(parents=True)
    (tmp_path / "results").symlink_to("scratch/disk")
    (tmp_path / "flames.zarr").mkdir()
    for name in ("model.keras", "run.json"):
        (write(RECORD) / name).rename(tmp_path / "results" / "run" / name)
    record = tmp_path / "results" / "run" / "run.json"
    record.write_text(json.dumps(RECORD | {"data": "../../../flames.zarr"}))
    assert open_run(tmp_path / "results" / "run").data.samefile(tmp_path / "flames.zarr")
