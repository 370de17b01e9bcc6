"""A camera file for a light field of other lenslet counts: one rule in every command."""

import json
from pathlib import Path

import numpy as np
import pytest
import tifffile
from builders import OPTICS, camera_toml
from click.testing import CliRunner

from lf_flame.commands.cli import commands
from lf_flame.errors import InputError

VIEWS, SIZE, WHOLE = 3, (15, 21), (16, 24)
"""Views, rows and columns of the light field, and those that the camera file says."""


@pytest.fixture
def call(tmp_path, monkeypatch):
    """Program in a folder with a light field and cameras."""
    monkeypatch.chdir(tmp_path)
    y, x = np.mgrid[:15, :21]
    flame = np.exp(-(((x - 10) / 4) ** 2) - ((y - 7) / 5) ** 2)
    noise = 0.002 * np.random.default_rng(1).normal(size=(VIEWS, VIEWS, *SIZE))
    np.save("flame.npy", (flame + noise).astype(np.float32))
    (tmp_path / "made").mkdir()
    (tmp_path / "whole.toml").write_text(camera_toml(VIEWS, WHOLE))
    (tmp_path / "own.toml").write_text(camera_toml(VIEWS, SIZE))
    (tmp_path / "five.toml").write_text(camera_toml(5, SIZE))
    return lambda words: CliRunner().invoke(commands, words.split())


CALLS = [
    "refocus flame.npy --depth-mm 0 --out {}",
    "reconstruct flame.npy --depth-mm 0 --bootstrap 0 --out {}",
    "abel flame.npy --axis-depth 0 --bootstrap 0 --out {}",
    "process flame.npy --steps emission --depths -5 5 2 --workers 1 --out made/{}.zarr",
    "view flame.npy --single-file {}.html",
    "info flame.npy",
]


@pytest.mark.slow
@pytest.mark.parametrize("words", CALLS, ids=[words.split()[0] for words in CALLS])
def test_the_size_of_the_light_field_counts(call, words):
    said = {}
    for camera in ("whole", "own"):
        done = call(f"{words.format(camera)} --camera {camera}.toml")
        assert done.exit_code == 0, done.output
        said[camera] = done
    assert "is for views of 16 x 24 pixels, got 15 x 21" in said["whole"].output
    assert "is for views" not in said["own"].output
    if words.startswith("info"):  # which says what to type next, with what was given
        assert "next: lf-flame refocus flame.npy --camera own.toml\n" in said["own"].output
    other = call(f"{words.format('five')} --camera five.toml")
    assert isinstance(other.exception, InputError)
    assert "3 x 3" in str(other.exception)


@pytest.mark.slow
def test_cells_in_mm_are_those_of_the_pitch(call):
    """Size of a lenslet's image in the focal plane, by the lens equation."""
    for camera in ("whole", "own"):
        call(f"{CALLS[1].format(camera)} --camera {camera}.toml")
    focal, near = OPTICS["main_lens_focal_mm"], OPTICS["focus_distance_mm"]
    cell = OPTICS["lenslet_pitch_mm"] * (near - focal) / focal
    found = [tifffile.imread(f"{camera}/emission.tif") for camera in ("whole", "own")]
    np.testing.assert_array_equal(*found)
    assert found[0].shape[-2:] == SIZE
    record = json.loads(Path("whole/emission.json").read_text())
    assert record["cell_mm"][0] == pytest.approx(cell, rel=1e-6)
