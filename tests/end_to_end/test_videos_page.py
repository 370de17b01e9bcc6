"""The page on videos, done as it says, in an empty folder."""

import re
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from lf_flame.scenes.flames import flame_texture

PAGE = (Path(__file__).parents[2] / "docs" / "videos.md").read_text(encoding="utf-8")


FEWER = (("(100)", "(64)"), ("frame != 60", "frame != 20"), ("== [60]", "== [20]"))
"""What is done with fewer frames than the page says."""

for many, few in FEWER:
    assert many in PAGE
    PAGE = PAGE.replace(many, few)


def blocks(language):
    return re.findall(rf"^```{language}\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)


def tip_of(height_mm):
    """Height at which a flame's top is half as bright as its brightest."""
    rows = flame_texture(height_mm, 1.2, cell_mm=0.02).max(axis=1)
    return height_mm * (1 - np.flatnonzero(rows > 0.5 * rows.max())[0] / len(rows))


@pytest.mark.slow
def test_the_page_ends_in_the_flames_that_it_filmed(tmp_path):
    for name in ("distributed", "xarray", "pyproximal"):
        pytest.importorskip(name)
    zarr = pytest.importorskip("zarr")

    def run(*words):
        command = [sys.executable, *words]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        return done.stdout

    (camera,) = blocks("toml")
    (tmp_path / "camera.toml").write_text(camera)
    film, numbers, again = blocks("py")
    run("-c", film)
    (commands,) = blocks("sh")
    for line in commands.splitlines():
        program, *words = shlex.split(line)
        assert program == "lf-flame"
        assert "63 whole, 1 missing" in run("-m", "lf_flame", *words)
    height, light = re.findall(r"flickers at ([\d.]+) Hz", run("-c", numbers))
    assert float(height) == pytest.approx(30, abs=0.5)
    assert float(light) == pytest.approx(45, abs=0.5)
    group = zarr.open_group(tmp_path / "flame.zarr", mode="r")
    # What the scene says: up and down by 1 mm, and by a fourth of the light.
    seconds, sums = np.arange(64) / 500, group["emission"][:].sum(axis=(2, 3))
    heights = np.nan_to_num(group["height"][:], nan=np.nanmean(group["height"][:]))
    swing, _ = np.polyfit(np.sin(2 * np.pi * 30 * seconds), heights, 1)
    assert swing == pytest.approx((tip_of(10) - tip_of(8)) / 2, abs=0.1)
    bright = np.delete(sums[:, 1], 20), np.delete(np.sin(2 * np.pi * 45 * seconds), 20)
    slope, level = np.polyfit(bright[1], bright[0], 1)
    assert slope / level == pytest.approx(0.25, abs=0.02)
    with Image.open(tmp_path / "flame.gif") as film:
        assert film.n_frames >= 60
    (tmp_path / "again.py").write_text(again)
    assert "63 whole, 1 missing" in run("again.py")
