"""The benchmark of refocusing runs, and says how far its opponents' images are from ours."""

import csv
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

BENCHMARKS = Path(__file__).parents[1] / "experiments" / "benchmarks"


@pytest.fixture
def refocusing(monkeypatch):
    monkeypatch.syspath_prepend(BENCHMARKS)
    import refocusing

    return refocusing


@pytest.fixture(scope="module")
def rows(tmp_path_factory):
    out = tmp_path_factory.mktemp("benchmarks")
    program = [sys.executable, BENCHMARKS / "refocusing.py", "--small", "--out", out]
    subprocess.run(program, check=True, capture_output=True)
    record = json.loads((out / "refocusing.json").read_text())
    assert record["opponents"] == {}
    assert "missing" in (out / "refocusing.md").read_text()
    with (out / "refocusing.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(record["rows"])
    return rows


def test_opponents_here_are_timed_and_refocus_as_we_do(rows):
    for name in ("NumPy, separable", "NumPy, separable, matrix product", "SciPy ndimage.shift"):
        found = [row for row in rows if row["opponent"] == name]
        assert len({row["what"] for row in found}) >= 4
        for row in found:
            assert float(row["opponent ms"]) > 0
            ratio = float(row["opponent ms"]) / float(row["ours ms"])
            assert float(row["ratio"]) == pytest.approx(ratio)
            assert 0 <= float(row["largest difference"]) <= 1e-6


def test_another_interpolant_is_seen_in_the_differences(rows):
    for name in ("our fourier_refocus", "SciPy ndimage.shift, order 3"):
        differences = [float(row["largest difference"]) for row in rows if row["opponent"] == name]
        assert differences
        assert min(differences) > 1e-3


def test_an_opponent_that_is_not_installed_is_shown_as_such(rows):
    missing = [row for row in rows if row["remarks"].startswith("not installed")]
    assert {row["opponent"] for row in missing} == {"plenpy", "PlenoptiCam", "plenoptomos"}
    assert all(row["opponent ms"] == row["ratio"] == "" for row in missing)


def test_every_target_has_a_row(rows):
    wanted = {(row["what"].split(",")[0], row["wanted"]) for row in rows if row["wanted"]}
    assert wanted == {
        ("four planes", "at least 0.25"),
        ("four planes", "at least 15"),
        ("15 planes", "at least 10"),
        ("four planes", "at least 1"),
    }


def test_images_that_differ_end_the_program(refocusing, rng):
    image = rng.random((1, 6, 7))
    assert float(refocusing.compared(refocusing.SHIFT, image, image)) == 0
    with pytest.raises(SystemExit, match="differs by"):
        refocusing.compared(refocusing.SHIFT, image, 1.001 * image)


def test_the_floor_reads_every_pixel(refocusing, rng):
    views = rng.random((3, 2, 9, 11)).astype(np.float32)
    assert refocusing.read_once(views, (0.0,)) == pytest.approx(views.sum(dtype=float), rel=1e-6)
