"""A file is known by its SHA-256, and a device has none."""

import json
import os
from dataclasses import asdict, dataclass

import pytest

from lf_flame import PAPER_CAMERA
from lf_flame._common.checksums import file_sha256, sealed
from lf_flame._common.config import load_record
from lf_flame.errors import InputError
from lf_flame.scenes import read_camera


def test_the_hash_is_that_of_the_standard(tmp_path):
    """FIPS 180-4's own example."""
    (tmp_path / "a").write_bytes(b"abc")
    expected = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    assert file_sha256(tmp_path / "a") == expected


def test_what_has_no_end_is_refused(tmp_path):
    (tmp_path / "a").symlink_to("/dev/zero")
    os.mkfifo(tmp_path / "b")
    for name, kind in (("a", "a device"), ("b", "a pipe")):
        with pytest.raises(InputError, match=f"{name} cannot be read: .* is {kind}"):
            file_sha256(tmp_path / name)


@dataclass
class Grid:
    cell_mm: float


def test_a_record_is_read_only_as_it_was_written(tmp_path):
    """A digit that changed gives other numbers, and nothing else would tell."""
    path = tmp_path / "record.json"
    path.write_text(json.dumps(sealed({"cell_mm": 0.125})))
    assert load_record(Grid, path).cell_mm == 0.125
    path.write_text(path.read_text().replace("0.125", "0.325"))
    with pytest.raises(InputError, match="does not fit its own hash"):
        load_record(Grid, path)


def test_a_camera_is_read_from_a_whole_record_only(tmp_path):
    path = tmp_path / "simulation.json"
    path.write_text(json.dumps(sealed({"camera": asdict(PAPER_CAMERA)})))
    assert read_camera(path) == PAPER_CAMERA
    path.write_text(path.read_text().replace("326.0", "325.0"))
    with pytest.raises(InputError, match="own hash; for a changed camera, write .* a TOML file"):
        read_camera(path)
