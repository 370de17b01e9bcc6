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
from dataclasses import replace
import click
from experiments.__main__ import commands
from experiments.screenshots import sources, taking
from lf_flame.commands import cli
from lf_flame.viewer import demo
demo.DEMO_CAMERA = replace(demo.DEMO_CAMERA, views=5, lenslets=(60, 90), lenslet_pitch_mm=0.336)
demo.demo_light_field.__defaults__ = (demo.DEMO_CAMERA,)
def check(folder, command, *words):
    parser = cli.commands.commands[command]
    parser.make_parser(click.Context(parser)).parse_args(list(words))
sources._run = check
for pictures, other in ((taking.SERVED, "far"), (taking.SERVED, "near"),
                        (taking.SHOWN, "lenslets"), (taking.SHOWN, "simulated"),
                        (taking.SHOWN, "emission")):
    del pictures[f"viewer_{other}.png"]
commands()
"""
"""Starts the program with a small camera, for one picture of each way.

Commands that make what other pictures show are only checked for options that do not exist.
"""

TAKEN = {"viewer_slope_map.png", "viewer_folder.png", *IN_ONE_FILE}


def test_pictures_differ_and_have_a_record(tmp_path):
    pytest.importorskip("playwright")
    out = tmp_path / "out"
    said = run("-c", SMALL, "screenshots", "--out", str(out))
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
