"""`python -m experiments screenshots`, and the benchmark of the viewer's page."""

import json
import sys

import pandas as pd
import pytest
from click.testing import CliRunner

from experiments.__main__ import commands
from experiments.benchmarks import viewer
from experiments.browser import find_browser
from experiments.screenshots.taking import IN_ONE_FILE, SERVED
from lf_flame.formats.images import read_image

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(find_browser() is None, reason="there is no browser"),
]


def test_pictures_differ_and_have_a_record(tmp_path):
    pytest.importorskip("playwright")
    result = CliRunner().invoke(commands, ["screenshots", "--out", str(tmp_path)])
    assert result.exit_code == 0, result.output
    names = {*SERVED, *IN_ONE_FILE}
    assert json.loads((tmp_path / "screenshots.json").read_text())["files"].keys() == names
    pictures = [read_image(tmp_path / name) for name in sorted(names)]
    assert all(picture.shape == (720, 1100, 3) for picture in pictures)
    for one, other in zip(pictures, pictures[1:], strict=False):
        assert abs(one - other).mean() > 0.005


def test_the_viewer_is_timed_by_both_renderers(tmp_path, monkeypatch):
    pytest.importorskip("playwright")
    monkeypatch.setattr(viewer, "SHAPES", ((3, 3, 8, 9),))
    words = ["viewer", "--out", str(tmp_path), "--repetitions", "1"]
    monkeypatch.setattr(sys, "argv", words)
    viewer.main()
    table = pd.read_csv(tmp_path / "viewer.csv")
    assert list(table["drawn by"]) == ["javascript", "webgl"]
    assert (table["first picture"] <= table["all views"]).all()
    assert (table["frames a second"] > 1).all()
