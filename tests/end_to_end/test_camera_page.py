"""The page on one's own camera, done as it says, on a raw image made by geometry of its own."""

import json
import re
import shlex
from pathlib import Path

import numpy as np
import pytest
import tifffile
from click.testing import CliRunner
from focused_pictures import Camera, Waves
from programs import run_here

from lf_flame.commands.cli import commands
from lf_flame.formats import read_light_field
from lf_flame.formats.images import read_image, write_image

PAGE = (Path(__file__).parents[2] / "docs" / "your_camera.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```sh\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)
PITCH, SLOPE, DARK, WHITE = 15, 0.4, 500.0, 30000.0
COLOURS = np.array([[0.6, 1.0], [1.0, 0.7]])  # red, green; green, blue


def write_pictures(folder):
    """A coloured plane under square lenslets, whose detail moves by SLOPE lenslets for a pixel."""
    rng = np.random.default_rng(3)
    y, x = np.mgrid[: 30 * PITCH, : 40 * PITCH]
    seen = [n // PITCH - SLOPE * (n % PITCH - PITCH // 2) for n in (y, x)]
    waves = rng.normal(0, 0.7, (30, 2))
    scene = 0.5 + 0.4 * np.mean(
        [np.sqrt(30) * np.cos(a * seen[0] + b * seen[1] + 9 * a) for a, b in waves], axis=0
    )
    away = np.hypot(y % PITCH - PITCH // 2, x % PITCH - PITCH // 2)
    light = WHITE * np.clip(PITCH / 2 - away, 0.02, 1) * np.tile(COLOURS, (15 * PITCH, 20 * PITCH))
    dark = DARK + rng.normal(0, 5, y.shape)
    for name, lit in (("raw", light * np.clip(scene, 0, 1)), ("white", light), ("dark", 0)):
        tifffile.imwrite(folder / f"{name}.tif", np.rint(lit + dark).astype(np.uint16))


@pytest.mark.slow
def test_the_page_ends_in_the_slope_of_the_picture(tmp_path):
    write_pictures(tmp_path)
    for line in BLOCKS[0].splitlines():
        program, *arguments = shlex.split(line)
        assert program == "lf-flame"
        done = run_here(*arguments, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
    (record,) = tmp_path.rglob("refocus.json")
    slopes = tifffile.imread(record.with_name("slope_map.tif"))
    assert np.median(slopes) == pytest.approx(SLOPE, rel=0.02)
    json.loads(record.read_text())
    views = read_light_field(tmp_path / "views.npz")
    assert views.shape == (15, 15, 30, 40, 3)
    assert views.weights[7, 7] == 1
    assert views.weights[0, 0] == 0
    red, green, blue = views.views[7, 7].mean(axis=(0, 1)) / views.views[7, 7, ..., 1].mean()
    np.testing.assert_allclose([red, green, blue], [0.6, 1.0, 0.7], rtol=0.02)


@pytest.mark.slow
def test_the_page_reads_a_camera_with_focused_lenslets(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    camera = Camera()
    pictures = {"raw": camera.record(4.0, Waves((28, 80))), "white": camera.white()}
    for name, picture in pictures.items():
        write_image(f"{name}.png", np.rint(40000 * picture).astype(np.uint16))
    Path("calibration.xml").write_text(camera.xml())
    for line in BLOCKS[1].splitlines():
        result = CliRunner().invoke(commands, shlex.split(line, comments=True)[1:])
        assert result.exit_code == 0, result.output
    assert read_image("sharp.tif").ndim == 2
    assert read_light_field("views.npz").shape[:2] == (5, 5)
    assert Path("refocused/raw/refocus.json").exists()
