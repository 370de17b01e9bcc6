"""lf-flame resolution, reconstruct and temperature."""

import csv
import json
import re
from dataclasses import replace

import numpy as np
import pytest
import tifffile
from builders import camera_toml
from programs import run

from lf_flame import PAPER_CAMERA, Layer, Scene, render
from lf_flame.commands.tomography import read_thickness
from lf_flame.scenes.flames import flame_texture

CAMERA = camera_toml(5, (48, 60))

COARSE = ("--depth-mm", 6, "--depth-mm", -4, "--block", 2)


@pytest.fixture
def camera_file(tmp_path):
    (tmp_path / "camera.toml").write_text(CAMERA)
    return tmp_path / "camera.toml"


@pytest.fixture(scope="module")
def flames():
    """Views of two flames, of 1 and 0.5 in brightness, at 6 and -4 mm."""
    camera = replace(PAPER_CAMERA, views=5, lenslets=(48, 60))
    texture = flame_texture(4.0, 0.4, cell_mm=0.05)
    near, far = ((-4.0, 0.5, 1.2), (6.0, 1.0, -1.0))
    layers = [
        Layer(brightness * texture, depth, (4.0, 2.56), (0.0, x))
        for depth, brightness, x in (far, near)
    ]
    views = render(Scene(layers), camera, tolerance=1e-6).views
    noise = np.random.default_rng(0).standard_normal(views.shape, dtype=np.float32)
    return views + np.float32(0.01) * noise


@pytest.fixture
def source(flames, tmp_path):
    np.save(tmp_path / "flames.npy", flames)
    return tmp_path / "flames.npy"


@pytest.mark.slow
def test_resolution_is_told_as_a_table_and_a_picture(tmp_path, drawn):
    figure = tmp_path / "resolution.png"
    result = run("resolution", "--period", 1, "--period", 10, "--figure", figure)
    assert result.exit_code == 0, result.output
    assert result.output.startswith("The paper's camera;")
    # 1 mm / 0.239 rad, and 1 + 30 mm / 4.18 mm
    assert re.search(r"^1 +4\.18 +8\.2$", result.output, re.MULTILINE)
    assert re.search(r"^10 +41\.8 +1\.7$", result.output, re.MULTILINE)
    assert figure.read_bytes().startswith(b"\x89PNG")


def test_resolution_lists_what_the_camera_resolves(camera_file):
    """Two pixels in the focal plane and more; finer detail that is asked for is refused."""
    text = camera_file.read_text()
    coarse = re.sub(r"lenslet_pitch_mm = .*", "lenslet_pitch_mm = 0.5", text)
    coarse = re.sub(r"lenslet_focal_mm = .*", "lenslet_focal_mm = 2.0", coarse)
    camera_file.write_text(re.sub(r"pixel_pitch_mm = .*", "", coarse))
    finest = 2 * 0.5 * 326 * (1 / 150 - 1 / 326)
    result = run("resolution", "--camera", camera_file)
    listed = re.findall(r"^([\d.]+) +[\d.]+ +[\d.]+$", result.output, re.MULTILINE)
    assert [float(x) for x in listed] == [float(f"{finest:.3g}"), 2, 5, 10]
    refused = run("resolution", "--camera", camera_file, "--period", 0.5)
    assert "--period must be at least 1.17 mm" in str(refused.exception)


def test_half_the_views_blur_twice_as_far(camera_file):
    result = run("resolution", "--camera", camera_file, "--period", 1)
    assert "paper" not in result.output
    # The aperture is the same: five views of thrice the pixel.
    assert re.search(r"^1 +4\.18 ", result.output, re.MULTILINE)


@pytest.mark.slow
def test_emission_is_found_and_written(source, camera_file, tmp_path, drawn):
    out = tmp_path / "found"
    words = ["--camera", camera_file, "--depth-mm", 6, "--depth-mm", -4, "--out", out]
    result = run("reconstruct", source, *words, "--bootstrap", 2)
    assert result.exit_code == 0, result.output
    emission = tifffile.imread(out / "emission.tif")
    assert emission.shape == (2, 48, 60)
    assert emission.max(axis=(1, 2)) == pytest.approx([1.0, 0.5], rel=0.1)
    assert tifffile.imread(out / "sigma.tif").shape == (2, 48, 60)
    rows = list(csv.DictReader((out / "depth.csv").read_text().splitlines()))
    lights = [float(row["light_radiance_mm2"]) for row in rows]
    texture = flame_texture(4.0, 0.4, cell_mm=0.05)
    wanted = texture.mean() * 4.0 * 2.56
    assert lights == pytest.approx([wanted, wanted / 2], rel=0.05)
    assert all(float(row["standard_deviation"]) > 0 for row in rows)
    record = json.loads((out / "emission.json").read_text())
    assert record["noise"] == pytest.approx(0.01, rel=0.05)
    assert record["depths_mm"] == [6, -4]
    assert {"slices.png", "depth.png", "trust.png"} <= set(record["files"])


@pytest.mark.slow
def test_a_dark_frame_is_taken_off(source, camera_file, flames, tmp_path):
    np.save(tmp_path / "bright.npy", flames + np.float32(0.1))
    np.save(tmp_path / "dark.npy", np.full_like(flames, 0.1))
    words = ["--camera", camera_file, *COARSE, "--bootstrap", 0, "--strength", 0.01]
    plain, cleaned, left = (tmp_path / name for name in ("plain", "cleaned", "left"))
    assert run("reconstruct", source, *words, "--out", plain).exit_code == 0
    bright = tmp_path / "bright.npy"
    dark = ["--dark", tmp_path / "dark.npy"]
    assert run("reconstruct", bright, *words, *dark, "--out", cleaned).exit_code == 0
    same = [tifffile.imread(folder / "emission.tif") for folder in (plain, cleaned)]
    assert same[1] == pytest.approx(same[0], abs=1e-3)
    result = run("reconstruct", bright, *words, "--background", "none", "--out", left)
    assert "subtract the dark frame" in result.output
    assert not (plain / "sigma.tif").exists()


@pytest.mark.slow
def test_absorption_is_given_back(source, camera_file, tmp_path):
    """The nearer flame is its own (1 - exp(-tau)) / tau brighter, the other one exp(tau) more."""
    words = ["--camera", camera_file, *COARSE, "--strength", 0.01]
    tifffile.imwrite(tmp_path / "tau.tif", np.full((2, 24, 30), 0.2, np.float32))
    runs = {"plain": [], "planes": ["--optical-thickness", tmp_path / "tau.tif"]}
    lights = {}
    for name, option in runs.items():
        out = ["--bootstrap", 0, "--out", tmp_path / name]
        result = run("reconstruct", source, *words, *option, *out)
        assert result.exit_code == 0, result.output
        lights[name] = tifffile.imread(tmp_path / name / "emission.tif").sum(axis=(1, 2))
    own = 0.2 / -np.expm1(-0.2)
    assert lights["planes"] / lights["plain"] == pytest.approx([own * np.exp(0.2), own], rel=1e-3)
    records = {name: json.loads((tmp_path / name / "emission.json").read_text()) for name in runs}
    assert records["plain"]["optical_thickness"] is None
    assert records["planes"]["optical_thickness"].endswith("tau.tif")
    assert records["planes"]["greatest_optical_thickness"] == pytest.approx(0.4)
    assert read_thickness("0.4") == 0.4
