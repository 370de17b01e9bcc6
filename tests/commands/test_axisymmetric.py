"""lf-flame abel."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
import tifffile
from builders import camera_toml
from PIL import Image
from programs import run

from lf_flame import PAPER_CAMERA, Layer, Scene, render

CAMERA = camera_toml(5, (48, 60))

ACROSS, DEPTH, WIDTH, PEAK = -0.6, 3.0, 0.9, 0.5


COARSE = ("--block", 2, "--bootstrap", 0)


@pytest.fixture(scope="module")
def views():
    """Views of a ball of light, exp(-(r / WIDTH)^2), as thin layers."""
    camera = replace(PAPER_CAMERA, views=5, lenslets=(48, 60))
    at = np.linspace(-3, 3, 121)
    ball = np.exp(-((at[:, None] ** 2 + at**2) / WIDTH**2))
    depths = np.arange(-2.5, 2.5, 0.1) + 0.05
    layers = [
        Layer(
            PEAK * 0.1 * np.exp(-((z / WIDTH) ** 2)) * ball, DEPTH + z, (6.05, 6.05), (0.0, ACROSS)
        )
        for z in depths
    ]
    rendered = render(Scene(layers), camera, tolerance=1e-6).views
    noise = np.random.default_rng(0).standard_normal(rendered.shape, dtype=np.float32)
    return rendered + np.float32(0.01 * rendered.max()) * noise


@pytest.fixture
def source(views, tmp_path):
    np.save(tmp_path / "ball.npy", views)
    (tmp_path / "camera.toml").write_text(CAMERA)
    return tmp_path / "ball.npy", "--camera", tmp_path / "camera.toml"


@pytest.mark.slow
def test_ball_is_found_with_its_axis_and_written(source, tmp_path, drawn):
    result = run("abel", *source, "--bootstrap", 3, "--out", tmp_path / "found")
    assert result.exit_code == 0, result.output
    record = json.loads((tmp_path / "found" / "emission.json").read_text())
    assert record["axis_mm"] == pytest.approx(ACROSS, abs=0.03)
    assert record["axis_depth_mm"] == pytest.approx(DEPTH, abs=0.2)
    with (tmp_path / "found" / "radial.csv").open() as file:
        rows = [{name: float(x) for name, x in row.items()} for row in csv.DictReader(file)]
    truth = [
        PEAK * np.exp(-(row["height_mm"] ** 2 + row["radius_mm"] ** 2) / WIDTH**2) for row in rows
    ]
    found = [row["emission_per_mm"] for row in rows]
    assert np.abs(np.subtract(found, truth)).max() < 0.06 * PEAK
    assert all(row["standard_deviation"] >= 0 for row in rows)
    with (tmp_path / "found" / "axial.csv").open() as file:
        axis = [float(row["emission_per_mm"]) for row in csv.DictReader(file)]
    assert axis == [row["emission_per_mm"] for row in rows if row["radius_mm"] == 0]
    section = tifffile.imread(tmp_path / "found" / "emission.tif")
    assert section.shape == tifffile.imread(tmp_path / "found" / "sigma.tif").shape
    assert section.shape[0] == len(axis)
    assert (tmp_path / "found" / "section.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_middle_view_alone_will_do(source, tmp_path):
    out = tmp_path / "found"
    assert run("abel", *source, "--central", *COARSE, "--out", out).exit_code == 0
    section = tifffile.imread(out / "emission.tif")
    assert section.max() == pytest.approx(PEAK, rel=0.2)
    assert json.loads((out / "emission.json").read_text())["views"] == "central"


@pytest.mark.slow
def test_a_background_is_measured_beside_the_flame(source, views, tmp_path):
    np.save(tmp_path / "bright.npy", views + np.float32(0.1))
    out = ["--out", tmp_path / "out"]
    run("abel", tmp_path / "bright.npy", *source[1:], "--central", *COARSE, *out)
    section = tifffile.imread(tmp_path / "out" / "emission.tif")
    assert section.max() == pytest.approx(PEAK, rel=0.2)
    record = json.loads((tmp_path / "out" / "emission.json").read_text())
    assert record["background"] == pytest.approx(0.1, abs=5e-3)


def test_light_that_is_not_round_is_told(source, views, tmp_path):
    lopsided = views.copy()
    lopsided[..., 26:] *= 1.5
    np.save(tmp_path / "lopsided.npy", lopsided)
    out = ["--out", tmp_path / "out"]
    result = run("abel", tmp_path / "lopsided.npy", *source[1:], *COARSE, *out)
    assert "not axisymmetric" in result.output


ONE_VIEW = CAMERA.replace("views = 5", "views = 1").replace("0.4", "2.0")


@pytest.mark.slow
def test_one_plain_picture_will_do_where_the_depth_is_stated(views, tmp_path, drawn):
    (tmp_path / "one.toml").write_text(ONE_VIEW)
    picture = views[2, 2].clip(0) / views.max()
    Image.fromarray(np.rint(picture * 65535).astype(np.uint16)).save(tmp_path / "one.png")
    words = ["abel", tmp_path / "one.png", "--camera", tmp_path / "one.toml", "--bootstrap", 0]
    words += ["--out", tmp_path / "out"]
    assert "--axis-depth" in str(run(*words).exception)
    where = ["--axis-depth", DEPTH, "--axis-mm", ACROSS, "--radius", 2.5]
    result = run(*words, *where)
    assert result.exit_code == 0, result.output
    assert "would not show" in result.output
    section = tifffile.imread(tmp_path / "out" / "emission.tif") * views.max()
    assert section.max() == pytest.approx(PEAK, rel=0.2)
