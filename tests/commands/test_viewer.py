"""lf-flame view and lf-flame demo."""

import json
import re
import signal
import subprocess
import sys
import urllib.request
from dataclasses import replace

import numpy as np
import pytest
from builders import camera_toml
from programs import run

from lf_flame import PAPER_CAMERA, LightField, read_light_field, write_light_field
from lf_flame.refocus import find_slope_range
from lf_flame.viewer.demo import DEMO_CAMERA


@pytest.fixture
def source(tmp_path, rng):
    """A light field of one textured plane at slope 0.5."""
    texture = rng.uniform(0, 255, (40, 60))
    rows, columns = np.arange(30) + 5, np.arange(50) + 5
    views = [
        [
            (texture[rows][:, columns] + texture[rows + v // 2][:, columns + u // 2]) / 2
            for u in (-2, 0, 2)
        ]
        for v in (-2, 0, 2)
    ]
    np.save(tmp_path / "views.npy", np.array(views).astype(np.uint8))
    return tmp_path / "views.npy"


@pytest.mark.slow
def test_the_local_page_is_served_until_ctrl_c(source):
    words = ["view", str(source), "--no-browser", "--slopes", "-2", "2"]
    # A shell's "&" turns Ctrl-C off; Python's own handler turns it on again.
    start = (
        "import signal, runpy, sys; signal.signal(signal.SIGINT, signal.default_int_handler);"
        f"sys.argv = {['lf-flame', *words]!r}; runpy.run_module('lf_flame', run_name='__main__')"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", start], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        url = process.stdout.readline().strip()
        assert re.fullmatch(r"http://127\.0\.0\.1:\d+/[\w-]{16,}/", url), process.stderr.read()
        with urllib.request.urlopen(url) as answer:
            page = answer.read()
        assert b"<h1>views.npy</h1>" in page
        process.send_signal(signal.SIGINT)
        rest, errors = process.communicate(timeout=60)
    finally:
        process.kill()
        process.wait()
    assert process.returncode == 0, errors
    assert rest.endswith("Ended.\n")


@pytest.mark.slow
def test_the_demo_holds_what_its_help_says(tmp_path):
    """The burner and the wall, whose patterns have a slope of their own, where they stand."""
    result = run("demo", "--single-file", tmp_path / "d.html", "--save", tmp_path / "d.npy")
    assert result.exit_code == 0, result.output
    assert (tmp_path / "d.html").stat().st_size < 10e6
    light_field = read_light_field(tmp_path / "d.npy")
    assert light_field.views.shape == (9, 9, 180, 270)
    found = find_slope_range(LightField(light_field.views[2:-2, 2:-2]))  # which are quicker
    assert found.low < DEMO_CAMERA.depth_to_slope(-10.0) < DEMO_CAMERA.depth_to_slope(15.0)
    assert DEMO_CAMERA.depth_to_slope(15.0) < found.high


def test_the_ends_of_the_slider_are_told_in_mm_too(source, tmp_path):
    lens = replace(PAPER_CAMERA, views=3, lenslets=(30, 50))
    camera = tmp_path / "camera.toml"
    camera.write_text(camera_toml(3, (30, 50)), encoding="utf-8")
    raw = source.with_suffix(".tif")
    write_light_field(read_light_field(source), raw)
    result = run("view", raw, "--camera", camera, "--single-file", tmp_path / "page.html")
    found = find_slope_range(read_light_field(source))
    low, high = (lens.slope_to_depth(end) for end in (found.low, found.high))
    assert f"to {found.high:+.2f}, {low:+.4g} to {high:+.4g} mm" in result.output
    # Copied commands and Python read it by the camera too, whose number of views they need.
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert f'"reading": {json.dumps({"views": 3, "camera": str(camera)})}' in page
