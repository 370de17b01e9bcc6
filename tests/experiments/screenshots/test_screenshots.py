"""`python -m experiments screenshots`, and the benchmark of the viewer's page."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

from experiments.browser import find_browser
from experiments.screenshots.notebook import find_jupyter
from experiments.screenshots.sources import SHOWN
from experiments.screenshots.taking import IN_ONE_FILE, NOTEBOOK, SERVED
from lf_flame.formats.images import read_image

ROOT = Path(__file__).parents[3]

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(find_browser() is None, reason="there is no browser"),
]


def run(*words):
    """Run Python in a process of its own: playwright starts once in each."""
    done = subprocess.run(
        [sys.executable, *words],
        cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stderr


SMALL = """
import sys
from dataclasses import replace
from pathlib import Path
from experiments.__main__ import commands
from experiments.screenshots import sources, taking
from lf_flame.viewer import demo
demo.DEMO_CAMERA = replace(demo.DEMO_CAMERA, views=5, lenslets=(60, 90), lenslet_pitch_mm=0.336)
demo.demo_light_field.__defaults__ = (demo.DEMO_CAMERA,)
scenes, sources.SCENES = sources.SCENES, Path(sys.argv.pop(1))
for name in ("example", "flames_by_depth"):
    text = (scenes / f"{name}.toml").read_text().replace("0.112", "0.448")
    text = text.replace("[200, 320]", "[50, 80]").replace("[150, 200]", "[38, 50]")
    (sources.SCENES / f"{name}.toml").write_text(text)
for pictures, other in ((taking.SERVED, "far"), (taking.SERVED, "near"),
                        (taking.SHOWN, "lenslets"), (taking.SHOWN, "simulated")):
    del pictures[f"viewer_{other}.png"]
commands()
"""
"""Starts the program with small cameras before the same scenes, for one picture of each way."""

TAKEN = {"viewer_slope_map.png", "viewer_folder.png", "viewer_emission.png", *IN_ONE_FILE}


def test_pictures_differ_and_have_a_record(tmp_path):
    pytest.importorskip("playwright")
    (tmp_path / "scenes").mkdir()
    out = tmp_path / "out"
    said = run("-c", SMALL, str(tmp_path / "scenes"), "screenshots", "--out", str(out))
    names = TAKEN
    assert names < {*SERVED, *IN_ONE_FILE, *SHOWN}
    assert ("There is no JupyterLab" in said) == (find_jupyter() is None)
    written = names | {NOTEBOOK} if find_jupyter() else names
    assert json.loads((out / "screenshots.json").read_text())["files"].keys() == written
    pictures = [read_image(out / name) for name in sorted(names)]
    assert all(picture.shape == (800, 1280, 3) for picture in pictures)
    for one, other in zip(pictures, pictures[1:], strict=False):
        assert abs(one - other).mean() > 0.005


def test_the_viewer_is_timed_by_both_renderers(tmp_path):
    pytest.importorskip("playwright")
    start = (
        "from experiments.benchmarks import viewer; viewer.SHAPES = ((3, 3, 8, 9),); viewer.main()"
    )
    run("-c", start, "--out", str(tmp_path), "--small")
    table = pd.read_csv(tmp_path / "viewer.csv")
    assert list(table["drawn by"]) == ["javascript", "webgl", "the program"]
    assert (table["first picture"] <= table["all views"]).all()
    assert (table["frames a second"] > 0).all()
