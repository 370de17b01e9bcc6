"""From pictures of a furnace and one of a flame to temperatures, by the commands."""

import json
from pathlib import Path

import numpy as np
import pytest
import tifffile
from builders import RESPONSES, camera_toml
from click.testing import CliRunner

from experiments.emission.truth import Lens, SootFlame, planck, trace
from lf_flame.commands.cli import commands

COLOURS = (480.0, 640.0)
LENS = Lens(views=3, lenslets=(36, 32))
GAINS = np.array([1 / planck(nm, 1800.0) for nm in COLOURS])
CALIBRATION = "--colours", "colours/colours.toml"


def run(*words, code=0):
    result = CliRunner().invoke(commands, [str(word) for word in words])
    assert result.exit_code == code, (result.output, result.exception)
    return result


@pytest.fixture
def furnace(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("camera.csv").write_text(RESPONSES)
    Path("camera.toml").write_text(camera_toml(LENS.views, LENS.lenslets))
    pictures = []
    for kelvin in (1500, 1700, 1900):
        signal = GAINS * [planck(nm, kelvin) for nm in COLOURS]
        np.savez(f"f{kelvin}.npz", views=np.broadcast_to(signal, (3, 3, 20, 24, 2)))
        pictures.append(f"f{kelvin}.npz@{kelvin}")
    return pictures


@pytest.mark.slow
def test_one_exposure_gives_the_temperature_of_a_sooty_flame(furnace, rng):
    shown = run("calibrate-colours", *furnace, "--responses", "camera.csv")
    assert "source (K)" in shown.output
    assert "determine temperatures of soot above 500 K" in shown.output
    flame = SootFlame(radius=1.6, height=4.2)
    views = trace(LENS, flame.slabs(COLOURS), parts=1, channels=(2,)) * GAINS
    views += 0.002 * views.max() * rng.standard_normal(views.shape)
    np.savez("flame.npz", views=views)
    where = ["--camera", "camera.toml", "--axis-mm", 0, "--axis-depth", 0, "--radius", 2.1]
    shown = run("abel", "flame.npz", *where, "--colours", "colours/colours.toml", "--bootstrap", 2)
    assert "largest optical thickness of the soot: blue 0.6" in shown.output
    run("temperature", "abel/flame", "--colours", "colours/colours.toml")
    kelvin = tifffile.imread("temperature/flame/temperature.tif").squeeze()
    step = json.loads(Path("abel/flame/red/emission.json").read_text())["step_mm"]
    rows, columns = kelvin.shape
    h, r = np.meshgrid(
        step * ((rows - 1) / 2 - np.arange(rows)), step * np.arange(columns), indexing="ij"
    )
    red = flame.absorption(r, h) * planck(COLOURS[1], flame.kelvin(r, h))
    bright = (red > red.max() / 3) & (np.abs(h) < 1.4)
    apart = (kelvin - flame.kelvin(r, h))[bright]
    assert np.isfinite(apart).all()
    assert abs(np.mean(apart)) < 8  # taken for thin it would be 30 K too cold
    thick = tifffile.imread("temperature/flame/optical_thickness.tif").squeeze()
    assert np.median(thick[bright] / flame.absorption(r, h)[bright]) == pytest.approx(1, abs=0.06)
    red = Path("abel/flame/red/emission.json")
    other = run("temperature", "abel/flame", *CALIBRATION, "--soot-exponent", 1.4, code=1)
    assert "with which the absorption in abel/flame/blue was found, 1, got 1.4" in str(
        other.exception
    )
    wrong = run("temperature", "abel/flame/red", "abel/flame/blue", *CALIBRATION, code=1)
    assert "abel/flame/red is red; the order is blue, red" in str(wrong.exception)
    run("temperature", "abel/flame/red", "abel/flame/blue", "--wavelengths", 640, 480)
    assert not Path("temperature/red/optical_thickness.tif").exists()
    several = run("profiles", "abel/flame", code=1)
    assert "only in blue, red; give one of these" in str(several.exception)
    np.savez("swapped.npz", views=views[..., ::-1])
    swapped = run("abel", "swapped.npz", *where, *CALIBRATION, "--block", 2, code=1)
    assert "in another order than the channels" in str(swapped.exception)
    again = run("abel", "flame.npz", *where, *CALIBRATION, code=1)  # before any fit
    assert "abel/flame/blue exists; name another folder" in str(again.exception)
    # A call that was killed between two colours.
    written = json.loads(red.read_text())
    red.write_text(json.dumps(written | {"call": "another"}))
    mixed = run("temperature", "abel/flame", "--colours", "colours/colours.toml", code=1)
    assert "are not of one run" in str(mixed.exception)
