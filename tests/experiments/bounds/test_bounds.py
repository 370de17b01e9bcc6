"""`python -m experiments bounds`: scenes drawn from a seed, a record that goes on, a table."""

import json
from contextlib import nullcontext
from types import SimpleNamespace

import numpy as np
import pytest
from click.testing import CliRunner

from experiments.__main__ import commands
from experiments.bounds import random_scenes, report
from experiments.bounds.random_scenes import draw_scene, measure_scene
from experiments.bounds.report import tabulate
from lf_flame import InputError


def test_a_run_goes_on_where_it_was_stopped(tmp_path, monkeypatch):
    here = nullcontext(SimpleNamespace(map=map))  # instead of processes, which take seconds each
    monkeypatch.setattr(report, "worker_pool", lambda *_: here)
    measured = []

    def measure(seed, number):
        measured.append((seed, number))
        line = {"effect": "cos4", "bound": 0.2, "change": 0.1, "error": 0.0}
        return {"scene": number, "refused": None, "effects": [line]}

    monkeypatch.setattr(report, "measure_scene", measure)
    for scenes in (1, 2):
        arguments = ["bounds", "--out", str(tmp_path), "--scenes", str(scenes), "--seed", "3"]
        CliRunner().invoke(commands, arguments, catch_exceptions=False)
    assert measured == [(3, 0), (3, 1)]
    record = json.loads((tmp_path / "bounds.json").read_text())
    assert [scene["scene"] for scene in record["scenes"]] == [0, 1]
    assert "2 random scenes" in (tmp_path / "bounds.md").read_text()
    assert (tmp_path / "bounds.csv").read_text().splitlines()[1] == "cos4,2,2.0,2.0,2.0,0,0"


@pytest.mark.slow
def test_a_scene_is_held_against_its_bounds(monkeypatch):
    monkeypatch.setattr(random_scenes, "RAY_COUNTS", (3, 6))
    found = measure_scene(3, 1)
    assert found["refused"] is None
    assert len(found["effects"]) >= 3
    for line in found["effects"]:
        assert 0 <= line["change"] <= line["bound"] + line["error"] + random_scenes.ROUNDING


def test_every_imperfection_is_drawn():
    drawn = []
    for number in range(40):
        try:
            drawn.append(draw_scene(np.random.default_rng([0, number])))
        except InputError:
            continue
    cameras = [camera for _, camera in drawn]
    layers = [layer for scene, _ in drawn for layer in scene.layers]
    for name in ("aperture_diameter_mm", "rim_diameter_mm", "wavelength_nm", "chromatic_shift",
                 "lenslet_rotation_rad", "lenslet_pitch_error", "sensor"):  # fmt: skip
        stated = [bool(getattr(camera, name)) for camera in cameras]
        assert 0.2 < np.mean(stated) < 0.8
    assert any(layer.opaque for layer in layers)
    assert any(layer.thickness_mm > 1 for layer in layers)
    assert any(layer.optical_thickness.max() > 0.1 for layer in layers)


def test_the_table_counts_violations_and_refusals():
    lines = [("cos4", 0.2, 0.1), ("cos4", 0.1, 0.11), ("cos4", 0.1, None), ("cos4", 0.1, 0.0)]
    names = ("effect", "bound", "change", "error")
    found = [{"effects": [dict(zip(names, (*line, 0.001), strict=True))]} for line in lines]
    row = tabulate(found).iloc[0]
    assert (row.number, row.refused, row.violations) == (3, 1, 1)
    assert row.largest == 2
    assert row.smallest == 0.1 / 0.11
