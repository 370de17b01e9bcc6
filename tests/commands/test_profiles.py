"""lf-flame profiles."""

import csv
import json

import numpy as np
import pytest
import tifffile
from click.testing import CliRunner

from lf_flame.commands.cli import commands


def run(*words):
    return CliRunner().invoke(commands, [str(word) for word in words])


@pytest.fixture
def folder(tmp_path):
    """A folder as reconstruct leaves it: two planes of 6 x 8 cells, and four draws."""
    path = tmp_path / "flames"
    path.mkdir()
    planes = np.arange(96, dtype=np.float32).reshape(2, 6, 8)
    steps = np.array([-1, 1, -1, 1], np.float32)
    tifffile.imwrite(path / "emission.tif", planes)
    tifffile.imwrite(path / "draws.tif", planes + steps[:, None, None, None])
    tifffile.imwrite(path / "correction.tif", np.full_like(planes, -2))
    record = {"depths_mm": [4.0, -2.0], "cell_mm": [1.0, 0.5]}
    (path / "reconstruct.json").write_text(json.dumps(record))
    return path


def rows_of(path):
    with path.open() as file:
        return list(csv.DictReader(file))


def test_every_plane_has_its_profiles_on_its_own_scale(folder, tmp_path):
    out = tmp_path / "out"
    result = run("profiles", folder, "--across", 0.25, "--height", -0.25, "--out", out)
    assert result.exit_code == 0, result.output
    up = rows_of(out / "axial.csv")
    near = [row for row in up if row["depth_mm"] == "-2.0"]
    assert [float(row["height_mm"]) for row in near] == [-1.25, -0.75, -0.25, 0.25, 0.75, 1.25]
    # The fifth column of the second plane, from the lowest row up.
    assert [float(row["emission"]) for row in near] == [92, 84, 76, 68, 60, 52]
    assert float(near[0]["standard_deviation"]) == pytest.approx(np.sqrt(4 / 3))
    # Student's t of four draws at 97.5 %, 3.182; noise and correction in quadrature.
    half = 3.182446 * np.hypot(np.sqrt(4 / 3), 2)
    for row, emission in zip(near, (92, 84, 76, 68, 60, 52), strict=True):
        assert float(row["low_95"]) == pytest.approx(emission - half)
        assert float(row["high_95"]) == pytest.approx(emission + half)
    across = [row for row in rows_of(out / "radial.csv") if row["depth_mm"] == "-2.0"]
    assert [float(row["emission"]) for row in across] == list(range(72, 80))
    assert (out / "profiles.png").read_bytes().startswith(b"\x89PNG")
    assert run("verify", out).exit_code == 0


def test_without_draws_there_are_no_errors(folder, tmp_path):
    (folder / "draws.tif").unlink()
    result = run("profiles", folder, "--out", tmp_path / "out")
    assert result.exit_code == 0
    assert "no bands" in result.output
    assert {row["standard_deviation"] for row in rows_of(tmp_path / "out" / "axial.csv")} == {""}


def test_without_a_correction_there_are_no_bands(folder, tmp_path):
    """As of a folder that an older version has left."""
    (folder / "correction.tif").unlink()
    assert run("profiles", folder, "--out", tmp_path / "out").exit_code == 0
    rows = rows_of(tmp_path / "out" / "axial.csv")
    assert {row["low_95"] for row in rows} == {""}
    assert "" not in {row["standard_deviation"] for row in rows}


def test_what_cannot_be_used_is_refused(folder, tmp_path):
    out = tmp_path / "out"
    assert "must lie within" in str(run("profiles", folder, "--across", 9, "--out", out).exception)
    correction = tifffile.imread(folder / "correction.tif")
    tifffile.imwrite(folder / "correction.tif", correction[:, :3])
    assert "must hold planes" in str(run("profiles", folder, "--out", out).exception)
    tifffile.imwrite(folder / "correction.tif", correction)
    tifffile.imwrite(folder / "draws.tif", np.zeros((3, 5), np.float32))
    assert "must hold planes" in str(run("profiles", folder, "--out", out).exception)
    (folder / "draws.tif").write_bytes(b"no picture")
    assert "cannot be read" in str(run("profiles", folder, "--out", out).exception)
    (folder / "reconstruct.json").unlink()
    assert run("profiles", folder, "--out", out).exit_code
    assert not out.exists()
