"""Records of runs are read through one description: what is missing or of another type is named."""

import json

import pytest
from builders import RUN

from lf_flame.learning.run_folders import load_run, open_run


@pytest.fixture
def write(tmp_path):
    def write(record):
        (tmp_path / "model.keras").write_bytes(b"PK\5\6" + bytes(18))  # an empty archive
        (tmp_path / "run.json").write_text(json.dumps(record))
        return tmp_path

    return write


def test_a_run_of_a_system_says_what_it_is_and_what_is_wanted(write):
    folder = write({"system": "refocusnet", "title": "RefocusNet", "epochs": 2, "train_s": 1.0})
    assert load_run(folder)["system"] == "refocusnet"


def test_the_data_set_of_a_run_behind_a_link_is_found(tmp_path, monkeypatch, write):
    """A scratch disk is linked."""
    (tmp_path / "scratch" / "disk" / "run").mkdir(parents=True)
    (tmp_path / "results").symlink_to("scratch/disk")
    (tmp_path / "flames.zarr").mkdir()
    for name in ("model.keras", "run.json"):
        (write(RUN) / name).rename(tmp_path / "results" / "run" / name)
    record = tmp_path / "results" / "run" / "run.json"
    record.write_text(json.dumps(RUN | {"data": "../../../flames.zarr"}))
    assert open_run(tmp_path / "results" / "run").data.samefile(tmp_path / "flames.zarr")
