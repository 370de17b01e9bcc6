"""lf-flame profiles."""

import csv

import numpy as np
import pytest
from builders import write_folder
from programs import run

RECORD = {"geometry": "planes", "depths_mm": [4.0, -2.0], "cell_mm": [1.0, 0.5]}


@pytest.fixture
def folder(tmp_path):
    """A folder as reconstruct leaves it: two planes of 6 x 8 cells, and four draws."""
    planes = np.arange(96, dtype=np.float32).reshape(2, 6, 8)
    steps = np.array([-1, 1, -1, 1], np.float32)
    files = {"emission.tif": planes, "draws.tif": planes + 2 + steps[:, None, None, None]}
    return write_folder(tmp_path / "flames", RECORD, files)


def rows_of(path):
    with path.open() as file:
        return list(csv.DictReader(file))


@pytest.mark.slow
def test_every_plane_has_its_profiles_on_its_own_scale(folder, tmp_path, drawn):
    out = tmp_path / "out"
    result = run("profiles", folder, "--across", 0.25, "--height", -0.25, "--out", out)
    assert result.exit_code == 0, result.output
    up = rows_of(out / "axial.csv")
    near = [row for row in up if row["depth_mm"] == "-2.0"]
    assert [float(row["height_mm"]) for row in near] == [-1.25, -0.75, -0.25, 0.25, 0.75, 1.25]
    # The fifth column of the second plane, from the lowest row up.
    assert [float(row["emission"]) for row in near] == [92, 84, 76, 68, 60, 52]
    assert float(near[0]["standard_deviation"]) == pytest.approx(np.sqrt(1 + 2**2))
    # Student's t of four squares about the emission at 97.5 %, 2.776; spread 1 and bias 2.
    half = 2.776445 * np.sqrt(1 + 2**2)
    for row, emission in zip(near, (92, 84, 76, 68, 60, 52), strict=True):
        assert float(row["low_95"]) == pytest.approx(emission - half)
        assert float(row["high_95"]) == pytest.approx(emission + half)
    across = [row for row in rows_of(out / "radial.csv") if row["depth_mm"] == "-2.0"]
    assert [float(row["emission"]) for row in across] == list(range(72, 80))
    assert (out / "profiles.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
@pytest.mark.parametrize("count", [1, 2])
def test_one_plane_is_read_back_as_one(tmp_path, count):
    """A stack of one plane, or of one draw's plane, is rows and columns alone to a TIFF reader."""
    plane = np.arange(48, dtype=np.float32).reshape(1, 6, 8)
    files = {"emission.tif": plane, "draws.tif": np.stack([plane + n for n in range(count)])}
    record = RECORD | {"depths_mm": [4.0], "cell_mm": [1.0]}
    folder = write_folder(tmp_path / "one", record, files)
    result = run("profiles", folder, "--across", 0.5, "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    rows = rows_of(tmp_path / "out" / "axial.csv")
    assert [float(row["emission"]) for row in rows] == [44, 36, 28, 20, 12, 4]
    assert all((row["standard_deviation"] != "") == (count > 1) for row in rows)
